"""All candidates in one table."""

from typing import Any

from report_examples import evaluation_json

from addressed_dynamics.evaluation.transitions.records import Evaluation
from addressed_dynamics.reporting.common.candidates import Effort
from addressed_dynamics.reporting.transitions.overview import overview_table
from addressed_dynamics.reporting.transitions.tables import NOISE_FLOOR

FLOOR = {
    "neighbours": 10, "transitions": 300, "among": 1400, "scaled": 2e-6, "percent": 0.25,
    "absolute": {"position": 3e-4, "velocity": 4e-5},
}  # fmt: skip


def measured(**changes: Any) -> dict[str, Any]:
    document = evaluation_json(**changes)
    for each in document["candidates"].values():
        each["one_step"]["percent"] = 0.5
    own, other = (document["candidates"][name] for name in ("ensemble/argmax", "total_parameters/seed-0"))
    own["rollouts"]["horizon"] = {"seconds": 33.333, "lost": False}
    other |= {"multiply_adds": 5678, "rollouts": other["rollouts"] | {"horizon": {"seconds": 2.5, "lost": True}}}
    return document


def test_every_candidate_has_costs_an_error_and_a_horizon_if_it_can_be_rolled_out() -> None:
    found = Evaluation.model_validate(measured(noise_floor=FLOOR))
    table = overview_table(found, {"ensemble": Effort(77, 4928), "total_parameters/seed-0": Effort(77, 900)})
    assert table is not None
    assert len(table.rows) == len(found.candidates) + 1
    rows = dict(zip([*found.candidates, "floor"], table.rows, strict=True))
    assert rows["ensemble/argmax"].cells[1:] == ("1,234", "–", "77", "0.50", "> 33.3")
    assert rows["ensemble/argmax"].kind == "own"
    assert rows["total_parameters/seed-0"].cells[1:] == ("1,234", "5,678", "77", "0.50", "2.50")
    assert rows["ensemble/oracle"].cells[1:] == ("1,234", "–", "77", "0.50", "–")
    assert rows["floor"].cells == (NOISE_FLOOR, "–", "–", "–", "0.25", "–")
    assert "until it reaches 10 % in the median rollout" in table.caption


def test_results_of_earlier_versions_have_no_such_table() -> None:
    assert overview_table(Evaluation.model_validate(evaluation_json()), {}) is None
