"""Settings of all tests."""

import os

import pytest
from hypothesis import settings

# Two threads that wait for each other on a busy machine take ten times as long as one; trainings have one each anyway.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# A deadline is a timing assertion: it fails on a busy machine, and speed lives in benchmarks/.
settings.register_profile("no_deadline", deadline=None)
settings.load_profile("no_deadline")

LONGEST = (
    "test_pipeline.py",
    "test_import_bad_logs.py",
    "test_stages.py",
    "test_example.py",
    "test_third_kind.py",
    "test_tracking.py",
)
"""Files that take long: begun first, they are not what one worker does while the others have nothing left to do."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files; the order within a file stays."""
    places = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path.name, len(LONGEST)))
