"""Every kind of bad input to an import: one line that names the file, what is wrong there, and what to do."""

import io
import multiprocessing
import random
import re
import resource
import sys
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from foreign_logs import SECOND, Timed, json_log, protobuf_log, ros2_log, save, source, states_and_commands
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType, Writer

from addressed_dynamics.base.errors import AddressedDynamicsError, LogError, ParamsError
from addressed_dynamics.importing import import_logs
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.mcap_logs import read_mcap
from addressed_dynamics.importing.paths import parse_path
from addressed_dynamics.importing.signals import signals_of

MESSAGES = states_and_commands()
GOOD = {"json": json_log(MESSAGES), "protobuf": protobuf_log(MESSAGES), "ros2": ros2_log(MESSAGES)}
SOURCE = source()
SIGNALS = signals_of(SOURCE)
PATHS = [parse_path(signal.field) for signal in SIGNALS.all]


def refusal(folder: Path, **changes: Any) -> str:
    """What is said when the logs in `folder` cannot be imported."""
    with pytest.raises(AddressedDynamicsError) as caught:
        import_logs(
            source(**({"files": [str(folder / "logs" / "*.mcap")]} | changes)),
            folder / "out",
            name="arm",
            progress=lambda _: None,
        )
    message = str(caught.value)
    assert "\n" not in message
    assert not (folder / "out" / "import.json").exists()
    return message


def samples(path: Path, data: bytes) -> list[list[float]] | None:
    """The samples of a log with these bytes, None if it is refused; any other error fails the test."""
    # Some file systems write a file out at once that takes the place of another.
    path.unlink(missing_ok=True)
    path.write_bytes(data)
    try:
        return read_mcap([path], SOURCE, SIGNALS, PATHS, Agreement()).whole().values.tolist()
    except LogError as error:
        if not str(error).startswith(f"{path}: ") or "\n" in str(error):
            raise
        return None


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("damaged") / "x.mcap"


@pytest.mark.parametrize("encoding", GOOD)
@settings(max_examples=60)
@given(share=st.floats(0, 1, exclude_max=True))
@example(share=0.0)
def test_a_log_cut_off_at_any_byte_is_refused(scratch: Path, encoding: str, share: float) -> None:
    data = GOOD[encoding]
    assert samples(scratch, data[: int(share * len(data))]) is None


@pytest.mark.parametrize("encoding", GOOD)
@settings(max_examples=100)
@given(data=st.data())
def test_flipped_bits_are_noticed_or_change_nothing(scratch: Path, encoding: str, data: st.DataObject) -> None:
    damaged = bytearray(GOOD[encoding])
    for _ in range(data.draw(st.integers(1, 3))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    found = samples(scratch, bytes(damaged))
    assert found is None or found == samples(scratch, GOOD[encoding])


@pytest.mark.parametrize("encoding", ["protobuf", "cdr", "json"])
@settings(max_examples=60)
@given(schema=st.binary(max_size=60) | st.text(max_size=60).map(str.encode), payload=st.binary(max_size=30))
def test_a_sound_file_of_nonsense_is_refused(scratch: Path, encoding: str, schema: bytes, payload: bytes) -> None:
    kind = {"protobuf": "protobuf", "cdr": "ros2msg", "json": "jsonschema"}[encoding]
    assert samples(scratch, encoded_log([("/joint_states", 1, payload)], encoding, kind, schema)) is None


def encoded_log(messages: Iterable[Timed], encoding: str, schema_encoding: str, schema: bytes = b"") -> bytes:
    """An MCAP file of messages that are bytes already."""
    file = io.BytesIO()
    writer = Writer(file)
    writer.start()
    number = writer.register_schema("x/Y", schema_encoding, schema)
    channel = writer.register_channel("/joint_states", encoding, number)
    for _, time, data in messages:
        writer.add_message(channel, time, data, time)
    writer.finish()
    return file.getvalue()


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (b"", r"the file is empty \(0 bytes\)"),
        (b"ROSBAG V2.0\n" + bytes(100), "byte 0 should begin an MCAP file"),
        (GOOD["json"].replace(b"zstd", b"zstx"), "is a chunk that cannot be unpacked"),
        (json_log([]), "the file has no topic /joint_states; its topics are: none"),
        (json_log(MESSAGES, use_chunking=False)[:-40], "byte"),
        (encoded_log([("", 1, b"<a/>")], "xml", "xsd"), "topic /joint_states has messages in 'xml'"),
        (encoded_log([("", 1, b"")], "cdr", "omgidl"), "in 'cdr' with a schema in 'omgidl'"),
        (json_log([("/joint_states", 1, b"{")]), r"message 0 of topic /joint_states \(time 1 ns\) cannot be decoded"),
        (json_log([("/joint_states", 2**64 - 1, {"position": [1, 2]})]), "is before 1970 or after the year 2262"),
    ],
)
def test_a_file_that_cannot_be_read_is_named_with_the_reason(tmp_path: Path, data: bytes, what: str) -> None:
    message = refusal(save(tmp_path, bad=data))
    assert "bad.mcap" in message
    assert re.search(what, message), message


@pytest.mark.parametrize("options", [{"use_chunking": False}, {"compression": CompressionType.NONE}])
@pytest.mark.parametrize("indexed", [IndexType.ALL, IndexType.NONE])
def test_a_sound_file_needs_neither_chunks_nor_an_index(
    scratch: Path, options: dict[str, Any], indexed: IndexType
) -> None:
    expected = samples(scratch, GOOD["json"])
    assert samples(scratch, json_log(MESSAGES, index_types=indexed, **options)) == expected
    bare = {"repeat_channels": False, "repeat_schemas": False, "use_statistics": False, "use_summary_offsets": False}
    assert samples(scratch, json_log(MESSAGES, index_types=indexed, **options, **bare)) == expected


def test_messages_of_a_channel_that_nobody_declared_are_refused(tmp_path: Path) -> None:
    data = json_log(MESSAGES[:1], use_chunking=False, use_statistics=False)
    # The opcode of a message, its length, then its channel.
    message = next(i for i in range(8, len(data)) if data[i] == 5 and data[i + 9 : i + 11] == b"\1\0")
    changed = data[: message + 9] + b"\7\0" + data[message + 11 :]
    assert "has messages whose channel was not declared before" in refusal(save(tmp_path, bad=changed))


@pytest.mark.parametrize(
    ("field", "what"),
    [
        ("/joint_states.velocity[0]", "has no field 'velocity[0]'; its fields are: position[0:2], name"),
        ("/joint_states.position[2]", "has no field 'position[2]'; its fields are: position[0:2], name"),
        ("/joint_states.name", "has a field 'name' that cannot be used: 'arm' is not a number"),
        ("/joint_states.position", "has a field 'position' that cannot be used"),
        ("/joints.position[0]", "has no topic /joints; its topics are: /cmd, /joint_states"),
    ],
)
@pytest.mark.parametrize("encoding", GOOD)
def test_a_wrong_path_is_answered_with_what_there_is(tmp_path: Path, encoding: str, field: str, what: str) -> None:
    assert what in refusal(save(tmp_path, a=GOOD[encoding]), observation={"angle": {"field": field}})


def test_topics_that_never_overlap_are_refused_with_both_times(tmp_path: Path) -> None:
    later = [(topic, time + 60 * SECOND if topic == "/cmd" else time, message) for topic, time, message in MESSAGES]
    message = refusal(save(tmp_path, a=json_log(later)))
    assert "/joint_states (100.000 to 101.000 s) and /cmd (160.020 to 160.980 s) never overlap in time" in message


def test_a_clock_that_was_set_back_is_refused(tmp_path: Path) -> None:
    messages = MESSAGES + states_and_commands(1.0, start=90 * SECOND)
    message = refusal(save(tmp_path, a=json_log(messages)))
    assert "time goes backwards on topic /joint_states, by up to 11 s in 21 messages" in message


def test_arrays_of_different_lengths_are_refused_with_both_messages(tmp_path: Path) -> None:
    longer = [
        (topic, time, message | ({"position": [1, 2, 3]} if "position" in message else {}))
        for topic, time, message in MESSAGES
    ]
    message = refusal(save(tmp_path, a=json_log([*MESSAGES[:20], *longer[20:]])))
    assert re.search(
        r"a.mcap: message 12 of topic /joint_states .*is an array of 3, but one of 2 in message 0 of", message
    )
    assert "if two programs write to this topic, record them on topics of their own" in message
    message = refusal(save(tmp_path, a=GOOD["json"], b=json_log(longer)))
    assert re.search(r"b.mcap: message 0 of .*is an array of 3, but one of 2 in message 0 of .*a.mcap", message)


def test_an_action_that_has_no_name_is_refused(tmp_path: Path) -> None:
    action = {"discrete": {"field": "/cmd.torque", "names": ["off", "on"]}}
    message = refusal(save(tmp_path, a=GOOD["json"]), action=action)
    assert "0.25 is none of the actions 0..1 (off, on)" in message


def test_no_episodes_are_refused_with_the_counts(tmp_path: Path) -> None:
    message = refusal(save(tmp_path, a=GOOD["json"]), min_length=100)
    assert "expected episodes of at least 100 samples, but there is none" in message
    assert "10 samples" in message


def test_a_pattern_without_files_and_values_that_are_never_finite_are_refused(tmp_path: Path) -> None:
    assert "no file matches" in refusal(tmp_path)
    unset = [(topic, time, {**message, "torque": None}) for topic, time, message in MESSAGES]
    message = refusal(save(tmp_path, a=json_log(unset)))
    assert "none of the 13 messages of topic /cmd has a finite value" in message


@pytest.mark.parametrize(
    ("observation", "what"),
    [
        ({"a": {"field": "angle"}}, "'angle' is not the path of a field"),
        ({"a": {"field": "/t.x[2:1]"}}, "should have one slice"),
        ({"a": {"field": "/t.x[0:2]"}, "a_1": {"field": "/t.y"}}, "two dimensions come to have the same name"),
        ({"a": {"field": "/t.x", "low": 1.0, "high": 0.0}}, "low should not be above high"),
    ],
)
def test_a_source_that_makes_no_sense_is_refused_before_any_file_is_read(
    tmp_path: Path, observation: dict[str, Any], what: str
) -> None:
    with pytest.raises(ParamsError, match=what):
        import_logs(source(observation=observation), tmp_path, name="arm", progress=lambda _: None)


def damaged(good: bytes, generator: random.Random) -> bytes:
    """A copy with one to three places cut off, flipped, inserted, removed or overwritten."""
    data = bytearray(good)
    for _ in range(generator.randint(1, 3)):
        place = generator.randrange(len(data) + 1)
        end = place + generator.randint(1, 64)
        match generator.randrange(5):
            case 0:
                del data[place:]
            case 1:
                data[place : place + 1] = bytes(byte ^ 1 << generator.randrange(8) for byte in data[place : place + 1])
            case 2:
                data[place:place] = generator.randbytes(end - place)
            case 3:
                del data[place:end]
            case _:
                data[place : place + 8] = b"\xff" * 8
    return bytes(data)


def peak_memory() -> int:
    """The most memory that this process has had, in bytes."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def import_damaged(path: Path, count: int) -> tuple[int, int, int]:
    """Import so many damaged files: how many were refused, or misread, and by how much the peak of memory grew."""
    generator = random.Random(0)
    expected = {encoding: samples(path, data) for encoding, data in GOOD.items()}
    before, refused, otherwise = peak_memory(), 0, 0
    for _ in range(count):
        encoding = generator.choice(list(GOOD))
        found = samples(path, damaged(GOOD[encoding], generator))
        refused += found is None
        otherwise += found is not None and found != expected[encoding]
    return refused, otherwise, peak_memory() - before


@pytest.mark.slow
def test_ten_thousand_damaged_files_are_refused_or_read_as_they_were_in_little_memory(scratch: Path) -> None:
    # In a process of its own: what other tests have left in this one's memory is not theirs to answer for.
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        refused, otherwise, growth = pool.submit(import_damaged, scratch, 10_000).result()
    assert refused > 5_000
    assert otherwise == 0
    assert growth < 96 * 2**20
