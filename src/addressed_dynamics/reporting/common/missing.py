"""What is missing in a report, and the command that makes it."""

from pathlib import Path

STAGES = {
    "convert": "convert",
    "ensemble": "train_ensemble",
    "addressing": "train_addressing",
    "baselines": "train_baselines",
}
"""The stage that fills each folder of an experiment's figures."""


def remedy(stage: str, experiment: str) -> str:
    """Return the command that makes what a stage of the pipeline writes; `experiment` is empty if it is not known."""
    return f"dvc repro {stage}@{experiment}" if experiment else f"dvc repro {stage}"


def missing_words(what: str, stage: str, experiment: str) -> str:
    """Say that something is missing in these results, `what` with a capital letter, and how it comes into being."""
    return f"{what} missing in these results: '{remedy(stage, experiment)}' makes them."


def remedy_of(path: Path) -> str:
    """Return the command that makes a file in `figures/NAME/STAGE`, `policies/NAME` or `evaluation/NAME`."""
    if path.parent.parent.name == "policies":
        return remedy("train_policy", path.parent.name)
    if path.parent.name in STAGES:
        return remedy(STAGES[path.parent.name], path.parent.parent.name)
    return remedy("evaluate", path.parent.name)
