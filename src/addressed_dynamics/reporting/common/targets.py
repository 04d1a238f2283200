"""Something to be reached, and what was."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Target:
    """Something to be reached, and what was."""

    name: str
    """What is measured."""
    wanted: str
    """Bound with its origin."""
    found: str
    """What was measured."""
    met: bool | None
    """Whether it was reached; None if it could not be measured."""
