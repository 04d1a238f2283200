"""Reading what was measured of motion: what is missing or damaged is named."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motion_report_examples import FRAMES, OWN, arrays, candidate, example, write_results
from report_examples import FILES, NEEDED

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.reporting.common.missing import remedy_of
from addressed_dynamics.reporting.motion.results import load_motion_results

MOTION_FILES = [path for name, path in FILES.items() if name not in {"learner.csv", "horizon.csv"}]
MOTION_NEEDED = [path for path in MOTION_FILES if path in NEEDED]


def refusal(folder: Path) -> str:
    with pytest.raises(ReportError) as caught:
        load_motion_results(folder / "figures", folder / "evaluation")
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_what_was_written_is_read(tmp_path: Path) -> None:
    results = load_motion_results(*write_results(tmp_path))
    assert results.evaluation.own.test.raw == 0.2
    assert results.evaluation.own_group == OWN
    assert set(results.arrays.loops) == set(results.arrays.frames) == {f"{OWN}/seed-0", "phase_functioned/seed-0"}
    assert len(results.arrays.loops[f"{OWN}/seed-0"].joint_position) == FRAMES


@pytest.mark.parametrize("name", MOTION_NEEDED)
def test_a_missing_file_is_named(tmp_path: Path, name: str) -> None:
    write_results(tmp_path)
    (tmp_path / name).unlink()
    path = tmp_path / name
    assert refusal(tmp_path) == f"{path}: missing, so there is nothing to report; '{remedy_of(path)}' makes it"


@pytest.mark.parametrize("name", MOTION_FILES)
def test_a_damaged_file_is_named(tmp_path: Path, name: str) -> None:
    write_results(tmp_path)
    (tmp_path / name).write_bytes(b"\xff\xfe not what it was")
    assert refusal(tmp_path).startswith(f"{tmp_path / name}: ")


def test_a_missing_key_is_named_with_its_path(tmp_path: Path) -> None:
    document = example()
    del document["candidates"][f"{OWN}/seed-0"]["closed_loop"]["score"]
    write_results(tmp_path, **document)
    assert f"candidates.{OWN}/seed-0.closed_loop.score: Field required" in refusal(tmp_path)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"delivered": {"seed": 5, "mode": "argmax"}}, f"'{OWN}/seed-5' is delivered, but was not measured"),
        ({"reference": {"gaits": []}}, "there is no gait 'all'"),
    ],
)
def test_an_evaluation_without_what_the_report_is_about_is_refused(
    tmp_path: Path, changes: dict[str, Any], said: str
) -> None:
    write_results(tmp_path, **changes)
    assert said in refusal(tmp_path)


def test_a_candidate_without_held_out_clips_is_refused(tmp_path: Path) -> None:
    document = example()
    document["candidates"]["ridge"]["one_step"].pop("test")
    write_results(tmp_path, **document)
    assert "candidates.ridge: Value error, there are no errors on held-out clips (test)" in refusal(tmp_path)


def test_a_run_without_a_judgement_of_moving_is_refused(tmp_path: Path) -> None:
    document = example()
    run = document["candidates"]["ridge"]["closed_loop"]["run"]
    run["kinds"] = [each for each in run["kinds"] if each["kind"] != "moving"]
    write_results(tmp_path, **document)
    assert "none of 'moving'" in refusal(tmp_path)


def test_arrays_without_the_delivered_model_are_refused(tmp_path: Path) -> None:
    _, target = write_results(tmp_path)
    np.savez(target / "arrays.npz", **arrays(("phase_functioned/seed-0",)))
    assert f"there is nothing of {OWN}/seed-0; run evaluate again" in refusal(tmp_path)


def test_arrays_of_something_else_are_refused(tmp_path: Path) -> None:
    _, target = write_results(tmp_path)
    np.savez(target / "arrays.npz", observation=np.zeros(3))
    assert "not the arrays that the evaluate stage writes" in refusal(tmp_path)


def test_other_modes_of_the_ensemble_are_no_models_of_their_own(tmp_path: Path) -> None:
    reports, target = write_results(tmp_path)
    found = load_motion_results(reports, target).evaluation
    assert list(found.models) == [OWN, "phase_functioned", "total_parameters", "persistence", "ridge"]
    assert list(found.modes) == ["argmax", "sample"]
    document = json.loads((target / "evaluation.json").read_text())
    assert (
        set(document["candidates"]) - {each for group in found.groups for each in (group, f"{group}/seed-0")} == set()
    )
    assert candidate("ridge", None)["seed"] is None
