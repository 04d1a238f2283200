"""What tables say of the costs of candidates."""

from dataclasses import dataclass

import pytest
from learning import ENSEMBLE, car_samples

from addressed_dynamics.reporting.common.blocks import Column
from addressed_dynamics.reporting.common.candidates import (
    Effort,
    candidate_columns,
    candidate_row,
    costless_row,
    effort_of,
    efforts_of,
    ensemble_effort,
)
from addressed_dynamics.training.ensemble import train_ensemble


@dataclass(frozen=True)
class Model:
    """A candidate of no kind."""

    label: str = "a model"
    parameters: int = 1234
    multiply_adds: int | None = 5678


def test_the_effort_of_an_ensemble_is_that_of_its_training() -> None:
    _, train, validation = car_samples()
    *_, last = train_ensemble(train, validation, ENSEMBLE, seed=0, loss_unit=1.0)
    assert ensemble_effort(ENSEMBLE, len(train)) == Effort(last.updates, last.samples)


def test_results_of_earlier_versions_have_no_samples() -> None:
    baselines = {"wide/seed-0": {"updates": 77.0, "samples": 1232.0}, "old": {"updates": 5.0}, "none": {}}
    assert efforts_of(baselines, ENSEMBLE, None) == {"wide/seed-0": Effort(77, 1232), "old": Effort(5, None)}


def test_every_way_to_use_the_ensemble_has_its_effort() -> None:
    efforts = efforts_of({"wide/seed-0": {"updates": 77.0}}, ENSEMBLE, 900)
    assert effort_of(efforts, "ensemble/argmax/seed-1") == ensemble_effort(ENSEMBLE, 900)
    assert effort_of(efforts, "wide/seed-0") == Effort(77, None)
    assert effort_of(efforts, "ridge") is None


@pytest.mark.parametrize(
    ("model", "effort", "costs"),
    [
        (Model(), Effort(77, 1232), ("1,234", "77", "1,232", "5,678")),
        (Model(multiply_adds=None), Effort(77, None), ("1,234", "77", "–", "–")),
        (Model(multiply_adds=0), None, ("1,234", "–", "–", "0")),
    ],
)
def test_every_column_of_costs_has_its_cell_and_what_is_unknown_is_a_dash(
    model: Model, effort: Effort | None, costs: tuple[str, ...]
) -> None:
    row = candidate_row(model, effort, ["0.1"], "own")
    assert row.cells == ("a model", *costs, "0.1")
    assert row.kind == "own"
    assert len(row.cells) == len(candidate_columns(Column("error")))
    assert candidate_row(model, effort, ["0.1"], "", title="seed 0").cells[0] == "seed 0"


def test_what_is_no_candidate_has_no_costs() -> None:
    row = costless_row("the paper", ["0.1"], "reference", "–")
    assert row.cells == ("the paper", "–", "–", "–", "–", "0.1")
