"""The table of errors in multiples of the addressed ensemble's."""

from report_examples import OTHERS, beside, evaluation, evaluation_json

from addressed_dynamics.evaluation.transitions.records import Evaluation
from addressed_dynamics.reporting.transitions.paired import paired_table


def test_every_model_stands_beside_the_ensemble() -> None:
    document = evaluation_json()
    candidates = document["candidates"]
    candidates["ensemble/argmax"] = candidates["ensemble/argmax"] | {"beside_ensemble": beside((1.0, 1.0), (1.0, 1.0))}
    candidates[OTHERS[0]] |= {"label": "one network", "beside_ensemble": beside((0.5, 0.72), (1.25, 20.0))}
    table = paired_table(Evaluation.model_validate(document))
    assert [(row.cells, row.kind) for row in table.rows] == [
        (("some model", "1.00", "1.00 – 1.00", "1.00", "1.00 – 1.00"), "own"),
        (("one network", "0.600", "0.500 – 0.720", "5.00", "1.25 – 20.0"), "reference"),
    ]
    assert "The intervals hold 95\u202f% of 2,000 draws of as many episodes (4 one step ahead)" in table.caption


def test_what_has_no_ratio_is_missing_from_its_cells_and_not_from_the_table() -> None:
    document = evaluation_json()
    nothing = {"one_step": None, "rollouts": None, "dimensions": {}}
    document["candidates"][OTHERS[0]]["beside_ensemble"] = nothing
    (row,) = paired_table(Evaluation.model_validate(document)).rows
    assert row.cells[1:] == ("–",) * 4


def test_results_of_earlier_versions_have_no_such_table() -> None:
    assert paired_table(evaluation()) is None
