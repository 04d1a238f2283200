from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from learning import ENSEMBLE, car_samples

from addressed_dynamics.base.versions import hash_sources
from addressed_dynamics.training import checkpoints
from addressed_dynamics.training.checkpoints import Checkpoint, code_version
from addressed_dynamics.training.ensemble import train_ensemble

FEATURES, TRAIN, VALIDATION = car_samples()


def of(folder: Path, *, seed: int = 0, **changes: Any) -> Checkpoint:
    """The checkpoint of a training whose params are those of the stage, as the pipeline names it."""
    params = ENSEMBLE.model_copy(update=changes)
    return Checkpoint.of(
        folder, title="car", params={"ensemble": params.model_dump(mode="json"), "seed": seed}, data=TRAIN.fingerprint()
    )


def epochs_made_by_resuming(checkpoint: Checkpoint) -> int:
    """How many epochs a training that finds `checkpoint` has behind it."""
    return len(checkpoint.load()[0])


@pytest.fixture
def interrupted(tmp_path: Path) -> Path:
    trained = train_ensemble(TRAIN, VALIDATION, ENSEMBLE, seed=0, loss_unit=1.0, checkpoint=of(tmp_path))
    assert len(list(islice(trained, 3))) == 3
    return tmp_path


def test_a_training_is_resumed_with_another_number_of_processes_or_with_more_seeds(interrupted: Path) -> None:
    assert epochs_made_by_resuming(of(interrupted, processes=7)) == 3
    assert epochs_made_by_resuming(of(interrupted, seeds=(0, 1, 2))) == 3


def test_one_more_variant_loses_no_checkpoint_but_a_training_has_its_own(tmp_path: Path) -> None:
    def named(variant: str, **addressing: Any) -> Path:
        return Checkpoint.of(tmp_path, params={"addressing": addressing, "variant": variant}).path

    assert named("plain", variants=["plain"], deliver="plain") == named("plain", variants=["plain", "cost_sensitive"])
    assert named("plain") != named("cost_sensitive")


def test_a_training_with_another_seed_or_other_params_is_not_resumed(interrupted: Path) -> None:
    assert epochs_made_by_resuming(of(interrupted, seed=1)) == 0
    assert epochs_made_by_resuming(of(interrupted, epochs=7)) == 0


def test_a_training_is_not_resumed_by_another_version_of_the_code(
    interrupted: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert epochs_made_by_resuming(of(interrupted)) == 3
    monkeypatch.setattr(checkpoints, "code_version", lambda: "another")
    assert epochs_made_by_resuming(of(interrupted)) == 0


def test_the_version_of_the_code_is_that_of_all_files_that_decide_a_training() -> None:
    package = Path(checkpoints.__file__).parent.parent
    for name in ("training/update.py", "networks/stacked.py", "features/common/samples.py", "base/torch_runtime.py"):
        source = package / name
        assert any(source == path or path in source.parents for path in checkpoints.SOURCES), name
    assert code_version() == hash_sources(checkpoints.SOURCES)
    assert all(path.exists() for path in checkpoints.SOURCES)


def test_an_edit_a_new_file_and_another_name_each_change_the_version_and_compiled_code_does_not(tmp_path: Path) -> None:
    folder = tmp_path / "training"
    (folder / "deep").mkdir(parents=True)
    (folder / "one.py").write_text("a = 1")
    (folder / "deep" / "two.py").write_text("b = 2")
    versions = [hash_sources([folder])]
    (folder / "__pycache__").mkdir()
    (folder / "__pycache__" / "one.cpython-311.pyc").write_bytes(b"compiled")
    assert hash_sources([folder]) == versions[0]
    (folder / "deep" / "two.py").write_text("b = 3")
    versions.append(hash_sources([folder]))
    (folder / "three.py").write_text("")
    versions.append(hash_sources([folder]))
    (folder / "three.py").rename(folder / "four.py")
    versions.append(hash_sources([folder]))
    assert len(set(versions)) == len(versions)
    elsewhere = tmp_path / "moved" / "training"
    elsewhere.parent.mkdir()
    folder.rename(elsewhere)
    assert hash_sources([elsewhere]) == versions[-1]
