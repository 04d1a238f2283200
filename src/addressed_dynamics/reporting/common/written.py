"""What a report is about, and what is kept of it beside its files."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from addressed_dynamics.reporting.common.blocks import Card


@dataclass(frozen=True)
class Subject:
    """The experiment that a report is on, and where its results are."""

    experiment: str
    """Its name."""
    params: Any
    """Its sections of the params file."""
    params_file: str
    """Where they are from."""
    models: Path
    """Folder of its models."""
    figures: Path
    """Folder of what the stages before the evaluation found, one folder a stage."""
    evaluation: Path
    """Folder of what the evaluation found."""
    commit: str
    """Version of the code."""
    runs: Mapping[str, str]
    """Digests of what was trained, with which runs are tagged, by the outputs' names."""
    drawn: str = ""
    """When the report is drawn, and on which machine; empty if nobody says."""
    trained: str = ""
    """How long the trainings took; empty if it is not known."""
    policies: Path | None = None
    """Folder of its policy; None if nobody says."""


@dataclass(frozen=True)
class Written:
    """What tracking keeps of a report."""

    headline: dict[str, float]
    """The figures that a table of runs should show."""
    verdict: str
    """The report in a sentence or two."""
    card: Card | None = None
    """What stands beside the delivered model; None for no more than the verdict."""
