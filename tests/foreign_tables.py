"""What the tests of tables have in common: a small source, what it imports to, and what it says."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from foreign_logs import source

from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.importing import import_logs
from addressed_dynamics.sources.transitions.reading import read_transitions

TABLE = {
    "kind": "csv",
    "files": ["*.csv"],
    "observation": {"q": {"field": "q"}},
    "action": {"continuous": {"u": {"field": "u"}}},
    "rate_hz": 20.0,
    "tolerance_s": ...,
    "episode": {"by": "file"},
}
"""Tables with the columns `q` and `u`."""


def imported(table: dict[str, Any] = TABLE, /, **changes: Any) -> Transitions:
    """Import the tables of the folder that we are in by a source with some changes; `...` leaves a key out."""
    shutil.rmtree("out", ignore_errors=True)
    import_logs(source(**(table | changes)), Path("out"), name="arm", progress=lambda _: None)
    return read_transitions(Path("out"))


def refusal(table: dict[str, Any] = TABLE, /, **changes: Any) -> str:
    """Return the one line that the import is refused with."""
    with pytest.raises(AddressedDynamicsError) as caught:
        imported(table, **changes)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def account() -> dict[str, Any]:
    """Return what the import counted."""
    value: dict[str, Any] = json.loads(Path("out/import.json").read_text())
    return value


def lengths(transitions: Transitions) -> list[int]:
    """Return the number of transitions in each episode."""
    return [rows.stop - rows.start for rows in transitions.episode_slices()]
