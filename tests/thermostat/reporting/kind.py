"""A report in one sentence."""

import json
from pathlib import Path

from addressed_dynamics.reporting.common.blocks import Column, Report, Section, Table, Text
from addressed_dynamics.reporting.common.render import write_report
from addressed_dynamics.reporting.common.written import Subject, Written


def write(subject: Subject, target: Path) -> Written:
    """Write the report."""
    found = json.loads((subject.evaluation / "evaluation.json").read_text(encoding="utf-8"))
    verdict = f"The room is off by {found['mean_error']:.3g} degrees."
    sections = tuple(Section(name, (Text((f"{value:.3g} degrees",)),)) for name, value in found.items())
    targets = Table("Targets.", (Column("what"),), ())
    write_report(Report(subject.params.title, subject.experiment, verdict, (), targets, sections), target)
    return Written(found, verdict)
