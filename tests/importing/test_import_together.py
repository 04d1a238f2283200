"""Files that are read at the same time make what files that are read one after the other make: bytes and refusals."""

import pickle
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from foreign_logs import SECOND, json_log, save, source, states_and_commands
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter

from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.base.params.source import SourceParams
from addressed_dynamics.importing import import_logs, importer

NAMED = {"joint": {"field": "/joint_states.position[0]"}}
TABLE = {
    "kind": "parquet",
    "observation": {"q": {"field": "q[1]"}},
    "action": {"continuous": {"u": {"field": "u"}}},
    "reward": None,
    "rate_hz": 10.0,
    "clock": {"column": "t"},
    "episode": {"by": "file"},
    "min_length": 2,
}


def pickled_map(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Any]:
    """Do what other processes do: everything before anybody looks, with copies."""
    return iter([pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(function))(each))) for each in items])


@contextmanager
def other_processes(_count: int) -> Iterator[Any]:
    yield pickled_map


def outcome(section: SourceParams, folder: Path, cores: int) -> dict[str, bytes] | str:
    """All that an import writes, or why it is refused; then nothing is left but whole logs."""
    told: list[int] = []
    try:
        import_logs(section, folder, name="arm", progress=told.append, cores=cores)
    except AddressedDynamicsError as error:
        return str(error)
    files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*")}
    assert sum(told) > 0
    return files


def both(section: SourceParams, folder: Path) -> list[dict[str, bytes] | str]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(importer, "WORKER_BYTES", 1)
        patch.setattr(importer, "WORKER_TABLE_BYTES", 1)
        patch.setattr(importer, "worker_processes", other_processes)
        return [outcome(section, folder / str(cores), cores) for cores in (1, 2)]


def named_log(names: Sequence[str] | None, count: int, seconds: float) -> bytes:
    """A log with arrays of so many elements, beside their names if there are any; nothing in the first message."""
    messages = []
    for number, (topic, time, message) in enumerate(states_and_commands(seconds)):
        if topic == "/joint_states":
            position = [number / 7 + place for place in range(count)] if number else []
            message = {"position": position} | ({"names": list(names)} if names else {})
        messages.append((topic, time, message))
    return json_log(messages)


LOGS = st.lists(
    st.tuples(
        st.sampled_from([None, None, ("a", "b"), ("b", "a"), ("c", "a")]), st.integers(1, 2), st.integers(1, 3)
    ).map(lambda each: named_log(each[0], 2 if each[0] else each[1], each[2] / 4)),
    min_size=2,
    max_size=5,
)


@given(LOGS)
@settings(max_examples=15)
def test_whatever_the_files_show_each_other_the_bytes_and_the_refusals_are_the_same(logs: list[bytes]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save(folder, **{f"log_{number}": log for number, log in enumerate(logs)})
        alone, together = both(source(observation=NAMED, files=[str(folder / "logs" / "*.mcap")]), folder)
    assert together == alone


def test_what_a_file_in_between_shows_counts_for_those_after_it(tmp_path: Path) -> None:
    """The first has no names; alone, the third would take its own for those that the second has in another order."""
    save(tmp_path, a=named_log(None, 2, 1.0), b=named_log(("a", "b"), 2, 1.0), c=named_log(("b", "a"), 2, 1.0))
    alone, together = both(source(observation=NAMED, files=[str(tmp_path / "logs" / "*.mcap")]), tmp_path)
    assert together == alone
    assert isinstance(alone, dict)
    assert sorted(alone) == ["0000-a.mcap", "0001-b.mcap", "0002-c.mcap", "import.json"]
    assert b'"reordered": 20' in alone["import.json"]


def test_of_several_files_that_are_wrong_the_first_is_told(tmp_path: Path) -> None:
    good = json_log(states_and_commands())
    save(tmp_path, a=good, b=good, c=good[:-400], d=b"", e=good)
    alone, together = both(source(files=[str(tmp_path / "logs" / "*.mcap")]), tmp_path)
    assert together == alone
    assert "logs/c.mcap: byte" in str(alone)


def test_tables_are_read_together_in_the_order_of_their_times(tmp_path: Path) -> None:
    time = np.arange(30) / 10
    for number, start in enumerate([50.0, 0.0, 20.0]):
        # Most steps of the last are lost in float32, which is counted over all of them.
        q = [[0.0, (5e6 if number == 0 else 0.0) + each / 100] for each in time]
        polars.DataFrame({"t": time + start, "q": q, "u": time}).write_parquet(tmp_path / f"{number}.parquet")
    section = TypeAdapter(SourceParams).validate_python(TABLE | {"files": [str(tmp_path / "*.parquet")]})
    alone, together = both(section, tmp_path)
    assert together == alone
    assert isinstance(alone, dict)
    assert sorted(alone) == ["0000-1.mcap", "0001-2.mcap", "0002-0.mcap", "import.json"]
    assert b'"swallowed": {' in alone["import.json"]
    polars.DataFrame({"t": time + 90, "q": [[0.0, 1.0, 2.0]] * 30, "u": time}).write_parquet(tmp_path / "3.parquet")
    alone, together = both(section, tmp_path / "again")
    assert together == alone
    assert "the length of the arrays in column 'q' is 3, but 2 in" in str(alone)


def test_two_processes_give_the_bytes_of_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logs = {f"log_{number}": json_log(states_and_commands(1.0, (100 + number) * SECOND)) for number in range(4)}
    save(tmp_path, **logs)
    section = source(files=[str(tmp_path / "logs" / "*.mcap")])
    monkeypatch.setattr(importer, "WORKER_BYTES", 1)
    assert outcome(section, tmp_path / "two", 2) == outcome(section, tmp_path / "one", 1)
