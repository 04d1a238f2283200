"""Bags of ROS 2 give the numbers of the same messages in MCAP, and one line each if anything is wrong with them."""

import random
import re
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from bags import TYPES, Encoded, encoded, write_bag, write_database, write_metadata
from foreign_logs import SECOND, ros2_log, source, states_and_commands
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.base.params.source import McapSource
from addressed_dynamics.importing import import_logs
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.mcap_logs import read_mcap
from addressed_dynamics.importing.paths import parse_path
from addressed_dynamics.importing.ros_bags import bag_files, is_bag
from addressed_dynamics.importing.ros_databases import BATCH_BYTES
from addressed_dynamics.importing.samples import Samples
from addressed_dynamics.importing.signals import signals_of
from addressed_dynamics.importing.topics import message_runs
from addressed_dynamics.logs import read_log

TIMED = states_and_commands()
MESSAGES = encoded(TIMED)
STORAGES = [StoragePlugin.SQLITE3, StoragePlugin.MCAP]


def samples(path: Path, **changes: Any) -> Samples:
    """What is read of a recording."""
    section = source(**changes)
    assert isinstance(section, McapSource)
    signals = signals_of(section)
    paths = [parse_path(signal.field) for signal in signals.all]
    files = bag_files(path) if is_bag(path) else (path,)
    return read_mcap(files, section, signals, paths, Agreement()).whole()


def assert_as_in_mcap(found: Samples, folder: Path, messages: Any = TIMED) -> None:
    """Compare samples and counters with those of the same messages in an MCAP file."""
    (folder / "same.mcap").write_bytes(ros2_log(messages))
    expected = samples(folder / "same.mcap")
    assert len(expected.values) > 5
    np.testing.assert_array_equal(found.values, expected.values)
    np.testing.assert_array_equal(found.follows, expected.follows)
    counts = {name: count for name, count in found.counts.items() if name != "decompressed"}
    assert counts | {"joined_files": 0} == expected.counts
    for key in ("from_ns", "to_ns", "topics", "warnings"):
        assert found.details[key] == expected.details[key]


def refusal(path: Path, **changes: Any) -> str:
    with pytest.raises(LogError) as caught:
        samples(path, **changes)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def imported(folder: Path, pattern: str, **changes: Any) -> list[str]:
    """Import what matches a pattern; return the logs that came out."""
    shutil.rmtree(folder / "out", ignore_errors=True)
    import_logs(source(files=[str(folder / pattern)], **changes), folder / "out", name="arm", progress=lambda _: None)
    return sorted(path.name for path in (folder / "out").glob("*.mcap"))


def test_a_database_gives_the_numbers_of_the_same_messages_in_mcap(tmp_path: Path) -> None:
    path = write_database(tmp_path / "a bag?#%20" / "x.db3", MESSAGES)
    before = path.read_bytes()
    path.parent.chmod(0o555)
    assert_as_in_mcap(samples(path), tmp_path)
    path.parent.chmod(0o755)
    assert path.read_bytes() == before
    assert [each.name for each in path.parent.iterdir()] == ["x.db3"]


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("compression", [CompressionMode.NONE, CompressionMode.MESSAGE])
def test_a_bag_of_either_storage_plain_or_with_packed_messages_gives_the_same_numbers(
    tmp_path: Path, storage: StoragePlugin, compression: CompressionMode
) -> None:
    bag = write_bag(tmp_path / "bag", MESSAGES, storage, compression)
    assert_as_in_mcap(samples(bag), tmp_path)


@pytest.mark.parametrize("storage", STORAGES)
def test_a_bag_that_is_compressed_as_a_whole_is_read_after_what_undoes_it(
    tmp_path: Path, storage: StoragePlugin
) -> None:
    bag = write_bag(tmp_path / "bag", MESSAGES, storage, CompressionMode.FILE)
    (packed,) = bag.glob("*.zstd")
    for path in (bag, packed):
        assert f"{packed.name}: this is a compressed file" in refusal(path)
        assert f"'zstd -d {packed.name}'" in refusal(path)
    with packed.open("rb") as file, packed.with_suffix("").open("wb") as unpacked:
        zstandard.ZstdDecompressor().copy_stream(file, unpacked)
    assert_as_in_mcap(samples(bag), tmp_path)


def test_files_of_a_bag_are_one_recording_in_the_order_that_its_metadata_name(tmp_path: Path) -> None:
    timed = states_and_commands(3.0)
    messages, bag = encoded(timed), tmp_path / "logs" / "bag"
    third = len(messages) // 3
    parts = [messages[:third], messages[third : 2 * third], messages[2 * third :]]
    # By their names they would be in another order, and the second has its topics under other numbers.
    types = dict(reversed(TYPES.items()))
    write_database(bag / "b_9.db3", parts[0])
    write_database(bag / "b_10.db3", parts[1], types=types)
    write_database(bag / "b_1.db3", parts[2])
    write_metadata(bag, ["bag/b_9.db3", "b_10.db3", "b_1.db3"])
    assert_as_in_mcap(samples(bag), tmp_path, timed)
    assert samples(bag).counts["backwards"] == 0
    for pattern in ("logs/*", "logs/**", "logs/**/*", "logs/*/metadata.yaml"):
        assert imported(tmp_path, pattern) == ["0000-b_9.mcap"]
    log = read_log(tmp_path / "out" / "0000-b_9.mcap")
    assert [each.length for each in log.episodes] == [len(samples(bag).values) - 1]
    apart = imported(tmp_path, "logs/bag/*.db3", min_length=3)
    assert apart == ["0000-b_1.mcap", "0001-b_10.mcap", "0002-b_9.mcap"]


def test_bags_and_files_that_follow_each_other_are_one_recording(tmp_path: Path) -> None:
    timed = states_and_commands(3.0)
    messages = encoded(timed)
    third = len(messages) // 3
    write_database(tmp_path / "logs" / "b" / "z.db3", messages[:third])
    write_metadata(tmp_path / "logs" / "b", ["z.db3"])
    write_bag(tmp_path / "logs" / "a", messages[third : 2 * third], StoragePlugin.MCAP)
    write_database(tmp_path / "logs" / "c.db3", messages[2 * third :])
    changes: dict[str, Any] = {"episode": {"by": "gap", "seconds": 1.0}, "min_length": 3}
    assert imported(tmp_path, "logs/*", **changes) == ["0000-z.mcap"]
    (tmp_path / "same").mkdir()
    (tmp_path / "same" / "z.mcap").write_bytes(ros2_log(timed))
    joined = read_log(tmp_path / "out" / "0000-z.mcap")
    assert imported(tmp_path, "same/*.mcap", **changes) == ["0000-z.mcap"]
    expected = read_log(tmp_path / "out" / "0000-z.mcap")
    np.testing.assert_array_equal(joined.transitions.observation, expected.transitions.observation)
    assert [each.length for each in joined.episodes] == [each.length for each in expected.episodes]
    assert len(imported(tmp_path, "logs/*", min_length=3)) == 3


def test_a_simulation_that_starts_again_is_seen_across_topics(tmp_path: Path) -> None:
    timed = [*states_and_commands(1.0), *states_and_commands(1.0)]
    changes: dict[str, Any] = {"episode": {"by": "reset"}}
    found = samples(write_database(tmp_path / "x.db3", encoded(timed)), **changes)
    (tmp_path / "x.mcap").write_bytes(ros2_log(timed))
    expected = samples(tmp_path / "x.mcap", **changes)
    assert (~expected.follows).sum() == 2
    np.testing.assert_array_equal(found.values, expected.values)
    np.testing.assert_array_equal(found.follows, expected.follows)


def test_a_clock_that_was_set_back_is_seen_and_small_disorder_is_counted(tmp_path: Path) -> None:
    late = [(topic, time - 50 * SECOND, data) for topic, time, data in MESSAGES]
    assert "time goes backwards on topic /joint_states" in refusal(write_database(tmp_path / "x.db3", MESSAGES + late))
    states = [each for each in MESSAGES if each[0] == "/joint_states"]
    commands = [each for each in MESSAGES if each[0] == "/cmd"]
    states[4], states[5] = states[5], states[4]
    found = samples(write_database(tmp_path / "y.db3", states + commands))
    assert found.counts["backwards"] == 1
    np.testing.assert_array_equal(found.values, samples(write_database(tmp_path / "z.db3", MESSAGES)).values)


def test_a_database_without_definitions_needs_the_types(tmp_path: Path) -> None:
    path = write_database(tmp_path / "x.db3", MESSAGES, defined=False)
    said = refusal(path)
    assert "x.db3" in said
    assert (
        "does not say how these types are defined: arm/msg/Command, arm/msg/State; name the folder or the .msg files"
        in said
    )
    assert "'types' of the source" in said
    folder = tmp_path / "interfaces" / "arm" / "msg"
    folder.mkdir(parents=True)
    (folder / "State.msg").write_text("# of an arm\nfloat64[] position  # rad\nstring name\n")
    assert "defined: arm/msg/Command;" in refusal(path, types=str(tmp_path / "interfaces"))
    (folder / "Command.msg").write_text("float32 torque\n")
    assert_as_in_mcap(samples(path, types=[str(tmp_path / "interfaces")]), tmp_path)
    files = [str(folder / f"{name}.msg") for name in ("State", "Command")]
    assert_as_in_mcap(samples(path, types=files), tmp_path)
    assert "absent: there is no such file or folder" in refusal(path, types=str(tmp_path / "absent"))
    shutil.copytree(folder, tmp_path / "more" / "arm")
    assert_as_in_mcap(samples(path, types=[*files, str(tmp_path / "more")]), tmp_path)
    (tmp_path / "more" / "arm" / "State.msg").write_text("float32[] position\nstring name\n")
    assert "State.msg: defines arm/msg/State otherwise than" in refusal(path, types=[*files, str(tmp_path / "more")])


def joint_states(store: Typestore, name: str = "sensor_msgs/msg/JointState") -> list[Encoded]:
    """Messages of a standard type, or of one that has it in `inner[1]` and `last`."""
    messages = []
    for i in range(20):
        stamp = store.types["builtin_interfaces/msg/Time"](sec=i, nanosec=5)
        header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="base")
        position = np.array([i / 10, -i])
        state = store.types["sensor_msgs/msg/JointState"](header, ["a", "b"], position, np.zeros(2), np.zeros(0))
        if name == "arm/msg/Outer":
            inner = store.types["arm/msg/Inner"](state)
            state = store.types[name]([inner, inner], inner)
        messages.append(("/joint_states", i * SECOND // 20, bytes(store.serialize_cdr(state, name))))
    return messages


STANDARD = {
    "observation": {"joint": {"field": "/joint_states.position[0:2]"}},
    "action": {"continuous": {"second": {"field": "/joint_states.header.stamp.sec"}}},
    "rate_hz": 20.0,
}


@pytest.mark.parametrize("distro", [None, "foxy", "rosbags"])
def test_types_of_ros_2_itself_are_known(tmp_path: Path, distro: str | None) -> None:
    types = {"/joint_states": ("sensor_msgs/msg/JointState", "")}
    path = write_database(
        tmp_path / "x.db3", joint_states(get_typestore(Stores.ROS2_FOXY)), types=types, defined=False, distro=distro
    )
    found = samples(path, **STANDARD).values
    np.testing.assert_allclose(found, [[i / 10, -i, i] for i in range(20)])


def test_own_types_may_hold_types_of_ros_2_and_each_other(tmp_path: Path) -> None:
    texts = {"Outer": "uint8 A=1\nInner[2] inner\narm/Inner last\n", "Inner": "sensor_msgs/JointState state\n"}
    store = get_typestore(Stores.ROS2_HUMBLE)
    (tmp_path / "arm").mkdir()
    for name, text in texts.items():
        (tmp_path / "arm" / f"{name}.msg").write_text(text)
        store.register(get_types_from_msg(text, f"arm/msg/{name}"))
    types = {"/joint_states": ("arm/msg/Outer", "")}
    messages = joint_states(store, "arm/msg/Outer")
    path = write_database(tmp_path / "x.db3", messages, types=types, defined=False)
    changes = STANDARD | {
        "observation": {"joint": {"field": "/joint_states.inner[1].state.position[0:2]"}},
        "action": {"continuous": {"second": {"field": "/joint_states.last.state.header.stamp.sec"}}},
    }
    found = samples(path, types=str(tmp_path / "arm"), **changes).values
    np.testing.assert_allclose(found, [[i / 10, -i, i] for i in range(20)])


def test_a_type_that_changed_between_distributions_is_not_guessed(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    stamp = store.types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    message = store.types["sensor_msgs/msg/Range"](header, 0, 0.0, 0.0, 9.0, 3.5)
    data = bytes(store.serialize_cdr(message, "sensor_msgs/msg/Range"))
    messages = [("/range", i * SECOND // 20, data) for i in range(9)]
    types = {"/range": ("sensor_msgs/msg/Range", "")}
    changes: dict[str, Any] = STANDARD | {
        "observation": {"range": {"field": "/range.range"}},
        "action": {"continuous": {"far": {"field": "/range.max_range"}}},
    }
    unknown = write_database(tmp_path / "x.db3", messages, types=types, defined=False)
    assert "the distributions of ROS 2 define sensor_msgs/msg/Range differently" in refusal(unknown, **changes)
    known = write_database(tmp_path / "y.db3", messages, types=types, defined=False, distro="humble")
    np.testing.assert_array_equal(samples(known, **changes).values, [[3.5, 9.0]] * 9)
    bag = write_metadata(tmp_path, ["x.db3"], ros_distro="humble")
    np.testing.assert_array_equal(samples(bag, **changes).values, [[3.5, 9.0]] * 9)


def test_messages_come_in_batches_and_nobody_loads_what_is_not_wanted(tmp_path: Path) -> None:
    large = BATCH_BYTES // 3
    messages = [("/cmd" if i % 2 else "/joint_states", i, b"\0\1\0\0" + bytes(large)) for i in range(40)]
    path = write_database(tmp_path / "x.db3", messages)
    channels: dict[int, Any] = {}
    runs = list(message_runs(path, channels, topics={"/cmd"}))
    assert {channel.topic for channel, _, _ in runs} == {"/cmd"}
    assert sum(len(run) for _, _, run in runs) == 20
    assert max(run.messages.nbytes for _, _, run in runs) <= BATCH_BYTES + large + 1000
    assert {channel.topic for channel in channels.values()} == {"/cmd", "/joint_states"}


def test_a_topic_or_a_time_that_a_database_does_not_have_is_refused(tmp_path: Path) -> None:
    path = write_database(tmp_path / "x.db3", MESSAGES)
    action = {"continuous": {"torque": {"field": "/other.torque"}}}
    assert "no topic /other; its topics are: /cmd, /joint_states" in refusal(path, action=action)
    assert "says when each message was recorded, not when it was published" in refusal(path, time="publish")


def change(path: Path, statement: str) -> Path:
    database = sqlite3.connect(path)
    database.execute(statement)
    database.commit()
    database.close()
    return path


@pytest.mark.parametrize(
    ("statement", "what"),
    [
        ("DROP TABLE topics", "no such table: topics"),
        ("DROP TABLE messages", "no such table: messages"),
        ("DELETE FROM topics WHERE id = 2", "message 2, after message 1, is out of order, of no topic"),
        ("UPDATE messages SET timestamp = -1 WHERE id = 7", "message 7, after message 6, .* without a time"),
        ("UPDATE messages SET timestamp = 'now' WHERE id = 7", "message 7, after message 6, .* without a time"),
        ("UPDATE messages SET data = 'text' WHERE id = 1", "message 1 has no content"),
        ("UPDATE messages SET data = x'28b52ffd00' WHERE id = 1", "message 0 of topic /joint_states .* but is damaged"),
        ("UPDATE messages SET data = x'00010000' WHERE id = 1", "message 0 of topic /joint_states .* be decoded"),
        ("UPDATE topics SET id = 70000 WHERE id = 1", "the number of the topic /joint_states is 70000"),
        (
            "UPDATE topics SET name = 'a' || char(10) WHERE id = 2",
            r"topic 2 is called 'a\\n', of type 'arm/msg/Command'",
        ),
        ("UPDATE topics SET serialization_format = 'xml'", "topic /joint_states has messages in 'xml'"),
        ("UPDATE message_definitions SET encoding = char(10)", r"the type 'arm/msg/State' is defined in '\\n'"),
        ("UPDATE message_definitions SET encoding = 'ros2idl'", "the schema of topic /joint_states cannot be read"),
    ],
)
def test_a_database_that_makes_no_sense_is_refused(tmp_path: Path, statement: str, what: str) -> None:
    path = change(write_database(tmp_path / "x.db3", MESSAGES), statement)
    said = refusal(path)
    assert said.startswith(f"{path}: ")
    assert re.search(what, said), said


def test_a_file_that_is_no_database_is_empty_or_was_not_closed_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.db3"
    assert "cannot be read (No such file" in refusal(path)
    path.write_bytes(b"")
    assert "the file is empty (0 bytes)" in refusal(path)
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(5000))
    assert "file is not a database" in refusal(path)
    path.unlink()
    whole = write_database(path, MESSAGES).read_bytes()
    path.write_bytes(whole.replace(b"message_definitions(id", b"message_defini'ions(id"))
    assert "x.db3: the file is damaged or no bag (malformed database schema" in refusal(path)
    path.write_bytes(whole)
    path.with_name("x.db3-wal").write_bytes(b"more messages")
    assert "its recording was killed, and x.db3-wal has what is missing" in refusal(path)


@pytest.mark.parametrize(
    "text",
    ["", "[]", "rosbag2_bagfile_information: {}", "rosbag2_bagfile_information: {relative_file_paths: 3}", "a: [", "\0",
     "rosbag2_bagfile_information: {relative_file_paths: [3]}", "at: 2020-99-99"],
)  # fmt: skip
def test_metadata_that_cannot_be_read_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "metadata.yaml").write_text(text)
    assert "does not describe a bag of ROS 2; 'ros2 bag reindex" in refusal(tmp_path)


def test_metadata_that_do_not_fit_the_files_are_refused(tmp_path: Path) -> None:
    write_database(tmp_path / "x.db3", MESSAGES)
    assert "y.db3: the file is not there, but metadata.yaml" in refusal(write_metadata(tmp_path, ["x.db3", "y.db3"]))
    assert "the bag has no files" in refusal(write_metadata(tmp_path, []))
    packed = write_metadata(tmp_path, ["x.db3"], compression_format="lz4")
    assert "compressed by 'lz4', and bags that zstd compressed can be read; make a plain one" in refusal(packed)


def test_five_hundred_damaged_databases_are_refused_in_one_line_or_read(tmp_path: Path) -> None:
    generator = random.Random(5)
    good = write_database(tmp_path / "good.db3", MESSAGES).read_bytes()
    said, path = list[str](), tmp_path / "x.db3"
    for _ in range(500):
        damaged = bytearray(good)
        match generator.randrange(3):
            case 0:
                del damaged[generator.randrange(len(good)) :]
            case 1:
                for _ in range(generator.randint(1, 40)):
                    damaged[generator.randrange(len(good))] = generator.randrange(256)
            case _:
                start = generator.randrange(len(good))
                damaged[start : start + 512] = generator.randbytes(len(damaged[start : start + 512]))
        path.unlink(missing_ok=True)
        path.write_bytes(damaged)
        try:
            samples(path)
        except LogError as error:
            said.append(str(error))
    assert len(said) > 250
    assert all(each.startswith(f"{path}: ") and "\n" not in each for each in said)
