"""What tables say of the costs of candidates."""

from learning import ENSEMBLE, car_samples

from addressed_dynamics.reporting.common.comparison import (
    COST_COLUMNS,
    Effort,
    baseline_efforts,
    cost_cells,
    ensemble_effort,
)
from addressed_dynamics.training.ensemble import train_ensemble


def test_the_effort_of_an_ensemble_is_that_of_its_training() -> None:
    _, train, validation = car_samples()
    *_, last = train_ensemble(train, validation, ENSEMBLE, seed=0, loss_unit=1.0)
    assert ensemble_effort(ENSEMBLE, len(train)) == Effort(last.updates, last.samples)


def test_results_of_earlier_versions_have_no_samples() -> None:
    found = baseline_efforts({"wide/seed-0": {"updates": 77.0, "samples": 1232.0}, "old": {"updates": 5.0}, "none": {}})
    assert found == {"wide/seed-0": Effort(77, 1232), "old": Effort(5, None)}


def test_every_column_of_costs_has_its_cell_and_what_is_unknown_is_a_dash() -> None:
    assert cost_cells(1234, Effort(77, 1232), 5678) == ("1,234", "77", "1,232", "5,678")
    assert cost_cells(1234, Effort(77, None), None) == ("1,234", "77", "–", "–")
    assert cost_cells(1234, None, 0) == ("1,234", "–", "–", "0")
    assert len(cost_cells(1, None, None)) == len(COST_COLUMNS)
