"""What the report says of rollouts, by groups, and of Acrobot's beside what is possible at best."""

import json
from typing import Any

import numpy as np
from acrobot_recordings import acrobot_spaces
from report_examples import OTHERS, evaluation, evaluation_json, horizon_rows

from addressed_dynamics.evaluation.transitions.records import Evaluation, RolloutPhysics
from addressed_dynamics.reporting.common.numbers import MISSING, scientific
from addressed_dynamics.reporting.transitions.figures.physics import angles_and_energy
from addressed_dynamics.reporting.transitions.paper import PAPER
from addressed_dynamics.reporting.transitions.rollout_tables import energy_table, lost_table, rollout_tables
from addressed_dynamics.reporting.transitions.tables import one_step_table
from addressed_dynamics.reporting.transitions.verdict import findings

SEGMENTS = {"learning": 3, "zero_torque": 2}
NEVER = {"p10": None, "median": None, "p90": None, "never_share": 1.0}


def acrobot(**changes: Any) -> tuple[Evaluation, RolloutPhysics]:
    found = evaluation(spaces=acrobot_spaces(), wall_free=None, segments=SEGMENTS, **changes)
    assert found.rollouts.physics is not None
    return found, found.rollouts.physics


def test_rollouts_beside_an_environment_are_told_apart_by_wall_contact_in_one_table() -> None:
    (table,) = rollout_tables(evaluation((1e-7, 1e-6)), PAPER["mountaincar"])
    titles = ["Model", "all", "no wall", "wall", "all", "no wall", "wall", "leave the bounds"]
    assert [column.header for column in table.columns] == titles
    assert table.caption.startswith(
        "Free-running rollouts (50 in all, 30 without and 20 with wall contact): mean squared"
    )
    assert table.rows[0].cells == ("the paper, one rollout figure", "2.225\u202f×\u202f10⁻⁵", "", "", *(
        "4.859\u202f×\u202f10⁻⁸", "", "", ""
    ))  # fmt: skip
    assert table.rows[1].cells[1:] == (*[scientific(1e-6)] * 6, "25.0\u202f%")


def test_rollouts_that_fly_off_are_counted_for_every_model() -> None:
    document = evaluation_json((1e-7, 1e-6))
    document["candidates"] = {
        name: each | {"rollouts": each["rollouts"] | {"flown_off_share": 0.5 * (number % 2)}}
        for number, (name, each) in enumerate(document["candidates"].items())
        if "rollouts" in each
    }
    (table,) = rollout_tables(Evaluation.model_validate(document), PAPER["mountaincar"])
    assert [column.header for column in table.columns][-2:] == ["leave the bounds", "fly off"]
    assert [row.cells[-1] for row in table.rows][:3] == ["", "50.0\u202f%", "0"]
    assert all(len(row.cells) == len(table.columns) for row in table.rows)
    assert "more than 1 times its width, or is no number." in table.caption


def test_many_dimensions_have_a_table_for_each_segment() -> None:
    found, _ = acrobot()
    everything, learning, swinging = rollout_tables(found, None)
    assert (
        "5 stretches of 30 steps from held-out episodes, 3 from learning and 2 from zero torque" in everything.caption
    )
    assert "none from brief swings, whose longest held-out episode has 12 steps" in everything.caption
    assert "those from segment learning alone" in learning.caption
    assert "those from segment zero torque alone" in swinging.caption
    assert [len(each.columns) for each in (everything, learning, swinging)] == [8, 7, 7]
    for each in (everything, learning, swinging):
        assert all(len(row.cells) == len(each.columns) for row in each.rows)


def test_episodes_that_are_too_short_are_named_where_they_are_missing() -> None:
    found, _ = acrobot()
    assert "too short" not in rollout_tables(found, None)[0].caption + one_step_table(found, {}, None).caption
    values = evaluation_json(spaces=acrobot_spaces(), wall_free=None, segments=SEGMENTS)
    values["test"]["dropped"] = {"episodes": 1, "rows": 4}
    values["rollouts"]["dropped"] = {"episodes": 12, "rows": 1300}
    short = Evaluation.model_validate_json(json.dumps(values))
    words = "12 held-out episodes with together 1,300 steps are too short for a stretch"
    assert words in rollout_tables(short, None)[0].caption
    words = "Left out: one held-out episode of 4 steps is too short for the history that networks are given."
    assert words in one_step_table(short, {}, None).caption


def test_a_segment_called_wall_is_no_wall() -> None:
    found = evaluation(spaces=acrobot_spaces(), wall_free=None, segments={"no_wall": 3, "wall": 2})
    assert "wall contact" not in " ".join(findings(found, None))
    assert "wall contact" not in rollout_tables(found, None)[0].caption


def test_the_time_to_the_limit_stands_below_what_is_possible_at_best() -> None:
    table = lost_table(*acrobot())
    assert "passes 0.5 rad in free-running rollouts of 15 s" in table.caption
    assert table.groups == (("", 1), ("all (5)", 3), ("learning (3)", 3), ("zero torque (2)", 3))
    first, second, *models = table.rows
    assert first.cells[:4] == ("simulation simulator/rounding", "7.25", MISSING, "25\u202f%")
    assert second.cells[0] == "simulation simulator/twin"
    assert [row.kind for row in models] == ["own", "", "", *["reference"] * len(OTHERS)]


def test_percentiles_are_of_twenty_rollouts_or_more() -> None:
    many = evaluation(spaces=acrobot_spaces(), wall_free=None, segments={"learning": 20, "zero_torque": 19})
    first = lost_table(many, many.rollouts.physics).rows[0]
    assert [first.cells[place] for place in (2, 5, 8)] == ["1.20 to > 15", "1.20 to > 15", MISSING]
    few = "They are fewer than 20: too few for percentiles"
    assert few in rollout_tables(acrobot()[0], None)[0].caption
    assert few not in rollout_tables(many, None)[0].caption


def test_episodes_and_the_rollouts_that_begin_in_them_are_counted_apart() -> None:
    values = evaluation_json(spaces=acrobot_spaces(), wall_free=None, segments={"learning": 20})
    values["candidates"]["ensemble/argmax"]["rollouts"]["groups"]["all"] |= {"episodes": 3, "rollouts": 20}
    values["rollouts"]["overlapping"] = True
    found = Evaluation.model_validate(values)
    caption = rollout_tables(found, None)[0].caption
    assert "beside 20 stretches of 30 steps from 3 held-out episodes, 20 from learning (from the" in caption
    assert "so they begin at equal distances and overlap; what is drawn for an interval is episodes" in caption
    assert "In 20 free-running rollouts of 30 steps beside 3 held-out episodes" in " ".join(findings(found, None))


def test_when_the_truth_is_lost_is_among_the_findings() -> None:
    text = " ".join(findings(acrobot()[0], None))
    assert "off by more than 0.5 rad after 7.25 s (median; in 25\u202f% of the rollouts it never is)" in text
    document = evaluation_json(spaces=acrobot_spaces(), wall_free=None, segments=SEGMENTS)
    for simulation in document["rollouts"]["physics"]["simulations"].values():
        simulation["groups"]["all"]["physics"]["lost_seconds"] = NEVER
    text = " ".join(findings(Evaluation.model_validate(document), None))
    assert "of two true simulations that start 1\u202f×\u202f10⁻⁶ rad apart, after more than 15.0 s." in text
    assert "off by more than" not in " ".join(findings(evaluation(), None))


def test_a_group_in_which_nothing_was_measured_is_empty() -> None:
    document = evaluation_json(spaces=acrobot_spaces(), wall_free=None, segments=SEGMENTS)
    document["candidates"]["ensemble/argmax"]["rollouts"]["groups"]["learning"]["physics"] = None
    found = Evaluation.model_validate(document)
    assert found.rollouts.physics is not None
    (own,) = (row for row in lost_table(found, found.rollouts.physics).rows if row.kind == "own")
    assert own.cells[4:7] == ("–", "–", "–")


def test_energy_stands_beside_that_of_the_recording() -> None:
    table = energy_table(*acrobot())
    assert [row.cells[0] for row in table.rows[:2]] == ["simulation truth", "simulation simulator/rounding"]
    assert table.rows[0].cells[1:3] == (scientific(1e-7), scientific(1e-7))
    assert table.rows[-1].cells[1:3] == (scientific(1e-5), scientific(1e-5))


def test_angles_and_energy_are_drawn_for_each_segment_and_for_all_only_without_segments() -> None:
    _, physics = acrobot()
    horizon: dict[str, dict[str, dict[str, np.ndarray]]] = {}
    for row in horizon_rows(acrobot_spaces(), {"zero_torque": 2}):
        columns = {name: np.array([value]) for name, value in row.items() if name not in {"group", "model"}}
        horizon.setdefault(row["group"], {})[row["model"]] = columns
    chart = angles_and_energy(horizon, physics)
    quantities = ["first angle", "second angle", "energy", "energy since the start"]
    assert [view.choice for view in chart.views] == [("zero torque", quantity) for quantity in quantities]
    first = chart.views[0]
    assert [line.name for line in first.lines if line.shown] == [
        "addressed ensemble", "two true simulations", "true simulator, recorded start",
    ]  # fmt: skip
    assert first.lines[0].values == (2e-4,)
    assert first.level == physics.angle_limit
    assert {view.choice[0] for view in angles_and_energy({"all": horizon["all"]}, physics).views} == {"all"}
