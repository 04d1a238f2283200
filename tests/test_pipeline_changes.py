"""What a change after a finished pipeline runs again, and what it leaves alone."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from example_command import overrides
from pipeline_clones import STAGES, dvc, edit_params, environment, stages_run, warm_interpreter
from stage_dependencies import ROOT

from addressed_dynamics.episodes.parquet import load_transitions

MEASURE = '''"""How long a model hesitates."""

from addressed_dynamics.evaluation.common.measures import Row


def measure(candidate, held_out):
    yield Row("hesitation", candidate.name, "", "mean", 41.5)
'''


@pytest.mark.slow
def test_a_change_of_the_addressing_runs_what_depends_on_it_again(clone: Path) -> None:
    edit_params(clone, "variants: [plain, cost_sensitive]", "variants: [cost_sensitive]")
    ran = stages_run(dvc(clone, "repro"))
    assert ran == [f"{stage}@mountaincar" for stage in ("train_addressing", "evaluate", "train_policy", "report")]


@pytest.mark.slow
def test_a_comment_in_the_features_of_a_kind_concerns_that_kind_alone_and_comes_to_the_same_bytes(clone: Path) -> None:
    def outputs() -> dict[str, bytes]:
        folders = [clone / "data" / name for name in ("models", "figures", "evaluation")]
        return {str(path): path.read_bytes() for folder in folders for path in folder.rglob("*") if path.is_file()}

    before = outputs()
    edited = clone / "src" / "addressed_dynamics" / "features" / "motion" / "features.py"
    edited.write_text(edited.read_text(encoding="utf-8") + "# edited\n", encoding="utf-8")
    # What is made with the features, or read with them; the tables are not.
    assert set(stages_run(dvc(clone, "repro", "evaluate@pfnn"))) == {f"{stage}@pfnn" for stage in STAGES[2:-2]}
    assert outputs() == before


@pytest.mark.slow
def test_clips_of_ones_own_take_the_place_of_those_that_are_made_up_and_are_followed(clone: Path) -> None:
    shutil.copytree(clone / "data" / "raw" / "pfnn", clone / "clips")
    edit_params(clone, "pfnn: {kind: motion, raw: data/raw/pfnn}", "pfnn: {kind: motion, raw: clips}")
    edit_params(clone, ", pfnn: motion}", "}")
    # The same clips elsewhere: the tables are the same, so nothing after them runs.
    assert stages_run(dvc(clone, "repro", "--downstream", "convert@pfnn")) == ["convert@pfnn"]
    for path in (clone / "clips").glob("Walker_stroll*"):
        path.unlink()
    ran = stages_run(dvc(clone, "repro", "train_ensemble@pfnn"))
    assert ran == ["convert@pfnn", "train_ensemble@pfnn"]


@pytest.mark.slow
def test_the_example_after_a_finished_pipeline_leaves_the_data_of_the_other_experiments_where_they_are(
    clone: Path,
) -> None:
    script = [warm_interpreter() / "python", "examples/pendulum/make_logs.py", "--episodes", "4", "--seconds", "6"]
    subprocess.run(script, cwd=clone, env=environment(clone), check=True, capture_output=True)
    before = {path: path.stat().st_size for path in (clone / "data").rglob("*") if path.is_file()}
    assert len(before) > 100
    settings = [part for setting in overrides(ROOT / "Makefile") for part in ("-S", setting)]
    ran = stages_run(dvc(clone, "exp", "run", "report@pendulum", *settings))
    # DVC leaves the order open in which the baselines are trained beside the ensemble.
    assert sorted(ran) == sorted(f"{stage}@pendulum" for stage in ("import", *STAGES[1:]))
    assert {path: path.stat().st_size for path in before if path.is_file()} == before
    transitions = load_transitions(clone / "data" / "tables" / "pendulum")
    assert len(list(transitions.episode_slices())) == 3 * 4
    assert transitions.spec.observation_names == ("angle", "speed")
    assert abs(transitions.observation[:, 0]).max() < 1.7
    evaluation = json.loads((clone / "data" / "evaluation" / "pendulum" / "evaluation.json").read_text())
    none = {"episodes": 0, "rows": 0}
    source = {
        "kind": "recorded", "steps": 30, "steps_wanted": 30, "too_short": {}, "dropped": none, "physics": None,
        "overlapping": True,
    }  # fmt: skip
    assert evaluation["rollouts"] == source
    assert set(evaluation["candidates"]["ensemble/argmax"]["rollouts"]["groups"]["all"]["mse"]) == {"angle", "speed"}
    report = (clone / "data" / "reports" / "pendulum" / "report.html").read_text(encoding="utf-8")
    assert "beside 20 stretches of 30 steps from 5 held-out episodes" in report
    assert "wall" not in report
    assert "the paper's " not in report.partition("Source")[0]


@pytest.mark.slow
def test_a_measure_in_a_file_of_its_own_is_shown_by_the_report(clone: Path) -> None:
    measures = clone / "src" / "addressed_dynamics" / "evaluation" / "transitions" / "measures"
    (measures / "hesitation.py").write_text(MEASURE, encoding="utf-8")
    ran = stages_run(dvc(clone, "repro", "report@mountaincar"))
    assert ran == ["evaluate@mountaincar", "report@mountaincar"]
    report = (clone / "data" / "reports" / "mountaincar" / "report.md").read_text(encoding="utf-8")
    assert "Hesitation: How long a model hesitates." in report
    assert re.search(r"\| ensemble, argmax[^|\n]* \| 41\.5 \|", report)
