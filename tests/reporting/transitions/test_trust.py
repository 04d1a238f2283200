"""What the report says of trust, with all its parts and with some of them missing."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from acrobot_recordings import acrobot_spaces
from builders import CAR
from report_examples import (
    ACROBOT_ANGLES,
    evaluation_json,
    example_arrays,
    features_of,
    origin,
    transitions_report,
    write_results,
)

from addressed_dynamics.evaluation.transitions.records import Evaluation
from addressed_dynamics.evaluation.transitions.trust_records import TrustRecord
from addressed_dynamics.reporting.common.blocks import Block, Chart, Figure, Table, Text
from addressed_dynamics.reporting.transitions.figures.trust import map_dimensions, risk_curve
from addressed_dynamics.reporting.transitions.results import Arrays, load_results
from addressed_dynamics.reporting.transitions.trust import coverage_table, places_table, shifts_table, trust_blocks

TRUST: dict[str, Any] = {
    "coverage": [
        {"steps": steps, "asked": asked, "of_all": share, "dimensions": {"position": share, "velocity": share}}
        for steps, asked, share in ((1, 0.5, 0.51), (1, 0.9, 0.87), (10, 0.9, 0.97), (100, 0.9, 0.72))
    ],
    "shifts": {
        "fast": {"kind": "starts", "auroc": {"trust": 0.97, "surprise": 0.99, "spread": 0.8}, "positive_share": 1.0},
        "engine": {"kind": "mechanics", "auroc": {"trust": 0.55, "surprise": 0.93, "spread": 0.5}},
        "steep_slope": {"kind": "mechanics", "auroc": {"trust": 0.6, "surprise": 0.7}},
        "pushed": {"kind": "behaviour", "auroc": {"trust": None}, "positive_share": 0.0},
    },
    "risk": [
        {"coverage": (k + 1) / 20, "risk": 0.1 * (k + 1), "oracle": 0.05 * k + 1.05 * (k == 19)} for k in range(20)
    ],
    "places": [
        {
            "episode": 7,
            "step": 160,
            "steps": 20,
            "expected_percent": 0.23,
            "error_percent": 2.9,
            "trust": 0.36,
            "state": {"position": -1.1, "velocity": -0.0125},
        },
    ],
    "break_even_steps": 700,
    "rollout_steps": 1000,
    "trusted_steps": 120,
    "trusted_share": 0.1,
    "step_seconds": 0.5,
}
MAP = {"trust_map": np.array([[0.5, np.nan], [0.1, 1.0]]), "trust_map_edges": np.array([[0.0, 1.0, 2.0]] * 2)}


def record(**changes: Any) -> TrustRecord:
    """The example with these parts, or without those that are `...`."""
    values = {**TRUST, **changes}
    return TrustRecord.model_validate({name: value for name, value in values.items() if value is not ...})


def blocks(trust: TrustRecord | None, **arrays: Any) -> tuple[Block, ...]:
    return trust_blocks(trust, Arrays(**example_arrays(CAR, 2), **arrays), features_of(CAR))


def words(trust: TrustRecord | None, **arrays: Any) -> str:
    text = blocks(trust, **arrays)[0]
    assert isinstance(text, Text)
    return " ".join(text.paragraphs).replace("\u202f", " ")


def test_the_section_has_words_both_tables_the_curve_and_the_map() -> None:
    found = blocks(record(), **MAP)
    assert [type(block) for block in found] == [Text, Table, Table, Chart, Figure, Table]
    said = words(record(), **MAP)
    assert "Not measured" not in said
    assert (
        "intervals of 90 % hold 87.0 % one step ahead, 97.0 % 10 steps ahead and 72.0 % 100 steps ahead. "
        "100 steps ahead they are too narrow: allow for more." in said
    )
    assert "Trust the model's rollouts for 120 steps, 60.0 s: so long its 90 % intervals are at most 10 %" in said
    assert "From step 700 of a rollout on (350 s), to say that nothing changes is the better guess." in said
    assert (
        "Trust warns before a step goes wrong under “fast”; under “engine” only the surprise after the step does; "
        "under “steep slope” neither does reliably." in said
    )
    assert "The 50 % of the predictions that are trusted most have 50 % of the mean error of all" in said
    assert "in the best order it would be 22 %." in said


def test_a_coverage_is_judged_beside_what_was_asked_with_more_slack_for_more_steps() -> None:
    table = coverage_table(record().coverage)
    assert [row.cells[3] for row in table.rows] == ["as asked", "as asked", "too wide", "too narrow"]
    assert [column.header for column in table.columns[4:]] == ["position", "velocity"]
    assert table.rows[1].cells[:3] == ("1", "90\u202f%", "87.0\u202f%")
    edges = [{"steps": steps, "asked": 0.9, "of_all": share} for steps, share in ((1, 0.869), (10, 0.85), (10, 0.849))]
    found = coverage_table(record(coverage=edges).coverage)
    assert [row.cells[3] for row in found.rows] == ["too narrow", "as asked", "too narrow"]
    assert all(len(row.cells) == len(found.columns) == 4 for row in found.rows)


def test_places_are_named_by_episode_and_steps_with_their_state() -> None:
    table = places_table(record().places)
    assert table.rows[0].cells == ("7", "160–179", "0.230", "2.90", "0.36", "-1.10", "-0.0125")
    assert [column.header for column in table.columns[5:]] == ["position", "velocity"]


def test_scores_that_nobody_measured_are_named_and_have_no_column() -> None:
    table = shifts_table(record().shifts)
    assert [column.header for column in table.columns[3:]] == ["trust", "surprise", "spread of seeds"]
    assert table.rows[0].cells == ("fast", "other starts", "100.0\u202f%", "0.970", "0.990", "0.800")
    assert table.rows[2].cells == ("steep slope", "changed mechanics", "–", "0.600", "0.700", "–")
    assert table.rows[3].cells[2:] == ("0\u202f%", "–", "–", "–")
    assert table.caption.endswith("Not measured: distance, Mahalanobis and margin.")
    other = record(shifts={"fast": {"kind": "starts", "auroc": {"entropy": 0.5, "trust": 0.7}}}).shifts
    assert [column.header for column in shifts_table(other).columns[3:]] == ["trust", "entropy"]


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"coverage": ...}, "the coverage of intervals"),
        ({"shifts": ...}, "the test under shifts"),
        ({"risk": ...}, "the risk against coverage"),
        ({"trusted_steps": ...}, "the horizon of trust"),
        ({"break_even_steps": ...}, "the break-even horizon"),
    ],
)
def test_a_part_that_is_missing_is_named_and_the_rest_is_shown(changes: dict[str, Any], what: str) -> None:
    assert words(record(**changes), **MAP).endswith(f"Not measured: {what}.")
    assert len(blocks(record(**changes), **MAP)) == 6 - (what.split()[1] in {"coverage", "test", "risk"})


def test_without_anything_all_is_named_and_without_a_record_there_is_no_section() -> None:
    (text,) = blocks(TrustRecord())
    assert isinstance(text, Text)
    assert text.paragraphs == (
        "Not measured: the coverage of intervals, the test under shifts, the risk against coverage, the map of trust, "
        "places where more data would help, the horizon of trust and the break-even horizon.",
    )
    assert blocks(None) == ()


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        (
            {"break_even_steps": None},
            "The model is never worse than to say that nothing changes in rollouts of 1,000 steps, 500 s.",
        ),
        (
            {"break_even_steps": None, "compared_steps": 600},
            "The model is never worse than to say that nothing changes in rollouts of 600 steps, 300 s.",
        ),
        (
            {"break_even_steps": None, "rollout_steps": ...},
            "The model is never worse than to say that nothing changes.",
        ),
        ({"break_even_steps": 1, "step_seconds": ...}, "From step 1 of a rollout on, to say"),
        (
            {"trusted_steps": 0},
            "There is no horizon of trust: not even one step ahead are its 90 % intervals at most 10 %",
        ),
        ({"trusted_steps": 1000}, "Trust the model's rollouts to their end, 1,000 steps, 500 s: its 90 % intervals"),
        ({"coverage": TRUST["coverage"][:2]}, "hold 87.0 % one step ahead. Read an interval as what it says."),
    ],
)
def test_the_horizons_are_in_plain_words(changes: dict[str, Any], what: str) -> None:
    assert what in words(record(**changes, risk=...))


def test_there_is_no_curve_where_nothing_errs() -> None:
    assert risk_curve(()) is None
    exact = record(risk=[{"coverage": 1.0, "risk": 0.0, "oracle": 0.0}])
    assert risk_curve(exact.risk) is None
    assert "The 100" not in words(exact)


def test_the_map_is_of_the_first_two_angles_or_of_the_first_two_dimensions() -> None:
    assert [each.name for each in map_dimensions(features_of(CAR))] == ["position", "velocity"]
    angles = map_dimensions(features_of(acrobot_spaces(), ACROBOT_ANGLES))
    assert [(each.name, each.unit) for each in angles] == [("angle_1", "rad"), ("angle_2", "rad")]


def test_trust_is_a_section_of_the_report_and_earlier_results_have_none(tmp_path: Path) -> None:
    assert Evaluation.model_validate_json(json.dumps(evaluation_json())).trust is None
    figures, evaluation = write_results(tmp_path, trust=TRUST)
    np.savez(evaluation / "arrays.npz", **example_arrays(CAR, 2), **MAP)
    report = transitions_report(load_results(figures, evaluation), origin(CAR), None)
    titles = [section.title for section in report.sections]
    assert titles[:4] == ["The data", "Rollouts", "One step ahead", "Trust"]
    assert "trust-map" in {panel.name for panel in report.panels}
    assert "trust-risk" in {chart.name for chart in report.charts}
