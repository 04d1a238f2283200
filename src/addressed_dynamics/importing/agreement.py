"""What the files of an import have to agree in."""

from collections.abc import Hashable
from typing import TypeVar

from addressed_dynamics.base.errors import LogError

Found = TypeVar("Found")


class Agreement:
    """Remembers what was found first, and refuses what differs from it: a schema, the length of an array."""

    def __init__(self) -> None:
        self._found: dict[str, tuple[Hashable, str]] = {}
        self._first: dict[str, object] = {}

    def first(self, what: str, found: Found) -> Found:
        """Return what was found first under this name, which is `found` if nothing was."""
        known = self._first.setdefault(what, found)
        assert isinstance(known, type(found))
        return known

    def check(self, what: str, found: Hashable, where: str) -> None:
        """Compare `found` with what was found first.

        Raises:
            LogError: they differ; the message names both places.
        """
        first, origin = self._found.setdefault(what, (found, where))
        if first != found:
            message = (
                f"{where}: {what} is {found}, but {first} in {origin}; "
                "import what belongs together, and make other experiments of the rest"
            )
            raise LogError(message)
