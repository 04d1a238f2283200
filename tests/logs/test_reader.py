import io
import json

import pytest
from builders import CAR, RUN, assert_same, car_transitions, write_log
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from strategies import transitions

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.logs import read_log


@pytest.fixture(scope="module")
def small_log(tmp_path_factory):
    """A log of three short episodes, its bytes and what is in it."""
    path = write_log(tmp_path_factory.mktemp("small") / "car.mcap", car_transitions([2, 1, 3]), seeds=[1, 2, 3])
    return path, path.read_bytes(), read_log(path)


def copied(path, target, *, keep=lambda *_: True, **options):
    """Write the messages of a log with another program's choices: `mcap.Writer` itself."""
    with path.open("rb") as source, target.open("wb") as stream:
        reader = make_reader(source)
        writer = Writer(stream, **options)
        writer.start()
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        ids = {}
        for schema, channel, message in reader.iter_messages():
            if keep(channel, message):
                if channel.topic not in ids:
                    schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                    ids[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
                writer.add_message(ids[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    return target


@given(expected=transitions())
@settings(max_examples=60, deadline=None)
def test_what_is_written_is_read(expected, tmp_path_factory):
    path = write_log(tmp_path_factory.mktemp("log") / "car.mcap", expected)
    contents = read_log(path)
    assert_same(contents.transitions, expected)
    assert contents.run == RUN
    for rows, record in zip(expected.episode_slices(), contents.episodes, strict=True):
        terminated = expected.terminated[rows.stop - 1]
        assert record.episode == expected.episode[rows.start]
        assert record.length == rows.stop - rows.start
        assert record.ended == ("terminated" if terminated else "truncated")


def test_a_file_cut_off_anywhere_is_an_error_that_names_it(small_log, tmp_path):
    path, data, _ = small_log
    cut = tmp_path / path.name
    for length in {*range(0, len(data), 3), *range(10), *range(len(data) - 50, len(data))}:
        cut.write_bytes(data[:length])
        with pytest.raises(LogError, match=r"car\.mcap: (byte \d+ |the file is empty)") as caught:
            read_log(cut)
        assert "\n" not in str(caught.value)


def assert_error_or_harmless(path, expected):
    contents, message = None, ""
    try:
        contents = read_log(path)
    except LogError as error:
        message = str(error)
    if contents is None:
        assert str(path) in message
        assert "\n" not in message
    else:
        assert_same(contents.transitions, expected.transitions)
        assert (contents.episodes, contents.run) == (expected.episodes, expected.run)


def test_a_flipped_bit_anywhere_is_an_error_or_harmless(small_log, tmp_path):
    path, data, expected = small_log
    flipped = tmp_path / path.name
    for offset in {*range(0, len(data), 3), *range(10), *range(len(data) - 50, len(data))}:
        changed = bytearray(data)
        changed[offset] ^= 1 << offset % 8
        flipped.write_bytes(changed)
        assert_error_or_harmless(flipped, expected)


@given(where=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255), count=st.integers(1, 4))
@example(where=0.0, value=0, count=4)
@settings(max_examples=300, deadline=None)
def test_bytes_overwritten_anywhere_are_an_error_or_harmless(small_log, tmp_path_factory, where, value, count):
    path, data, expected = small_log
    changed = bytearray(data)
    offset = int(where * len(data))
    changed[offset : offset + count] = bytes([value]) * len(changed[offset : offset + count])
    target = tmp_path_factory.mktemp("changed") / path.name
    target.write_bytes(changed)
    assert_error_or_harmless(target, expected)


def test_a_damaged_chunk_is_named_by_its_offset_with_what_is_intact_before_it(small_log, tmp_path):
    path, data, _ = small_log
    offset = make_reader(io.BytesIO(data)).get_summary().chunk_indexes[2].chunk_start_offset
    damaged = tmp_path / path.name
    damaged.write_bytes(data[: offset + 80] + bytes([data[offset + 80] ^ 255]) + data[offset + 81 :])
    with pytest.raises(
        LogError,
        match=rf"byte {offset} is a chunk .*; 3 transitions before it are intact: 'addressed-dynamics recover ",
    ):
        read_log(damaged)


@pytest.mark.parametrize(
    "options",
    [
        {"compression": CompressionType.NONE},
        {"compression": CompressionType.NONE, "enable_crcs": False, "index_types": IndexType.NONE},
        {"use_chunking": False},
        {"chunk_size": 1},
        {"use_statistics": False, "repeat_channels": False, "repeat_schemas": False, "use_summary_offsets": False},
    ],
    ids=str,
)
def test_a_log_that_another_program_has_rewritten_reads_the_same(small_log, tmp_path, options):
    path, _, expected = small_log
    contents = read_log(copied(path, tmp_path / "copy.mcap", **options))
    assert_same(contents.transitions, expected.transitions)
    assert contents.episodes == expected.episodes


def test_a_foreign_mcap_is_refused_with_a_list_of_what_is_in_it(tmp_path):
    path = tmp_path / "robot.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("sensor.Imu", "jsonschema", json.dumps({"type": "object"}).encode())
        channel = writer.register_channel("/imu", "json", schema)
        writer.register_channel("/raw", "cbor", 0)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    with pytest.raises(
        LogError, match=r"addressed_dynamics\.Transition was expected, but .* has /imu \(sensor\.Imu\), /raw \(cbor\)"
    ):
        read_log(path)


def test_a_log_without_its_run_record_is_refused(small_log, tmp_path):
    path, _, _ = small_log
    with path.open("rb") as source, (tmp_path / "bare.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for schema, channel, message in make_reader(source).iter_messages(topics="/env_00/transition"):
            if message.sequence == 0:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channel_id = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
            writer.add_message(channel_id, message.log_time, message.data, message.publish_time)
        writer.finish()
    with pytest.raises(LogError, match="it has no metadata record 'run'"):
        read_log(tmp_path / "bare.mcap")


def test_a_log_with_steps_left_out_is_refused(small_log, tmp_path):
    path, _, _ = small_log
    without_first = copied(path, tmp_path / "a.mcap", keep=lambda _, message: message.log_time > 0)
    with pytest.raises(LogError, match="episode 0 should have 2 transitions, but episode 0 with 1 was found"):
        read_log(without_first)
    without_ends = copied(path, tmp_path / "b.mcap", keep=lambda channel, _: channel.topic != "/episode")
    with pytest.raises(LogError, match="transitions of 3 episodes, but records of 0"):
        read_log(without_ends)


def test_a_message_of_another_layout_is_refused(small_log, tmp_path):
    path, _, _ = small_log
    with path.open("rb") as source, (tmp_path / "short.mcap").open("wb") as stream:
        reader = make_reader(source)
        writer = Writer(stream)
        writer.start()
        (record,) = reader.iter_metadata()
        writer.add_metadata(record.name, record.metadata)
        schema, channel, message = next(reader.iter_messages(topics="/env_00/transition"))
        schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
        channel_id = writer.register_channel(channel.topic, channel.message_encoding, schema_id)
        writer.add_message(channel_id, 0, message.data[:-2], 0)
        writer.finish()
    with pytest.raises(LogError, match=r"is a chunk with messages of \d+ bytes, but these spaces need"):
        read_log(tmp_path / "short.mcap")


@pytest.mark.parametrize(
    ("topic", "place", "problem"),
    [
        ("/env_00/transition", -1, "a flag that is neither 0 nor 1"),
        ("/env_00/transition", 0, "a message that is not in the layout of these spaces"),
        ("/episode", -1, "an episode with an unknown end"),
    ],
)
def test_a_value_that_the_layout_does_not_know_is_refused(small_log, tmp_path, topic, place, problem):
    def changed(channel, message):
        if channel.topic == topic:
            data = bytearray(message.data)
            data[place] = 7
            message.data = bytes(data)
        return True

    with pytest.raises(LogError, match=problem):
        read_log(copied(small_log[0], tmp_path / "copy.mcap", keep=changed))


def test_a_file_that_is_no_mcap_is_refused(tmp_path):
    (tmp_path / "table.mcap").write_bytes(b"PAR1 and more")
    with pytest.raises(LogError, match=r"table\.mcap: byte 0 should begin an MCAP log"):
        read_log(tmp_path / "table.mcap")


def test_a_missing_log_points_to_an_unfinished_one_beside_it(tmp_path):
    with pytest.raises(LogError, match=r"there is no such log$"):
        read_log(tmp_path / "car.mcap")
    (tmp_path / "car.mcap.partial").touch()
    with pytest.raises(
        LogError, match=r"an unfinished one is there: 'addressed-dynamics recover .*car\.mcap\.partial'"
    ):
        read_log(tmp_path / "car.mcap")
    with pytest.raises(LogError, match="cannot be read"):
        read_log(tmp_path)


def test_a_log_of_a_newer_format_is_refused(small_log, monkeypatch):
    monkeypatch.setattr("addressed_dynamics.logs.contents.FORMAT_VERSION", "2")
    with pytest.raises(LogError, match="run record is of format 1, but this version reads format 2"):
        read_log(small_log[0])


def test_the_spec_travels_with_the_log(small_log):
    assert small_log[2].transitions.spec == CAR
