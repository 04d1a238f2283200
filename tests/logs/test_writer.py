import io
from itertools import pairwise

import numpy as np
import pytest
from builders import CAR, RUN, WINDY, append_rows, assert_same, car_transitions, fill_disk_after, write_log
from google.protobuf import descriptor_pb2, message_factory
from hypothesis import given, settings
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from strategies import transitions

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.logs import TransitionLogWriter, read_log, recover_log
from addressed_dynamics.logs.container_writer import ContainerWriter
from addressed_dynamics.logs.log_file import CHUNK_BYTES


def decoded_messages(data: bytes):
    """All messages as a generic viewer sees them: schema from the file, decoded by protobuf."""
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    for schema, channel, message in reader.iter_messages():
        files = descriptor_pb2.FileDescriptorSet.FromString(schema.data).file
        yield channel.topic, message, message_factory.GetMessages(list(files))[schema.name].FromString(message.data)


@given(expected=transitions())
@settings(max_examples=40, deadline=None)
def test_any_mcap_viewer_reads_the_same_numbers(expected, tmp_path_factory):
    path = write_log(tmp_path_factory.mktemp("log") / "car.mcap", expected)
    messages = list(decoded_messages(path.read_bytes()))
    steps = [(message, decoded) for topic, message, decoded in messages if topic == "/env_00/transition"]
    assert [message.log_time for message, _ in steps] == expected.time_ns.tolist()
    assert [message.sequence for message, _ in steps] == list(range(len(expected)))
    for row, (_, decoded) in enumerate(steps):
        for name in ("episode", "step", "reward", "terminated", "truncated"):
            assert getattr(decoded, name) == getattr(expected, name)[row]
        for field in ("observation", "next_observation"):
            for column, name in enumerate(expected.spec.observation_names):
                assert getattr(getattr(decoded, field), name) == getattr(expected, field)[row, column]
        if isinstance(expected.spec.action, DiscreteAction):
            assert decoded.action == expected.action[row]
        else:
            for column, dimension in enumerate(expected.spec.action.dimensions):
                assert getattr(decoded.action, dimension.name) == expected.action[row, column]
        for column, dimension in enumerate(expected.spec.exogenous):
            assert getattr(decoded.exogenous, dimension.name) == expected.exogenous[row, column]
    ends = [decoded for topic, _, decoded in messages if topic == "/episode"]
    assert [end.length for end in ends] == [rows.stop - rows.start for rows in expected.episode_slices()]


def test_a_log_has_all_indexes_and_checksums_and_its_times_increase_strictly(tmp_path):
    path = write_log(tmp_path / "car.mcap", car_transitions([3, 1, 4]))
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        times = [message.log_time for _, _, message in reader.iter_messages()]
        (metadata,) = reader.iter_metadata()
    assert summary.statistics.channel_message_counts == {1: 8, 2: 3}
    assert [sorted(chunk.message_index_offsets) for chunk in summary.chunk_indexes] == [[1, 2]] * 3
    assert all(earlier < later for earlier, later in pairwise(times))
    assert (metadata.name, metadata.metadata["environment"]) == ("run", "Some-v0")
    with path.open("rb") as stream:
        assert len(list(StreamReader(stream, validate_crcs=True).records)) > 8


def test_no_chunk_is_larger_than_a_mebibyte_however_long_the_episode(tmp_path):
    path = write_log(tmp_path / "car.mcap", car_transitions([30_000]))
    with path.open("rb") as stream:
        chunks = [each for each in StreamReader(stream, emit_chunks=True).records if isinstance(each, Chunk)]
    sizes = [chunk.uncompressed_size for chunk in chunks]
    assert len(sizes) > 2
    assert CHUNK_BYTES * 0.99 < max(sizes) <= CHUNK_BYTES
    assert {chunk.compression for chunk in chunks} == {"zstd"}


def test_what_an_episode_ended_with_is_on_disk_before_the_next_step(tmp_path):
    expected = car_transitions([4, 2, 5])
    writer = TransitionLogWriter(tmp_path / "car.mcap", CAR, run=RUN)
    for index, rows in enumerate(expected.episode_slices()):
        append_rows(writer, expected, rows)
        writer.end_episode(None, cut=False)
        assert writer.safe_count == rows.stop
        recover_log(writer.partial, tmp_path / f"{index}.mcap")
        assert_same(read_log(tmp_path / f"{index}.mcap").transitions, expected.select(slice(0, rows.stop)))
    writer.abandon()


def test_a_log_appears_only_when_it_is_complete(tmp_path):
    writer = TransitionLogWriter(tmp_path / "car.mcap", CAR, run=RUN)
    assert [path.name for path in tmp_path.iterdir()] == ["car.mcap.partial"]
    writer.close()
    writer.close()
    assert [path.name for path in tmp_path.iterdir()] == ["car.mcap"]
    assert len(read_log(tmp_path / "car.mcap").transitions) == 0


def test_an_episode_without_its_end_is_cut_and_marked_on_its_last_step(tmp_path):
    expected = car_transitions([3, 3])
    with TransitionLogWriter(tmp_path / "car.mcap", CAR, run=RUN) as writer:
        append_rows(writer, expected, slice(0, 2))
        writer.end_episode(17, cut=True)
        append_rows(writer, expected, slice(3, 5))
    contents = read_log(tmp_path / "car.mcap")
    assert contents.transitions.truncated.tolist() == [False, True, False, True]
    assert [(each.ended, each.seed, each.length) for each in contents.episodes] == [("cut", 17, 2), ("cut", None, 2)]


def test_an_episode_record_sums_the_rewards_that_were_recorded(tmp_path):
    expected = car_transitions([5, 2])
    contents = read_log(write_log(tmp_path / "car.mcap", expected, seeds=[3, None]))
    for rows, record in zip(expected.episode_slices(), contents.episodes, strict=True):
        np.testing.assert_allclose(record.episode_return, expected.reward[rows].astype(np.float64).sum(), rtol=1e-12)
        assert record.end_time_ns == round(rows.stop * (CAR.step_seconds * 1e9)) - 1
    assert [record.seed for record in contents.episodes] == [3, None]


def test_an_unfinished_log_is_never_overwritten(tmp_path):
    writer = TransitionLogWriter(tmp_path / "car.mcap", CAR, run=RUN)
    before = writer.partial.read_bytes()
    with pytest.raises(LogError, match=r"car\.mcap\.partial: another recording .* 'addressed-dynamics recover"):
        TransitionLogWriter(tmp_path / "car.mcap", CAR, run=RUN)
    assert writer.partial.read_bytes() == before
    writer.abandon()


def test_a_block_that_fails_leaves_the_unfinished_log_for_recovery(tmp_path):
    class FailureError(Exception):
        pass

    expected = car_transitions([3])

    def fail():
        with TransitionLogWriter(tmp_path / "car.mcap", CAR, run=RUN) as writer:
            append_rows(writer, expected, slice(0, 3))
            writer.end_episode(None, cut=False)
            raise FailureError

    with pytest.raises(FailureError):
        fail()
    assert [path.name for path in tmp_path.iterdir()] == ["car.mcap.partial"]
    recover_log(tmp_path / "car.mcap.partial", tmp_path / "saved.mcap")
    assert_same(read_log(tmp_path / "saved.mcap").transitions, expected)


def test_ctrl_c_inside_a_record_never_completes_a_damaged_log(tmp_path, monkeypatch):
    expected = car_transitions([3, 3])
    writer = TransitionLogWriter(tmp_path / "car.mcap", CAR, run=RUN)
    append_rows(writer, expected, slice(0, 3))
    writer.end_episode(None, cut=False)
    append_rows(writer, expected, slice(3, 6))
    write = ContainerWriter._write

    def interrupted(container, data):
        write(container, data[: len(data) // 2])
        raise KeyboardInterrupt

    monkeypatch.setattr(ContainerWriter, "_write", interrupted)
    with pytest.raises(KeyboardInterrupt):
        writer.end_episode(None, cut=False)
    monkeypatch.undo()
    writer.close()
    with pytest.raises(LogError, match="the log is closed"):
        append_rows(writer, expected, slice(3, 6))
    assert [path.name for path in tmp_path.iterdir()] == ["car.mcap.partial"]
    recover_log(writer.partial, tmp_path / "saved.mcap")
    assert_same(read_log(tmp_path / "saved.mcap").transitions, expected.select(slice(0, 3)))


def test_a_folder_that_cannot_be_made_is_one_error(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(LogError, match="the log cannot be created"):
        TransitionLogWriter(tmp_path / "file" / "car.mcap", CAR, run=RUN)


@pytest.mark.parametrize("room", [0, 100, 3000, 6000])
def test_a_full_disk_is_one_error_that_says_what_is_safe(tmp_path, monkeypatch, room):
    expected = car_transitions([20] * 50)
    fill_disk_after(monkeypatch, room)
    written = []

    def write_all():
        writer = TransitionLogWriter(tmp_path / "car.mcap", CAR, run=RUN)
        for rows in expected.episode_slices():
            append_rows(writer, expected, rows)
            writer.end_episode(None, cut=False)
            written.append(rows.stop)

    with pytest.raises(LogError, match=r"car\.mcap\.partial: the log cannot be written \(No space left") as caught:
        write_all()
    monkeypatch.undo()
    safe = max(written, default=0)
    assert f"; {safe} transitions are safe in it" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "car.mcap").exists()
    if safe:
        recover_log(tmp_path / "car.mcap.partial", tmp_path / "saved.mcap")
        saved = read_log(tmp_path / "saved.mcap").transitions
        # A chunk that was complete when the disk was full is one more than was promised.
        assert safe <= len(saved) <= safe + 20
        assert_same(saved, expected.select(slice(0, len(saved))))


@pytest.mark.parametrize(
    ("spec", "exogenous", "problem"),
    [(CAR, [1.0], "1 exogenous inputs, but the spaces of the log have 0"), (WINDY, [], "0 .* have 2")],
)
def test_exogenous_inputs_that_the_spaces_do_not_have_are_refused(tmp_path, spec, exogenous, problem):
    writer = TransitionLogWriter(tmp_path / "car.mcap", spec, run=RUN)
    with pytest.raises(LogError, match=problem):
        writer.append(0, 0, [0.0, 0.0], 1, 0.0, [0.0, 0.0], False, False, exogenous)
    assert writer.count == 0
    writer.abandon()
