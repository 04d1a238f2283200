import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from pipeline_clones import (
    AFTER_MOTION_ADDRESSING,
    MOTION_EXPERIMENTS,
    MOTION_STAGES,
    dvc,
    edit_params,
    new_clone,
    stages_run,
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clone in which the pipeline has run once for motion alone."""
    clone = new_clone(tmp_path_factory.mktemp("clone"))
    edit_params(clone, "experiments: [mountaincar, acrobot]", "experiments: []")
    edit_params(clone, "recorded: [mountaincar, acrobot]", "recorded: []")
    expected = [f"{stage}@{experiment}" for stage in MOTION_STAGES for experiment in MOTION_EXPERIMENTS]
    assert sorted(stages_run(dvc(clone, "repro"))) == sorted(expected)
    return clone


@pytest.fixture
def clone(finished: Path, tmp_path: Path) -> Path:
    """A copy of the finished clone, to change."""
    return Path(shutil.copytree(finished, tmp_path / "clone", symlinks=True))


@pytest.mark.slow
def test_the_motion_ends_in_an_evaluation_of_every_model(finished: Path) -> None:
    evaluation = json.loads((finished / "data" / "reports" / "pfnn" / "evaluation.json").read_text(encoding="utf-8"))
    groups = {each["group"] for each in evaluation["candidates"].values()}
    modes = {f"ensemble/{mode}" for mode in ("argmax", "sample", "mixture", "blend")}
    assert groups == modes | {"phase_functioned", "mean", "persistence", "ridge"}
    assert f"ensemble/{evaluation['delivered']['mode']}" in modes
    with np.load(finished / "data" / "evaluation" / "pfnn" / "arrays.npz") as arrays:
        assert arrays["loop.phase_functioned/seed-0.joint_position"].shape == (3600, 31, 3)


@pytest.mark.slow
def test_a_change_of_the_addressing_of_motion_runs_that_and_what_uses_it_again(clone: Path) -> None:
    edit_params(clone, "tie_share: 0.9", "tie_share: 0.8")
    assert stages_run(dvc(clone, "repro")) == [f"{stage}@pfnn" for stage in AFTER_MOTION_ADDRESSING]


@pytest.mark.slow
def test_clips_of_ones_own_take_the_place_of_those_that_are_made_up_and_are_followed(clone: Path) -> None:
    shutil.copytree(clone / "data" / "raw" / "pfnn", clone / "clips")
    edit_params(clone, "motions: {pfnn: data/raw/pfnn}", "motions: {pfnn: clips}")
    edit_params(clone, "made_up: [pfnn]", "made_up: []")
    # The same clips elsewhere: the tables are the same, so nothing after them runs.
    assert stages_run(dvc(clone, "repro", "--downstream", "import_motion@pfnn")) == ["import_motion@pfnn"]
    for path in (clone / "clips").glob("Walker_stroll*"):
        path.unlink()
    ran = stages_run(dvc(clone, "repro", "train_motion_ensemble@pfnn"))
    assert ran == ["import_motion@pfnn", "train_motion_ensemble@pfnn"]
