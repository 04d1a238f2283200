"""What `inspect` finds: the figures of sound files, and the first problem of all others."""

import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import CAR, RUN, append_rows, car_transitions, write_log
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rich.console import Console, RenderableType
from strategies import transitions

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.cli.inspection import FileInspection, Inspection, inspect_file, log_files
from addressed_dynamics.cli.terminal import file_view, folder_view
from addressed_dynamics.logs import TransitionLogWriter

START_NS = 1_700_000_000_000_000_000


def write_foreign(path: Path, **options: Any) -> Path:
    """Write a robot's log: 100 messages at 10 Hz with a hole of 5 s, one message of another topic, none of a third."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=500, **options)
        writer.start(profile="ros2", library="robot 3")
        schema = writer.register_schema("Imu", "jsonschema", b"{}")
        imu = writer.register_channel("/imu", "json", schema)
        stop = writer.register_channel("/stop", "cdr", 0)
        writer.register_channel("/unused", "json", schema)
        for number in range(100):
            late = 5_000_000_000 if number >= 60 else 0
            writer.add_message(imu, START_NS + number * 100_000_000 + late, b'{"x": %d}' % number, 0)
        writer.add_message(stop, START_NS + 1, b"", 0)
        writer.finish()
    return path


def shown(path: Path) -> str:
    """Return what the terminal shows of a file."""
    return printed(file_view(inspect_file(path)))


def printed(view: RenderableType) -> str:
    """Return what the terminal shows."""
    terminal = io.StringIO()
    Console(file=terminal, width=120).print(view)
    return terminal.getvalue()


@given(whole=transitions())
@settings(max_examples=30, deadline=None)
def test_the_figures_of_a_log_are_those_of_its_transitions(
    whole: Any, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = write_log(tmp_path_factory.mktemp("log") / "car.mcap", whole)
    found = inspect_file(path)
    episodes = list(whole.episode_slices())
    assert found.problem is None
    assert found.run == RUN
    assert found.size == path.stat().st_size
    assert found.messages == len(whole) + len(episodes)
    experience = found.experience
    assert experience is not None
    assert experience.transitions == len(whole)
    assert experience.lengths.tolist() == [rows.stop - rows.start for rows in episodes]
    for rows, total in zip(episodes, experience.returns, strict=True):
        assert total == pytest.approx(whole.reward[rows].sum(dtype=np.float64), rel=1e-6)
    terminated = sum(bool(whole.terminated[rows.stop - 1]) for rows in episodes)
    assert experience.ended.get("terminated", 0) == terminated
    assert experience.ended.get("truncated", 0) == len(episodes) - terminated
    for index, name in enumerate(whole.spec.observation_names):
        states = np.concatenate([whole.observation[:, index], whole.next_observation[:, index]])
        assert experience.ranges[f"observation.{name}"] == (states.min(), states.max())
    for dimension, values in zip(whole.spec.exogenous, whole.exogenous.T, strict=True):
        assert experience.ranges[f"exogenous.{dimension.name}"] == (values.min(), values.max())
        assert experience.units.get(f"exogenous.{dimension.name}", "") == dimension.unit
    json.dumps(found.to_json(), allow_nan=False)


@pytest.mark.parametrize("compression", CompressionType)
def test_any_file_has_its_topics_with_rates_and_gaps(tmp_path: Path, compression: CompressionType) -> None:
    path = write_foreign(tmp_path / "robot.mcap", compression=compression)
    found = inspect_file(path)
    assert (found.problem, found.run, found.experience) == (None, None, None)
    assert (found.profile, found.library.split("; ")[0]) == ("ros2", "robot 3")
    imu, stop, unused = found.topics
    assert (imu.name, imu.schema, imu.encoding, imu.messages) == ("/imu", "Imu", "json", 100)
    assert imu.rate_hz == pytest.approx(99 / 14.9)
    assert imu.longest_gap_seconds == pytest.approx(5.1)
    assert (stop.schema, stop.encoding, stop.messages, stop.rate_hz) == ("", "cdr", 1, None)
    assert (unused.messages, unused.rate_hz, unused.longest_gap_seconds) == (0, None, None)
    assert (found.start_ns, found.end_ns) == (START_NS, START_NS + 14_900_000_000)
    assert sum(found.compression.values()) > 1
    assert list(found.compression) == [compression.name.lower()]
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert sum(found.compression.values()) == summary.statistics.chunk_count
    assert "2023-11-14T22:13:20.000+00:00" in shown(path)


def test_a_file_without_chunks_and_one_without_messages_are_whole(tmp_path: Path) -> None:
    found = inspect_file(write_foreign(tmp_path / "robot.mcap", use_chunking=False))
    assert (found.problem, found.messages, dict(found.compression)) == (None, 101, {})
    with (tmp_path / "none.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()
    found = inspect_file(tmp_path / "none.mcap")
    assert (found.problem, found.topics, found.start_ns) == (None, (), None)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (b"hello\n", "byte 0 should begin an MCAP log"),
        (b"\x89MCAP", "byte 0 should begin"),
        (b"\x28\xb5\x2f\xfd log", "this is a compressed file, not an MCAP log; undo it with 'zstd -d some.mcap'"),
        (b"\x1f\x8b log", "this is a compressed file, not an MCAP log; undo it with 'gunzip some.mcap'"),
    ],
)
def test_what_is_no_log_is_a_problem(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "some.mcap"
    path.write_bytes(content)
    problem = inspect_file(path).problem
    assert problem is not None
    assert problem.message.startswith(message)
    assert f"Problem: {message}" in shown(path)


def test_of_an_unfinished_log_everything_before_its_end_is_shown(tmp_path: Path) -> None:
    whole = car_transitions([20, 20, 20])
    writer = TransitionLogWriter(tmp_path / "car.mcap", CAR, run=RUN)
    for rows in list(whole.episode_slices())[:2]:
        append_rows(writer, whole, rows)
        writer.end_episode(None, cut=False)
    writer.abandon()
    found = inspect_file(tmp_path / "car.mcap.partial")
    assert found.problem is not None
    assert found.problem.offset == found.size
    assert "addressed-dynamics recover" in found.problem.message
    assert found.run == RUN
    assert found.experience is not None
    assert found.experience.lengths.tolist() == [20, 20]


def test_a_flipped_byte_is_told_with_its_chunk_and_what_is_before_it_is_shown(tmp_path: Path) -> None:
    path = write_foreign(tmp_path / "robot.mcap")
    data = bytearray(path.read_bytes())
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    third = summary.chunk_indexes[2]
    data[third.chunk_start_offset + third.chunk_length // 2] ^= 1
    path.write_bytes(data)
    found = inspect_file(path)
    assert found.problem is not None
    assert found.problem.offset == third.chunk_start_offset
    assert "recover" not in found.problem.message
    assert 0 < found.messages < 101


def test_a_message_of_an_undeclared_channel_is_a_problem(tmp_path: Path) -> None:
    with (tmp_path / "robot.mcap").open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start()
        writer.add_message(7, 0, b"", 0)
        writer.finish()
    problem = inspect_file(tmp_path / "robot.mcap").problem
    assert problem is not None
    assert "channel 7" in problem.message


@given(data=st.data())
@settings(max_examples=150, deadline=None)
def test_no_damage_is_more_than_a_problem(data: Any, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("damage")
    ours = data.draw(st.booleans())
    path = write_log(folder / "a.mcap", car_transitions([3, 2])) if ours else write_foreign(folder / "a.mcap")
    messages = inspect_file(path).messages
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    content = content[: data.draw(st.integers(0, len(content)))]
    path.write_bytes(content)
    found = inspect_file(path)
    json.dumps(found.to_json(), allow_nan=False)
    assert ("Problem" in shown(path)) == (found.problem is not None)
    # Not every byte of a file is protected: some are names, and some are written anew as they were.
    assert found.problem is not None or found.messages == messages
    assert found.problem is None or "\n" not in found.problem.message


def test_gaps_and_missing_first_steps_are_counted(tmp_path: Path) -> None:
    whole = car_transitions([20, 20])
    with TransitionLogWriter(tmp_path / "car.mcap", CAR, run=RUN) as writer:
        late = replace(whole.select(slice(5, 20)))
        append_rows(writer, late, slice(0, 15))
        writer.end_episode(None, cut=False)
    experience = inspect_file(tmp_path / "car.mcap").experience
    assert experience is not None
    assert (experience.late_starts, experience.gaps) == (1, 0)
    assert "episodes without their first steps: 1" in shown(tmp_path / "car.mcap")


def test_a_folder_has_the_totals_of_its_files(tmp_path: Path) -> None:
    (tmp_path / "deeper").mkdir()
    write_log(tmp_path / "a.mcap", car_transitions([2, 3]))
    write_log(tmp_path / "deeper" / "b.mcap", car_transitions([4], seed=1))
    write_foreign(tmp_path / "c.mcap")
    (tmp_path / "d.mcap.partial").touch()
    (tmp_path / "notes.txt").touch()
    files = log_files(tmp_path)
    assert [file.name for file in files] == ["a.mcap", "c.mcap", "d.mcap.partial", "b.mcap"]
    found = Inspection(tuple(map(inspect_file, files)))
    assert (found.damaged, found.messages) == (1, 7 + 101 + 5)
    assert found.experience is not None
    assert found.experience.lengths.tolist() == [2, 3, 4]
    assert found.to_json()["totals"]["experience"]["length"] == {"min": 2.0, "median": 3.0, "max": 4.0}
    text = printed(folder_view(found, [tmp_path]))
    assert "4, 1 of them with a problem" in text
    assert "d.mcap.partial: the file is empty" in text


def test_logs_of_different_spaces_have_no_totals_of_experience(tmp_path: Path) -> None:
    whole = car_transitions([2])
    write_log(tmp_path / "a.mcap", whole)
    write_log(tmp_path / "b.mcap", replace(whole, spec=replace(CAR, step_seconds=1.0)))
    found = Inspection(tuple(map(inspect_file, log_files(tmp_path))))
    assert all(file.experience for file in found.files)
    assert found.experience is None


def test_nothing_to_inspect_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="there is no such file or folder"):
        log_files(tmp_path / "nothing")
    with pytest.raises(LogError, match="expected MCAP files"):
        log_files(tmp_path)


def test_a_name_in_a_foreign_file_does_not_command_the_terminal(tmp_path: Path) -> None:
    with (tmp_path / "robot.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="[bold]\x1b[31m")
        writer.register_channel("/\x1b]0;owned\x07[red]", "json", 0)
        writer.finish()
    text = shown(tmp_path / "robot.mcap")
    assert "\x1b" not in text
    assert "[bold]?[31m" in text
    assert "[red]" in text


def test_a_file_that_vanishes_is_a_problem(tmp_path: Path) -> None:
    found = inspect_file(tmp_path / "gone.mcap")
    assert isinstance(found, FileInspection)
    assert found.problem is not None
    assert "no such log" in found.problem.message
