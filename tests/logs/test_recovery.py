import io
from itertools import pairwise

import numpy as np
import pytest
from builders import CAR, RUN, WINDY, append_rows, assert_same, car_transitions, fill_disk_after, write_log
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Metadata
from mcap.stream_reader import StreamReader
from strategies import random_transitions

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.episodes.transitions import COLUMNS
from addressed_dynamics.logs import TransitionLogWriter, read_log, recover_log

EXPECTED = car_transitions([20] * 6)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """The bytes of a log of six episodes of twenty steps, one chunk each, and where its chunks begin and end."""
    path = write_log(tmp_path_factory.mktemp("whole") / "car.mcap", EXPECTED, seeds=range(6))
    data = path.read_bytes()
    indexes = make_reader(io.BytesIO(data)).get_summary().chunk_indexes
    return data, [slice(each.chunk_start_offset, each.chunk_start_offset + each.chunk_length) for each in indexes]


@pytest.fixture
def recovered(tmp_path):
    """Write some bytes to a file and recover it: the report and the contents of the new log."""

    def recover(data):
        (tmp_path / "car.mcap").write_bytes(data)
        (tmp_path / "saved.mcap").unlink(missing_ok=True)
        report = recover_log(tmp_path / "car.mcap", tmp_path / "saved.mcap")
        contents = read_log(tmp_path / "saved.mcap")
        assert (report.transitions, report.episodes) == (len(contents.transitions), len(contents.episodes))
        assert report.cut_episodes == sum(record.ended == "cut" for record in contents.episodes)
        return report, contents

    return recover


def with_byte(data, offset, value=None):
    changed = bytearray(data)
    changed[offset] = changed[offset] ^ 255 if value is None else value
    return bytes(changed)


def without_episodes(*episodes):
    return EXPECTED.select(~np.isin(EXPECTED.episode, episodes))


def assert_all_but(contents, *episodes):
    """Compare with what was recorded, except for times, which begin anew in the new log."""
    expected = without_episodes(*episodes)
    for name in COLUMNS:
        if name != "time_ns":
            np.testing.assert_array_equal(getattr(contents.transitions, name), getattr(expected, name))
    assert [record.seed for record in contents.episodes] == [seed for seed in range(6) if seed not in episodes]
    assert contents.run == RUN


def test_an_intact_log_loses_nothing(log, recovered):
    report, contents = recovered(log[0])
    assert (report.losses, report.bytes_lost, report.transitions_missing) == ((), 0, 0)
    assert_same(contents.transitions, EXPECTED)
    assert_all_but(contents)


@given(share=st.floats(0, 1))
@settings(max_examples=60, deadline=None)
def test_a_log_cut_off_anywhere_keeps_every_complete_chunk(log, share, tmp_path_factory):
    data, chunks = log
    folder = tmp_path_factory.mktemp("cut")
    length = int(share * len(data))
    (folder / "car.mcap").write_bytes(data[:length])
    complete = sum(chunk.stop <= length for chunk in chunks)
    if complete:
        report = recover_log(folder / "car.mcap", folder / "saved.mcap")
        assert report.episodes == complete
        assert_same(read_log(folder / "saved.mcap").transitions, EXPECTED.select(slice(0, 20 * complete)))
    else:
        with pytest.raises(LogError, match=r"car\.mcap: "):
            recover_log(folder / "car.mcap", folder / "saved.mcap")
        assert not (folder / "saved.mcap").exists()


@given(where=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255), count=st.integers(1, 3))
@settings(max_examples=200, deadline=None)
def test_damage_anywhere_costs_at_most_the_chunks_it_touches_and_makes_nothing_up(
    log, where, value, count, tmp_path_factory
):
    data, chunks = log
    folder = tmp_path_factory.mktemp("damaged")
    offset = 8 + int(where * (len(data) - 8))
    changed = bytearray(data)
    changed[offset : offset + count] = bytes([value]) * len(changed[offset : offset + count])
    (folder / "car.mcap").write_bytes(changed)
    report = recover_log(folder / "car.mcap", folder / "saved.mcap")
    saved = read_log(folder / "saved.mcap")
    touched = {i for i, chunk in enumerate(chunks) if chunk.start < offset + count and offset < chunk.stop}
    missing = set(range(6)) - set(saved.transitions.episode.tolist())
    assert missing <= touched
    assert_all_but(saved, *missing)
    assert not missing or report.losses


@pytest.mark.parametrize("chunk", range(6))
def test_a_damaged_chunk_is_left_out_and_named_by_its_offset(log, recovered, chunk):
    data, chunks = log
    report, contents = recovered(with_byte(data, chunks[chunk].start + 60))
    assert_all_but(contents, chunk)
    (loss,) = report.losses
    assert loss.offset == chunks[chunk].start
    assert loss.size >= chunks[chunk].stop - chunks[chunk].start
    assert "is a chunk that cannot be unpacked" in loss.reason
    # How many followed the last one that was saved is not known.
    assert report.transitions_missing == (20 if chunk < 5 else 0)


def test_a_damaged_length_does_not_hide_the_chunks_after_it(log, recovered):
    data, chunks = log
    report, contents = recovered(with_byte(data, chunks[1].start + 8))
    assert_all_but(contents, 1)
    assert report.transitions_missing == 20


def test_a_chunk_whose_kind_is_damaged_is_still_saved(log, recovered):
    data, chunks = log
    for opcode in (Opcode.MESSAGE_INDEX, Opcode.DATA_END, Opcode.FOOTER, 0x86):
        assert_all_but(recovered(with_byte(data, chunks[2].start, opcode))[1])


def test_the_first_chunk_and_the_summary_are_not_needed_to_know_the_channels(log, recovered):
    data, chunks = log
    assert_all_but(recovered(with_byte(data, chunks[0].start + 60))[1], 0)
    unfinished = with_byte(data, chunks[0].start + 60)[: chunks[5].stop]
    assert_all_but(recovered(unfinished)[1], 0)


def test_a_damaged_run_record_is_taken_from_its_copy(log, recovered):
    data, _ = log
    offset = data.index(b"Some-v0")
    assert_all_but(recovered(with_byte(data, offset, ord("T")))[1])
    (record,) = [each for each in StreamReader(io.BytesIO(data)).records if isinstance(each, Metadata)]
    assert record.metadata["environment"] == "Some-v0"


def test_of_an_episode_with_a_gap_the_steps_before_the_gap_are_kept(tmp_path):
    path = write_log(tmp_path / "car.mcap", car_transitions([30_000, 10]))
    data = path.read_bytes()
    chunks = make_reader(io.BytesIO(data)).get_summary().chunk_indexes
    assert len(chunks) == 4
    path.write_bytes(with_byte(data, chunks[1].chunk_start_offset + 100))
    report = recover_log(path, tmp_path / "saved.mcap")
    contents = read_log(tmp_path / "saved.mcap")
    kept = contents.episodes[0].length
    assert 0 < kept < 15_000
    assert [(each.length, each.ended) for each in contents.episodes[:1]] == [(kept, "cut")]
    assert contents.transitions.truncated[kept - 1]
    assert contents.episodes[1].length == 10
    assert report.transitions_missing == 30_000 - kept
    assert report.cut_episodes == 1


def test_an_unfinished_last_episode_is_kept_and_marked_as_cut(tmp_path):
    expected = car_transitions([5, 30_000])
    writer = TransitionLogWriter(tmp_path / "car.mcap", CAR, run=RUN)
    append_rows(writer, expected, slice(0, 5))
    writer.end_episode(11, cut=False)
    append_rows(writer, expected, slice(5, 25_000))
    writer.abandon()
    report = recover_log(writer.partial, tmp_path / "car.mcap")
    contents = read_log(tmp_path / "car.mcap")
    first, last = contents.episodes
    assert (first.seed, last.seed, last.ended) == (11, None, "cut")
    assert last.length > 10_000
    assert contents.transitions.truncated[-1]
    assert report.cut_episodes == 1
    assert "the recording was not finished" in report.losses[-1].reason
    kept = len(contents.transitions)
    np.testing.assert_array_equal(contents.transitions.observation, expected.observation[:kept])


def test_a_recovered_log_can_be_recovered_again(log, recovered):
    data, chunks = log
    report, once = recovered(with_byte(data, chunks[3].start + 60))
    _, twice = recovered(report.target.read_bytes())
    assert_same(twice.transitions, once.transitions)
    assert twice.episodes == once.episodes


def test_chunks_lie_apart_in_the_log_these_tests_damage(log):
    _, chunks = log
    assert len(chunks) == 6
    assert all(before.stop < after.start for before, after in pairwise(chunks))


def test_nothing_is_overwritten(log, tmp_path):
    path = tmp_path / "car.mcap"
    path.write_bytes(log[0])
    with pytest.raises(LogError, match="the file exists, and a recovery overwrites nothing"):
        recover_log(path, path)
    assert path.read_bytes() == log[0]


@pytest.mark.parametrize(
    ("data", "problem"), [(b"", "the file is empty"), (b"PAR1", "should begin an MCAP log"), (None, "no such log")]
)
def test_what_is_no_log_cannot_be_recovered(tmp_path, data, problem):
    if data is not None:
        (tmp_path / "car.mcap").write_bytes(data)
    with pytest.raises(LogError, match=problem):
        recover_log(tmp_path / "car.mcap", tmp_path / "saved.mcap")


def test_a_log_without_a_single_episode_has_nothing_to_recover(tmp_path):
    writer = TransitionLogWriter(tmp_path / "car.mcap", CAR, run=RUN)
    append_rows(writer, EXPECTED, slice(0, 10))
    writer.abandon()
    with pytest.raises(LogError, match="no complete chunk of transitions is in it"):
        recover_log(writer.partial, tmp_path / "saved.mcap")


def test_a_full_disk_leaves_nothing_but_the_source(log, tmp_path, monkeypatch):
    (tmp_path / "car.mcap").write_bytes(log[0])
    fill_disk_after(monkeypatch, 5000)
    with pytest.raises(LogError, match=r"saved\.mcap: the new log cannot be written .*No space left.*; make room"):
        recover_log(tmp_path / "car.mcap", tmp_path / "saved.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["car.mcap"]


def test_exogenous_inputs_are_recovered_with_their_steps(tmp_path):
    expected = random_transitions(WINDY, [5, 7], np.random.default_rng(0))
    path = tmp_path / "windy.mcap"
    writer = TransitionLogWriter(path, WINDY, run=RUN)
    for rows in expected.episode_slices():
        append_rows(writer, expected, rows)
        writer.end_episode(None, cut=False)
    writer.abandon()
    recover_log(writer.partial, path)
    assert_same(read_log(path).transitions, expected)
