"""What stands beside the candidates in the tables of one step."""

from report_examples import candidate, evaluation, evaluation_json

from addressed_dynamics.evaluation.transitions.records import Evaluation
from addressed_dynamics.reporting.common.numbers import scientific
from addressed_dynamics.reporting.transitions.tables import NOISE_FLOOR, one_step_table
from addressed_dynamics.reporting.transitions.verdict import findings

FLOOR = {
    "neighbours": 10, "transitions": 300, "among": 1400, "scaled": 2e-6, "percent": 0.25,
    "absolute": {"position": 3e-4, "velocity": 4e-5},
}  # fmt: skip


def test_the_noise_floor_is_the_last_row_without_costs_and_the_caption_says_how_it_was_found() -> None:
    table = one_step_table(evaluation(noise_floor=FLOOR), {}, None)
    title, *cells = table.rows[-1].cells
    assert title == NOISE_FLOOR
    assert cells == ["", "", "", "", scientific(2e-6), "–", "–", "–", scientific(3e-4), scientific(4e-5)]
    assert "300 of these transitions, each beside its 10 nearest among 1,400 training transitions" in table.caption


def test_hindsight_is_called_so_and_stands_beside_random_guesses_in_the_findings() -> None:
    document = evaluation_json((1e-6, 1e-6))
    document["candidates"]["ensemble/guesses"] = candidate(4e-6, 0.0)
    text = findings(Evaluation.model_validate(document), None)[0]
    assert text.endswith(
        "; in hindsight, with the best of the two subnetworks picked for every transition, the mean would be "
        f"{scientific(5e-7)}, 2.0 times lower, and with the best of as many random guesses of the same spread "
        f"{scientific(4e-6)}."
    )
    assert "knowledge of the truth" in one_step_table(Evaluation.model_validate(document), {}, None).caption


def test_without_a_noise_floor_there_is_no_such_row() -> None:
    table = one_step_table(evaluation(), {}, None)
    assert NOISE_FLOOR not in [row.cells[0] for row in table.rows]
    assert "noise floor" not in table.caption
