"""Recordings that are larger than a block: the same bytes however they are cut, and memory that does not grow."""

import gc
import os
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_logs import SECOND, Timed, json_log, save, source, states_and_commands
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.importing import import_logs, mcap_logs, series, spool
from addressed_dynamics.importing.assessing import assess
from addressed_dynamics.importing.median import median
from addressed_dynamics.importing.spool import Spool

BY_GAP = {"by": "gap", "seconds": 0.5}
LONGEST_GROWTH_BYTES = 10
"""Memory for each further message that an import may need."""


def cut_in(rows: int, patch: pytest.MonkeyPatch) -> None:
    """Let blocks have so many rows, and nothing wait in memory."""
    for module in (spool, series, mcap_logs):
        patch.setattr(module, "BLOCK_ROWS", rows)
    patch.setattr(spool, "IN_MEMORY_BYTES", 1)


def imported(folder: Path, out: str, **changes: Any) -> dict[str, bytes] | str:
    """All files that an import writes, or why it is refused."""
    try:
        import_logs(
            source(**({"files": [str(folder / "logs" / "*.mcap")]} | changes)),
            folder / out,
            name="arm",
            progress=lambda _: None,
        )
    except LogError as error:
        return str(error)
    return {path.name: path.read_bytes() for path in (folder / out).iterdir()}


@st.composite
def recordings(draw: st.DrawFn) -> list[Timed]:
    """States and commands with silences, steps back, values that are missing, and a label that changes."""
    generator = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    messages = list[Timed]()
    at = 100 * SECOND
    for i in range(draw(st.integers(5, 60))):
        wait = generator.choice([0.0, 0.04, 0.05, 0.3, 1.0, -3.0], p=[0.1, 0.4, 0.35, 0.1, 0.03, 0.02])
        at += round(wait * SECOND)
        late = round(generator.choice([0.0, 0.1], p=[0.9, 0.1]) * SECOND)
        value = generator.choice([i / 7, float("nan")], p=[0.95, 0.05])
        if generator.random() < 0.7 or i == 0:
            messages.append(("/joint_states", at - late, {"position": [value, i % 3], "run": i // 20}))
        if generator.random() < 0.5 or i == 0:
            messages.append(("/cmd", at + SECOND // 100, {"torque": i / 4}))
    return messages


SOURCES: list[dict[str, Any]] = [
    {},
    {"episode": BY_GAP, "tolerance_s": 0.4},
    {"episode": {"by": "reset"}, "tolerance_s": 0.4},
    {"episode": {"by": "reset"}, "tolerance_s": 0.4, "topics": {"/cmd": {"hold": True}}},
    {"episode": {"by": "topic", "field": "/joint_states.run"}, "tolerance_s": 0.4},
    {"truncated": "/cmd.torque", "tolerance_s": 0.4},
]


@given(messages=recordings(), changes=st.sampled_from(SOURCES), rows=st.integers(1, 9))
@settings(max_examples=60, deadline=None)
def test_blocks_of_any_size_make_the_same_bytes(
    messages: list[Timed], changes: dict[str, Any], rows: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = save(tmp_path_factory.mktemp("blocks"), a=json_log(messages))
    expected = imported(folder, "whole", **changes)
    with pytest.MonkeyPatch.context() as patch:
        cut_in(rows, patch)
        assert imported(folder, "cut", **changes) == expected


def test_an_episode_longer_than_many_blocks_is_one_episode(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(tmp_path, a=json_log(states_and_commands(seconds=20)))
    expected = imported(tmp_path, "whole")
    assert isinstance(expected, dict)
    assert set(expected) == {"0000-a.mcap", "import.json"}
    judged = assess(source(files=[str(tmp_path / "logs" / "*.mcap")]))
    cut_in(7, monkeypatch)
    assert imported(tmp_path, "cut") == expected
    assert assess(source(files=[str(tmp_path / "logs" / "*.mcap")])) == judged


@given(numbers=st.lists(st.integers(0, 2**62) | st.integers(0, 9)), places=st.lists(st.integers(0, 40), max_size=4))
def test_the_median_is_that_of_all_numbers_at_once(numbers: list[int], places: list[int]) -> None:
    blocks = np.split(np.array(numbers, dtype=np.int64), sorted(min(place, len(numbers)) for place in places))
    assert median(lambda: blocks) == (float(np.median(numbers)) if numbers else None)


@given(counts=st.lists(st.integers(0, 9)), borders=st.tuples(st.integers(0, 90), st.integers(0, 90)))
def test_rows_come_back_as_they_were_put_aside(counts: list[int], borders: tuple[int, int]) -> None:
    rows = np.zeros(sum(counts), np.dtype([("a", np.int64), ("b", np.float64, (2,))]))
    rows["a"], rows["b"] = np.arange(len(rows)), np.arange(2 * len(rows)).reshape(-1, 2)
    start, stop = sorted(min(border, len(rows)) for border in borders)
    with pytest.MonkeyPatch.context() as patch:
        cut_in(4, patch)
        found = Spool(rows.dtype)
        for part in np.split(rows, np.cumsum(counts)[:-1]) if counts else []:
            found.append(part)
        blocks = list(found.blocks(start, stop))
    assert len(found) == len(rows)
    assert [len(block) for block in blocks[:-1]] == [4] * (len(blocks) - 1)
    np.testing.assert_array_equal(np.concatenate([rows[:0], *blocks]), rows[start:stop])


def open_files() -> list[str]:
    """What this process has open."""
    return sorted(str(each.readlink()) for each in Path("/proc/self/fd").iterdir() if each.is_symlink())


@pytest.fixture
def aside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which imports put aside what is more than a few rows."""
    folder = tmp_path / "aside"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr("tempfile.tempdir", None)
    cut_in(5, monkeypatch)
    return folder


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="looks at the open files of the process")
@pytest.mark.parametrize("stop", [None, KeyboardInterrupt, LogError])
def test_nothing_is_left_of_what_was_put_aside(aside: Path, tmp_path: Path, stop: type[BaseException] | None) -> None:
    save(tmp_path, a=json_log(states_and_commands(seconds=20)))
    gc.collect()  # what other tests left to be collected is not to be missed afterwards
    before = open_files()
    seen: list[str] = []

    def progress(_: int) -> None:
        seen.extend(open_files())
        if stop is not None:
            raise stop

    def run() -> None:
        import_logs(source(files=[str(tmp_path / "logs" / "*.mcap")]), tmp_path / "out", name="arm", progress=progress)

    if stop is None:
        run()
    else:
        with pytest.raises(stop):
            run()
        assert list((tmp_path / "out").iterdir()) == []
    assert any(str(aside) in each for each in seen)
    assert list(aside.iterdir()) == []
    gc.collect()
    assert open_files() == before


def test_a_full_disk_is_one_line_that_says_where(aside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(tmp_path, a=json_log(states_and_commands(seconds=20)))

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tempfile.SpooledTemporaryFile.write", full)
    assert imported(tmp_path, "out") == (
        f"{aside}: what an import sets aside cannot be written there (No space left on device); make room, or let "
        "TMPDIR name a folder that has some"
    )


def write_long(path: Path, count: int) -> Path:
    """A log of so many messages, half of them states at 100 Hz."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start()
        kind = writer.register_schema("std_msgs/msg/Float64", "ros2msg", b"float64 data")
        channels = [writer.register_channel(topic, "cdr", kind) for topic in ("/u", "/q")]
        for i in range(count):
            data = b"\0\1\0\0" + struct.pack("<d", (i % 1000) / 7)
            writer.add_message(channels[i % 2], i * 5_000_000, data, i * 5_000_000)
        writer.finish()
    return path


PEAK = """
import resource, sys
from pathlib import Path
from foreign_logs import source
from addressed_dynamics.importing import import_logs
fields = {"observation": {"q": {"field": "/q.data"}}, "action": {"continuous": {"u": {"field": "/u.data"}}}}
section = source(files=[sys.argv[1]], rate_hz=100.0, tolerance_s=0.02, **fields)
import_logs(section, Path(sys.argv[1]).with_suffix(""), name="long", progress=lambda _: None)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems count memory in other units")
def test_memory_hardly_grows_with_the_number_of_messages(tmp_path: Path) -> None:
    counts = (100_000, 500_000)
    tests = Path(__file__).parents[1]
    path = os.pathsep.join([str(tests), *sys.path])
    peaks = []
    for count in counts:
        log = write_long(tmp_path / f"{count}.mcap", count)
        command = [sys.executable, "-c", PEAK, str(log)]
        found = subprocess.run(
            command, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=True
        )
        peaks.append(int(found.stdout))
    assert peaks[1] - peaks[0] < LONGEST_GROWTH_BYTES * (counts[1] - counts[0])
