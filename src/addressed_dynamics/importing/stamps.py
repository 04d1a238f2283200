"""The time that a message says of itself, beside the times at which it was published and logged."""

from __future__ import annotations

from typing import Any

from addressed_dynamics.importing.paths import MissingField, member, shown

STAMPS = (("header", "stamp"), ("stamp",), ("timestamp",))
"""Where a message has its own time: ROS's header, or a field as in Foxglove's schemas."""
SECONDS = ("sec", "secs", "seconds")
NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")


def own_time(message: Any) -> int:
    """Return the time that a decoded message says of itself, in nanoseconds since 1970.

    Raises:
        ValueError: it has none that is known.
    """
    for steps in STAMPS:
        stamp = _lookup(message, *steps)
        seconds = next((found for name in SECONDS if (found := _lookup(stamp, name)) is not None), None)
        nanoseconds = next((found for name in NANOSECONDS if (found := _lookup(stamp, name)) is not None), None)
        if isinstance(seconds, int) and isinstance(nanoseconds, int):
            return seconds * 10**9 + nanoseconds
    known = ", ".join(shown(steps).lstrip(".") for steps in STAMPS)
    text = f"says no time of itself (looked for {known}, with seconds and nanoseconds); give its topic another 'time'"
    raise ValueError(text)


def _lookup(value: Any, *steps: str) -> Any:
    """Return what is there, None if nothing is."""
    for step in steps:
        try:
            value = member(value, step)
        except MissingField:
            return None
    return value
