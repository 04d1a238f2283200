"""Settings of all tests."""

import os
import shutil
from pathlib import Path

import pytest
from filelock import FileLock
from hypothesis import settings
from pipeline_clones import KINDS, STAGES, dvc, new_clone, stages_run

# Two threads that wait for each other on a busy machine take ten times as long as one; trainings have one each anyway.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# A deadline is a timing assertion: it fails on a busy machine, and speed lives in benchmarks/.
settings.register_profile("no_deadline", deadline=None)
settings.load_profile("no_deadline")

LONGEST = (
    "test_pipeline.py",
    "test_stages.py",
    "test_tracking.py",
    "test_import_bad_logs.py",
    "test_third_kind.py",
    "test_interruptions.py",
    "test_pipeline_changes.py",  # when test_pipeline.py has made what it changes
    "test_registry.py",
    "test_exporting.py",
    "test_report.py",
)
"""Files that take long: begun first, they are not what one worker does while the others have nothing left to do."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files; the order within a file stays."""
    places = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path.name, len(LONGEST)))


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """A clone in which the pipeline has run once, for all kinds of data: whoever needs it first makes it for all."""
    base = tmp_path_factory.getbasetemp()
    shared = base if worker_id == "master" else base.parent
    with FileLock(shared / "finished.lock"):
        clone, done = shared / "finished", shared / "finished.done"
        if not done.exists():
            clone.mkdir()
            new_clone(clone)
            expected = [f"{stage}@{experiment}" for stage in STAGES for experiment in KINDS]
            assert sorted(stages_run(dvc(clone, "repro"))) == sorted(expected)
            done.touch()
    return clone


@pytest.fixture
def clone(finished: Path, tmp_path: Path) -> Path:
    """A copy of the finished clone, to change."""
    return Path(shutil.copytree(finished, tmp_path / "clone", symlinks=True))
