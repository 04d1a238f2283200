"""Settings of all tests."""

import os

from hypothesis import settings

# Two threads that wait for each other on a busy machine take ten times as long as one; trainings have one each anyway.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# A deadline is a timing assertion: it fails on a busy machine, and speed lives in benchmarks/.
settings.register_profile("no_deadline", deadline=None)
settings.load_profile("no_deadline")
