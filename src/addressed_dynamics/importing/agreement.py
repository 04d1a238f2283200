"""What the files of an import have to agree in."""

from __future__ import annotations

import copy
from collections.abc import Hashable
from typing import TypeVar

from addressed_dynamics.base.errors import LogError

Found = TypeVar("Found")


class Agreement:
    """Remembers what was found first, and refuses what differs from it: a schema, the length of an array."""

    def __init__(self) -> None:
        self._found: dict[str, tuple[Hashable, str]] = {}
        self._first: dict[str, object] = {}
        self._asked = set[str]()

    def first(self, what: str, found: Found) -> Found:
        """Return what was found first under this name, which is `found` if nothing was."""
        self._asked.add(what)
        known = self._first.setdefault(what, found)
        assert isinstance(known, type(found))
        return known

    def check(self, what: str, found: Hashable, where: str) -> None:
        """Compare `found` with what was found first.

        Raises:
            LogError: they differ; the message names both places.
        """
        self._asked.add(what)
        first, origin = self._found.setdefault(what, (found, where))
        if first != found:
            message = (
                f"{where}: {what} is {found}, but {first} in {origin}; "
                "import what belongs together, and make other experiments of the rest"
            )
            raise LogError(message)

    def copy(self) -> Agreement:
        """Return one that knows the same, and that nobody has asked yet."""
        other = copy.deepcopy(self)
        other._asked.clear()
        return other

    def learn(self, later: Agreement, given: Agreement) -> bool:
        """Learn what a file has shown, if it would have shown the same after all that is known here.

        Args:
            later: what was known after the file was read.
            given: what was known before.

        Returns:
            Whether it would: what it asked for is the same here as it was there. If not, nothing is learned.
        """
        for known, before in ((self._found, given._found), (self._first, given._first)):
            if any(known.get(what) != before.get(what) for what in later._asked):
                return False
        for known, after in ((self._found, later._found), (self._first, later._first)):
            known |= {what: after[what] for what in later._asked if what in after}
        return True
