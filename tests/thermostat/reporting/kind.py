"""A report of one sentence and one table; the rest is that of every report."""

from pathlib import Path

from addressed_dynamics.features.thermostat.kind import ThermostatFeatures

from addressed_dynamics.reporting.common.blocks import Column, Row, Section, Table
from addressed_dynamics.reporting.common.document import Account, write_account
from addressed_dynamics.reporting.common.origin import load_trained, origin_of
from addressed_dynamics.reporting.common.reading import read_json
from addressed_dynamics.reporting.common.results import Trainings, read_trainings
from addressed_dynamics.reporting.common.written import Subject, Written


def write(subject: Subject, target: Path) -> Written:
    """Write the report."""
    found = read_json(subject.evaluation / "evaluation.json", dict[str, float])
    rows = tuple(Row((name, f"{value:.3g}")) for name, value in found.items())
    table = Table("Errors in degrees.", (Column("Error", numeric=False), Column("degrees")), rows)
    verdict = f"The room is off by {found['mean_error']:.3g} degrees."
    account = Account(verdict, found=(Section("Errors", (table,)),))
    trained = load_trained(subject, ThermostatFeatures)
    origin = origin_of(subject, trained, trained.ensemble.features)
    write_account(account, Trainings(**read_trainings(subject.figures)), origin, subject, target)
    return Written(found, verdict)
