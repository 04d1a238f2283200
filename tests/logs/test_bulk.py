"""Whole arrays into a log: the same messages as one by one, and the container that `mcap.Writer` would write."""

import io
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from builders import CAR, RUN, assert_same, car_transitions, fill_disk_after
from builders import write_log as write_one_by_one
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message, MessageIndex, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer
from strategies import transitions

from addressed_dynamics.base.errors import LogError, TransitionsError
from addressed_dynamics.episodes.transitions import COLUMNS, Transitions
from addressed_dynamics.logs import bulk, read_blocks, read_episodes, read_log, write_log
from addressed_dynamics.logs.container_writer import INDEX_ENTRY, ContainerWriter
from addressed_dynamics.logs.log_file import CHUNK_BYTES

COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "": CompressionType.NONE}
KINDS = list(COMPRESSIONS)
SCHEMA = Schema(id=1, data=b"{}", encoding="jsonschema", name="anything")
DESCRIPTION_BYTES = 1_600
"""About what the description takes that begins a chunk."""
CHANNELS = (Channel(1, "/a", "json", {"key": "value"}, schema_id=1), Channel(2, "/b", "json", {}, schema_id=1))

messages = st.builds(
    Message,
    channel_id=st.sampled_from([1, 2]),
    log_time=st.integers(0, 2**62),
    publish_time=st.integers(0, 2**62),
    sequence=st.integers(0, 2**32 - 1),
    data=st.binary(max_size=40),
)


def columns(given):
    return {name: getattr(given, name) for name in COLUMNS}


def all_messages(data):
    return [(channel.topic, message) for _, channel, message in make_reader(io.BytesIO(data), True).iter_messages()]


def written_by_mcap(chunks, compression):
    """The oracle: the same messages, the same borders of chunks."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=2**30, compression=COMPRESSIONS[compression], enable_data_crcs=True)
    writer.start(library="test")
    writer.add_metadata("run", {"a": "b"})
    writer.register_schema(SCHEMA.name, SCHEMA.encoding, SCHEMA.data)
    for channel in CHANNELS:
        writer.register_channel(channel.topic, channel.message_encoding, 1, channel.metadata)
    for chunk in chunks:
        for each in chunk:
            writer.add_message(each.channel_id, each.log_time, each.data, each.publish_time, each.sequence)
        writer.flush()
    writer.finish()
    return stream.getvalue()


def written_by_us(chunks, compression):
    stream = io.BytesIO()
    writer = ContainerWriter(stream, library="test", compression=compression)
    writer.add_metadata("run", {"a": "b"})
    writer.describe([SCHEMA], CHANNELS)
    for chunk in chunks:
        builder, index = RecordBuilder(), {}
        for each in chunk:
            index.setdefault(each.channel_id, []).append((each.log_time, len(writer.description) + builder.count))
            each.write(builder)
        payload = np.concatenate([writer.description, np.frombuffer(bytes(builder.end()), np.uint8)])
        times = [each.log_time for each in chunk]
        entries = {channel: np.array(rows, INDEX_ENTRY) for channel, rows in index.items()}
        writer.write_chunk(payload, entries, start_time=min(times), end_time=max(times))
    writer.finish()
    return stream.getvalue()


@given(
    chunks=st.lists(st.lists(messages, min_size=1, max_size=6), max_size=4),
    compression=st.sampled_from([*COMPRESSIONS]),
)
@settings(max_examples=100, deadline=None)
def test_the_container_says_what_that_of_mcap_says(chunks, compression):
    ours, theirs = written_by_us(chunks, compression), written_by_mcap(chunks, compression)
    assert all_messages(ours) == all_messages(theirs)
    summaries = [make_reader(io.BytesIO(data), True).get_summary() for data in (ours, theirs)]
    assert summaries[0].statistics == summaries[1].statistics
    assert summaries[0].schemas == summaries[1].schemas
    assert summaries[0].channels == summaries[1].channels
    times = [[(each.message_start_time, each.message_end_time) for each in one.chunk_indexes] for one in summaries]
    assert times[0] == times[1]


@given(expected=transitions())
@settings(max_examples=40, deadline=None)
def test_whole_arrays_give_the_messages_of_the_live_writer(expected, tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    seeds = list(range(len(list(expected.episode_slices()))))
    write_log(folder / "bulk.mcap", expected, run=RUN, seeds=seeds)
    write_one_by_one(folder / "live.mcap", expected, seeds=seeds)
    bulk, live = (all_messages((folder / f"{name}.mcap").read_bytes()) for name in ("bulk", "live"))
    assert [each for each in bulk if each[0] != "/episode"] == [each for each in live if each[0] != "/episode"]
    contents = read_log(folder / "bulk.mcap")
    assert_same(contents.transitions, expected)
    for ours, other in zip(contents.episodes, read_log(folder / "live.mcap").episodes, strict=True):
        for name in ("episode", "seed", "length", "ended"):
            assert getattr(ours, name) == getattr(other, name)
        np.testing.assert_allclose(ours.episode_return, other.episode_return, rtol=1e-12)
        assert abs(ours.end_time_ns - other.end_time_ns) <= 1  # rounded after or before the sum


@pytest.mark.parametrize("lengths", [[1], [20_000], [7] * 3000, [11_311, 1, 1, 11_311]])
def test_every_chunk_is_full_indexed_and_can_be_read_on_its_own(tmp_path, lengths):
    expected = car_transitions(lengths)
    write_log(tmp_path / "car.mcap", expected, run=RUN)
    assert_same(read_log(tmp_path / "car.mcap").transitions, expected)
    with (tmp_path / "car.mcap").open("rb") as stream:
        records = list(StreamReader(stream, emit_chunks=True).records)
    chunks = [each for each in records if isinstance(each, Chunk)]
    sizes = [chunk.uncompressed_size for chunk in chunks]
    assert max(sizes) <= CHUNK_BYTES
    assert min(sizes[:-1], default=CHUNK_BYTES) > 0.99 * CHUNK_BYTES
    indexes = [each for each in records if isinstance(each, MessageIndex)]
    assert sum(len(index.records) for index in indexes) == sum(lengths) + len(lengths)
    for chunk in chunks:
        assert [type(each) for each in breakup_chunk(chunk)[:4]] == [Schema, Schema, Channel, Channel]


def test_blocks_written_one_after_the_other_are_one_log_and_come_back_as_blocks(tmp_path):
    expected = car_transitions([9_000, 200, 9_000, 40])
    borders = [slice(0, 9_200), slice(9_200, None)]
    write_log(tmp_path / "car.mcap", (expected.select(rows) for rows in borders), run=RUN)
    blocks = list(read_blocks(tmp_path / "car.mcap"))
    assert len(blocks) > 1
    assert_same(Transitions.concatenate([block.transitions for block in blocks]), expected)
    assert [each.length for block in blocks for each in block.episodes] == [9_000, 200, 9_000, 40]
    assert read_log(tmp_path / "car.mcap").episodes == tuple(each for block in blocks for each in block.episodes)


@given(lengths=st.lists(st.integers(1, 60), min_size=1, max_size=5), room=st.integers(0, 2_000), data=st.data())
@settings(max_examples=60, deadline=None)
def test_blocks_may_be_cut_anywhere_and_make_the_same_bytes(lengths, room, data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    total = sum(lengths)
    places = sorted(data.draw(st.lists(st.integers(0, total), max_size=8)))
    generator = np.random.default_rng(0)
    rewards = (generator.standard_normal(total) * 10.0 ** generator.integers(-20, 20, total)).astype(np.float32)
    expected = replace(car_transitions(lengths), reward=rewards)
    blocks = [expected.select(slice(*borders)) for borders in pairwise([0, *places, total])]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bulk, "CHUNK_BYTES", DESCRIPTION_BYTES + room)
        patch.setattr(bulk, "ADDED_AT_ONCE", 16)
        seeds = list(range(len(lengths) - 1))
        write_log(folder / "whole.mcap", expected, run=RUN, seeds=seeds)
        write_log(folder / "cut.mcap", blocks, run=RUN, seeds=seeds)
    assert (folder / "cut.mcap").read_bytes() == (folder / "whole.mcap").read_bytes()


def test_the_return_of_an_episode_is_the_same_in_one_block_and_in_many(tmp_path):
    rewards = np.random.default_rng(0).standard_normal(40_000).astype(np.float32)
    expected = replace(car_transitions([40_000]), reward=rewards)
    write_log(tmp_path / "whole.mcap", expected, run=RUN)
    write_log(tmp_path / "cut.mcap", [expected.select(slice(at, at + 999)) for at in range(0, 40_000, 999)], run=RUN)
    assert (tmp_path / "cut.mcap").read_bytes() == (tmp_path / "whole.mcap").read_bytes()


def test_an_episode_that_goes_on_with_another_step_is_refused(tmp_path):
    expected = car_transitions([9])
    with pytest.raises(TransitionsError, match="not followed by the next step"):
        write_log(tmp_path / "car.mcap", [expected.select(slice(3)), expected.select(slice(4, None))], run=RUN)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("at_least", "lengths"), [(1, 4), (9_000, 3), (9_001, 2), (10**6, 1)])
def test_a_log_comes_back_in_blocks_of_whole_episodes(tmp_path, at_least, lengths):
    expected = car_transitions([9_000, 200, 9_000, 40])
    write_log(tmp_path / "car.mcap", expected, run=RUN)
    blocks = list(read_episodes(tmp_path / "car.mcap", at_least=at_least))
    assert len(blocks) <= lengths
    assert min(len(block.transitions) for block in blocks[:-1] or blocks) >= min(at_least, len(expected))
    assert_same(Transitions.concatenate([block.transitions for block in blocks]), expected)
    for block in blocks:
        assert sum(each.length for each in block.episodes) == len(block.transitions)


def test_an_empty_log_is_one_empty_block(tmp_path):
    write_log(tmp_path / "car.mcap", car_transitions([2]).select(slice(0, 0)), run=RUN)
    (block,) = read_episodes(tmp_path / "car.mcap", at_least=10)
    assert (len(block.transitions), block.episodes, block.run) == (0, (), RUN)


def test_times_stay_as_they_are_and_never_repeat(tmp_path):
    expected = car_transitions([3, 2])
    late = Transitions(CAR, **{**columns(expected), "time_ns": expected.time_ns * 7 + 10**18})
    write_log(tmp_path / "car.mcap", late, run=RUN)
    assert_same(read_log(tmp_path / "car.mcap").transitions, late)
    times = [message.log_time for _, message in all_messages((tmp_path / "car.mcap").read_bytes())]
    assert all(earlier < later for earlier, later in pairwise(times))


def test_an_episode_without_an_end_is_marked_cut(tmp_path):
    expected = car_transitions([3])
    open_end = Transitions(
        CAR, **{**columns(expected), "truncated": np.zeros(3, bool), "terminated": np.zeros(3, bool)}
    )
    write_log(tmp_path / "car.mcap", open_end, run=RUN)
    contents = read_log(tmp_path / "car.mcap")
    assert contents.transitions.truncated.tolist() == [False, False, True]
    assert [each.ended for each in contents.episodes] == ["cut"]


def test_what_cannot_be_written_is_one_error_and_leaves_nothing(tmp_path, monkeypatch):
    expected = car_transitions([3, 2])
    backwards = Transitions(CAR, **{**columns(expected), "time_ns": expected.time_ns[::-1].copy()})
    with pytest.raises(LogError, match=r"car\.mcap: the time of transition 1 is .* not after"):
        write_log(tmp_path / "car.mcap", backwards, run=RUN)
    with pytest.raises(LogError, match="nothing to write"):
        write_log(tmp_path / "car.mcap", iter([]), run=RUN)
    with pytest.raises(LogError, match="not after that of the one before"):
        write_log(tmp_path / "car.mcap", [expected, expected], run=RUN)
    fill_disk_after(monkeypatch, 2000)
    with pytest.raises(LogError, match=r"/car\.mcap: .* \(No space left on device\); make room, and write it again"):
        write_log(tmp_path / "car.mcap", car_transitions([2000]), run=RUN)
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == []
