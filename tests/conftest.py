"""Settings of all tests."""

from hypothesis import settings

# A deadline is a timing assertion: it fails on a busy machine, and speed lives in benchmarks/.
settings.register_profile("no_deadline", deadline=None)
settings.load_profile("no_deadline")
