"""The first screen of a report says which model, how good in units and how far to trust it, or what is missing."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reading_pages import front_sentences, words_seen
from report_examples import CAR, FILES, evaluation_json, origin, summary, transitions_report, write_results

from addressed_dynamics.evaluation.transitions.records import Evaluation
from addressed_dynamics.reporting.common.blocks import Front, Report
from addressed_dynamics.reporting.common.charts import MOST_SHOWN
from addressed_dynamics.reporting.common.render import render_html, render_markdown
from addressed_dynamics.reporting.transitions.front import INTERVAL, beside
from addressed_dynamics.reporting.transitions.paper import PAPER
from addressed_dynamics.reporting.transitions.results import load_results

SECONDS = CAR.step_seconds
NOTHING = "persistence/seed-0"


def after(steps: int, error: float, *, rollouts: int = 5, interval: bool = False) -> dict[str, Any]:
    dimensions = {"position": error, "velocity": error / 100}
    return {
        "steps": steps,
        "rollouts": rollouts,
        "percent": 100 * error,
        "median_percent": 90 * error,
        "dimensions": dimensions,
        "interval": {name: 2 * value for name, value in dimensions.items()} if interval else None,
    }


def document(**changes: Any) -> dict[str, Any]:
    found = evaluation_json(**changes)
    candidates = found["candidates"]
    candidates[NOTHING] = candidates["wide/seed-0"] | {"label": "nothing changes"}
    for name, error in (("ensemble/argmax", 0.01), ("total_parameters/seed-0", 0.02), ("wide/seed-0", 0.03),
                        (NOTHING, 0.3)):  # fmt: skip
        times = [after(steps, error * steps**0.5, interval=name == "ensemble/argmax") for steps in (1, 10, 20)]
        candidates[name] = candidates[name] | {"errors_after": times}
    return found


def report(folder: Path, found: dict[str, Any], *, paper: bool = False) -> Report:
    figures, evaluation = write_results(folder)
    (folder / FILES["evaluation.json"]).write_text(json.dumps(found))
    return transitions_report(load_results(figures, evaluation), origin(), PAPER["mountaincar"] if paper else None)


def front(folder: Path, found: dict[str, Any]) -> Front:
    made = report(folder, found).front
    assert made is not None
    return made


def test_the_errors_stand_in_units_and_in_percent_beside_the_best_other_and_nothing(tmp_path: Path) -> None:
    table = front(tmp_path, document()).errors
    assert table is not None
    assert [column.header for column in table.columns[1:4]] == ["this model", "one large network", "no change"]
    assert table.columns[4].group == f"after 10 steps, {10 * SECONDS:.3g} s"
    everything, position, velocity = (row.cells for row in table.rows)
    assert everything[:4] == ("all, % of the range", "1.0\u202f%", "2.0\u202f%", "30\u202f%")
    # The features of the example have a range of 1 in each dimension.
    assert position[:4] == ("position (m)", "0.010 (1.0)", "0.020 (2.0)", "0.30 (30)")
    assert velocity[1] == "0.00010 (0.010)"


def test_one_step_is_judged_on_all_test_transitions_as_where_models_are_compared(tmp_path: Path) -> None:
    found = document()
    one_step = found["candidates"]["ensemble/argmax"]["one_step"]
    one_step["percent"] = 12.0
    one_step["dimensions"][0]["squared"] = summary(0.0144)
    table = front(tmp_path, found).errors
    assert table is not None
    everything, position, _ = (row.cells for row in table.rows)
    assert everything[1:5] == ("12\u202f%", "2.0\u202f%", "30\u202f%", "3.2\u202f%")
    assert position[1] == "0.12 (12)"
    assert f"of one step over all {found['test']['transitions']:,} test transitions, then over" in table.caption
    assert "which begin where it is easier (their first steps: 1.0\u202f%)" in table.caption
    one_step["percent"] = 2.0
    table = front(tmp_path / "again", found).errors
    assert table is not None
    assert "easier" not in table.caption


def test_the_chart_has_the_errors_of_the_median_rollout_and_the_interval(tmp_path: Path) -> None:
    chart = front(tmp_path, document()).chart
    assert chart is not None
    assert [view.choice for view in chart.views] == [("all, % of the range",), ("position",), ("velocity",)]
    assert chart.views[0].places == pytest.approx([SECONDS, 10 * SECONDS, 20 * SECONDS])
    own = chart.views[1].lines[0]
    assert own.name == "addressed ensemble"
    assert own.values[0] is None
    assert own.values[1:] == pytest.approx([(1e-5 * steps) ** 0.5 for steps in (10, 20)], rel=5e-4)
    everything = chart.views[0].lines[0]
    assert everything.values[1:] == pytest.approx([100 * (1e-5 * steps) ** 0.5 for steps in (10, 20)], rel=5e-4)
    (interval,) = (line for line in chart.views[1].lines if line.name == INTERVAL)
    assert interval.values == pytest.approx([0.02 * steps**0.5 for steps in (1, 10, 20)], rel=5e-4)
    shown = [line for line in chart.views[0].lines if line.shown and line.style != "area"]
    assert len(shown) <= MOST_SHOWN
    assert len({line.name for line in chart.views[0].lines}) == len(chart.views[0].lines)


def test_intervals_that_were_measured_against_the_horizon_are_drawn_as_they_are(tmp_path: Path) -> None:
    figures, evaluation = write_results(tmp_path)
    (tmp_path / FILES["evaluation.json"]).write_text(json.dumps(document()))
    path = tmp_path / FILES["horizon.csv"]
    header, *rows = path.read_text().splitlines()
    added = [f"{row},{0.5 + index},0.25,0.125,{2 + index}" for index, row in enumerate(rows)]
    path.write_text("\n".join([f"{header},interval_%,interval.position,interval.velocity,error_%_p50", *added]))
    made = transitions_report(load_results(figures, evaluation), origin(), None).front
    assert made is not None
    assert made.chart is not None
    everything, position, _ = made.chart.views
    assert everything.places == pytest.approx([10 * SECONDS, 20 * SECONDS])  # and not where nothing was measured
    assert everything.lines[0].values == (2.0, 3.0)
    assert [line.values for line in everything.lines if line.name == INTERVAL] == [(0.5, 1.5)]
    assert [line.values for line in position.lines if line.name == INTERVAL] == [(0.25, 0.25)]


@pytest.mark.parametrize("paper", [False, True])
def test_the_first_screen_has_six_sentences_at_most_and_no_talk_of_the_paper(tmp_path: Path, paper: bool) -> None:
    page = render_html(report(tmp_path, document(), paper=paper))
    sentences = front_sentences(page)
    assert 3 <= len(sentences) <= 6
    assert "paper" not in page.partition('<section id="front">')[2].partition("</section>")[0]
    assert words_seen(page) < 2500


def test_only_the_report_of_an_experiment_of_the_paper_has_its_figures(tmp_path: Path) -> None:
    titles = [section.title for section in report(tmp_path, document()).sections]
    assert "The paper's figures" not in titles


def test_no_difference_is_told_from_few_rollouts(tmp_path: Path) -> None:
    found = document()
    for candidate in found["candidates"].values():
        if "rollouts" in candidate:
            candidate["rollouts"]["groups"]["all"]["rollouts"] = 5
    (words,) = (each for each in front(tmp_path, found).sentences if "chance" in each)
    assert words == "With 5 rollouts, fewer than 20, no difference from “one large network” can be told from chance."


def test_from_many_rollouts_a_difference_is_told_where_the_intervals_decide(tmp_path: Path) -> None:
    found = document()
    for candidate in found["candidates"].values():
        if "rollouts" in candidate:
            candidate["rollouts"]["groups"]["all"]["rollouts"] = 40
    (tmp_path / "clear").mkdir()
    assert any(
        "beats “one large network”, the best of the others, by more than chance" in each
        for each in front(tmp_path / "clear", found).sentences
    )
    ratio = {"value": 1.5, "low": 0.7, "high": 3.0}
    found["candidates"]["total_parameters/seed-0"]["beside_ensemble"] = {
        "one_step": ratio, "rollouts": ratio, "dimensions": dict.fromkeys(CAR.observation_names, ratio),
    }  # fmt: skip
    (tmp_path / "unclear").mkdir()
    assert (
        "No clear difference from “one large network”, the best of the others: chance could make it."
        in front(tmp_path / "unclear", found).sentences
    )


def test_the_recommended_model_is_named_where_another_is_delivered(tmp_path: Path) -> None:
    score = {"one_step_percent": 1.0, "rollout_percent": 1.0, "horizon_seconds": 3.0}
    recommendation = {
        "candidate": "wide/seed-0", "label": "one wide network", "beats_references": True, "rollouts": 9,
        "scores": {"ensemble/argmax": score, "wide/seed-0": score},
    }  # fmt: skip
    found = document(recommendation=recommendation)
    assert beside(Evaluation.model_validate(found)).other == "wide/seed-0"
    made = front(tmp_path, found)
    assert made.sentences[0].endswith('one wide network does better over whole rollouts: load it with '
                                      'candidate="recommended".')  # fmt: skip
    assert made.load.endswith('AddressedDynamics.load("data/models/mountaincar")')


def test_results_of_earlier_versions_say_what_is_missing_and_what_makes_it(tmp_path: Path) -> None:
    made = front(tmp_path, evaluation_json())
    assert made.errors is None
    errors, trust = made.missing
    assert errors == (
        "The errors after a step, 1 s and 10 s in units are missing in these results: 'dvc repro evaluate@mountaincar' "
        "makes them."
    )
    assert "'dvc repro evaluate@mountaincar'" in trust
    assert made.answers["Trust it for"] == "not measured"
    assert made.chart is not None


def test_a_report_without_rollouts_says_so_on_the_first_screen_and_in_its_section(tmp_path: Path) -> None:
    found = evaluation_json()
    for candidate in found["candidates"].values():
        candidate.pop("rollouts", None)
    figures, evaluation = write_results(tmp_path)
    (tmp_path / FILES["evaluation.json"]).write_text(json.dumps(found))
    (tmp_path / FILES["horizon.csv"]).write_text("group,model,horizon\n")
    with np.load(evaluation / "arrays.npz") as arrays:
        kept = {name: values[:0] if name.startswith("rollout_") else values for name, values in arrays.items()}
    np.savez(evaluation / "arrays.npz", **kept)
    made = transitions_report(load_results(figures, evaluation), origin(), None)
    assert made.front is not None
    assert (made.front.chart, made.front.film) == (None, None)
    text = render_markdown(made)
    assert text.count("There are no rollouts, so nothing is known beyond one step") == 2
