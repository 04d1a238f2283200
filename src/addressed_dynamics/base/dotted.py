"""Nested mappings by dotted keys, as params are named on a command line and in a table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any


def dotted(tree: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield what is in nested mappings by their keys, joined by dots; an empty mapping in there is a value, too.

    Args:
        tree: the outermost mapping; nothing is yielded if it is empty.
        prefix: what all keys begin with, its dot included.
    """
    for key, value in tree.items():
        if isinstance(value, Mapping) and value:
            yield from dotted(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
