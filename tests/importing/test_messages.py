"""Messages are read as what they are, or refused in one line: their encoding, their names, their own time."""

import io
import json
import struct
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from foreign_logs import SECOND, Timed, json_log, save, source, states_and_commands
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from mcap_ros2.writer import Writer as Ros2Writer

from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.importing import import_logs
from addressed_dynamics.importing.cdr import cdr_decoder
from addressed_dynamics.sources.transitions.reading import read_transitions

PLAIN = b"\0\1\0\0"
JOINTS = "sensor_msgs/msg/JointState"
JOINT_STATE = "string[] name\nfloat64[] position\nfloat64[] velocity"
STEP = SECOND // 20


@pytest.fixture(autouse=True)
def _in_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def imported(observation: dict[str, str], action: str = "/u.data", **changes: Any) -> Transitions:
    fields = {name: {"field": field} for name, field in observation.items()}
    section = {"rate_hz": 20.0, "tolerance_s": 0.06, "observation": fields} | changes
    section |= {"action": {"continuous": {"u": {"field": action}}}}
    import_logs(source(**section), Path("out"), name="arm", progress=lambda _: None)
    return read_transitions(Path("out"))


def refusal(*arguments: Any, **changes: Any) -> str:
    with pytest.raises(AddressedDynamicsError) as caught:
        imported(*arguments, **changes)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def account() -> dict[str, Any]:
    value: dict[str, Any] = json.loads(Path("out/import.json").read_text())
    return value


def cdr_log(topics: dict[str, tuple[str, str, list[bytes]]]) -> bytes:
    """An MCAP file of ROS 2 messages that are bytes already, at 20 Hz: the type, its definition, and the messages."""
    file = io.BytesIO()
    writer = Writer(file)
    writer.start("ros2")
    for topic, (name, text, payloads) in topics.items():
        schema = writer.register_schema(name, "ros2msg", text.encode())
        channel = writer.register_channel(topic, "cdr", schema)
        for number, payload in enumerate(payloads):
            writer.add_message(channel, number * STEP + 1, payload, number * STEP + 1)
    writer.finish()
    return file.getvalue()


def doubles(values: Any, wrap: Callable[[bytes], bytes] = bytes) -> tuple[str, str, list[bytes]]:
    """Messages of one double each."""
    return ("std_msgs/msg/Float64", "float64 data", [wrap(PLAIN + struct.pack("<d", value)) for value in values])


def ros2_log(messages: list[Timed], types: dict[str, tuple[str, str]]) -> bytes:
    """An MCAP file of ROS 2 messages, by the type and definition of each topic."""
    file = io.BytesIO()
    writer = Ros2Writer(file)
    schemas = {topic: writer.register_msgdef(name, text) for topic, (name, text) in types.items()}
    for topic, time, message in messages:
        writer.write_message(topic, schemas[topic], message, time, time)
    writer.finish()
    return file.getvalue()


def timed(topic: str, messages: list[Any], start: int = SECOND) -> list[Timed]:
    """Messages at 20 Hz."""
    return [(topic, start + number * STEP, message) for number, message in enumerate(messages)]


def pressed(data: bytes) -> bytes:
    return zstandard.ZstdCompressor(level=1).compress(data)


def test_messages_that_were_compressed_one_by_one_are_decompressed_and_said(tmp_path: Path) -> None:
    states, actions = [0.25 + i / 100 for i in range(80)], [i % 5 for i in range(80)]
    save(tmp_path, a=cdr_log({"/q": doubles(states, pressed), "/u": doubles(actions, pressed)}))
    transitions = imported({"q": "/q.data"})
    np.testing.assert_array_equal(transitions.observation[:, 0], np.float32(states[:-1]))
    assert transitions.action[:, 0].tolist() == actions[:-1]
    assert "each message compressed by zstd" in account()["details"]["logs/a.mcap"]["encodings"]["/q"]
    assert account()["totals"]["decompressed"] == 160


def test_a_message_whose_compressed_bytes_are_damaged_is_refused(tmp_path: Path) -> None:
    save(tmp_path, a=cdr_log({"/q": doubles([1.0, 2.0], lambda data: pressed(data)[:-3]), "/u": doubles([0, 0])}))
    assert "message 0 of topic /q (time 1 ns) cannot be decoded: it begins as data do that zstd" in refusal(
        {"q": "/q.data"}
    )


@pytest.mark.parametrize(
    ("header", "what"),
    [
        ("00 02", "a parameter list (PL_CDR)"),
        ("00 03", "a parameter list (PL_CDR)"),
        ("00 07", "XCDR2"),
        ("00 09", "delimited XCDR2"),
        ("00 0b", "a parameter list of XCDR2"),
        ("28 b5", "no encoding of messages that is known"),
        ("01 00", "no encoding of messages that is known"),
    ],
)
def test_what_is_no_plain_cdr_is_refused_by_its_name(header: str, what: str) -> None:
    decode = cdr_decoder("a/msg/B", "ros2msg", "int32 n\nfloat64 x")
    data = bytes.fromhex(header) + b"\0\0" + struct.pack("<id", 1, 2.5)
    with pytest.raises(ValueError, match="say that it is") as caught:
        decode(data)
    assert what in str(caught.value)


@pytest.mark.parametrize(("order", "first"), [("<", 1), (">", 0)])
def test_both_byte_orders_of_plain_cdr_are_read_and_at_most_three_bytes_may_be_left_over(
    order: str, first: int
) -> None:
    decode = cdr_decoder("a/msg/B", "ros2msg", "int32 n\nfloat64 x")
    data = bytes([0, first, 0, 0]) + struct.pack(f"{order}i4xd", 7, 2.5)
    for padding in range(4):
        message = decode(data + bytes(padding))
        assert (message.n, message.x) == (7, 2.5)
    for other in (data + bytes(4), data[:-1], data[:3], b""):
        with pytest.raises(ValueError, match="bytes"):
            decode(other)


def test_bytes_and_characters_are_unsigned_and_words_of_python_are_fields(tmp_path: Path) -> None:
    text = "char c\nchar[] cs\nbyte b\nbyte[2] bs\nuint8 from"
    data = [PLAIN + bytes([200 + i, 0, 0, 0]) + struct.pack("<I", 1) + bytes([201, 250, 251, 252, i]) for i in range(5)]
    save(tmp_path, a=cdr_log({"/q": ("a/msg/Bytes", text, data), "/u": doubles(range(5))}))
    fields = {"c": "/q.c", "cs": "/q.cs[0]", "b": "/q.b", "bs": "/q.bs[1]", "from": "/q.from"}
    observation = imported(fields).observation
    assert observation.tolist() == [[200 + i, 201, 250, 252, i] for i in range(4)]


def test_a_definition_in_idl_is_read() -> None:
    text = "module a { module msg { struct B { double x; octet b; }; }; };"
    message = cdr_decoder("a/msg/B", "ros2idl", "=" * 80 + "\nIDL: a/msg/B\n" + text)(
        PLAIN + struct.pack("<dB", 2.5, 200)
    )
    assert (message.x, message.b) == (2.5, 200)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("wstring w\nfloat64 data", "its field 'w' is a wstring"),
        ("Inner[2] inner\nfloat64 data", "it does not define a/msg/Inner, the type of its field 'inner'"),
    ],
)
def test_a_definition_that_cannot_be_read_is_said_with_its_field(tmp_path: Path, text: str, what: str) -> None:
    save(tmp_path, a=cdr_log({"/q": ("a/msg/B", text, [PLAIN + bytes(8)]), "/u": doubles([0])}))
    message = refusal({"q": "/q.data"})
    assert what in message
    assert "leave the topic out, or record it again with a definition that is whole" in message


def test_a_name_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="is not the name of a type"):
        cdr_decoder("a/msg/B(x)", "ros2msg", "float64 x")


@pytest.mark.parametrize(("magic", "undo"), [("28b52ffd", "zstd -d"), ("1f8b0800", "gunzip"), ("04224d18", "lz4 -d")])
def test_a_file_that_is_compressed_as_a_whole_is_said_with_what_undoes_it(
    tmp_path: Path, magic: str, undo: str
) -> None:
    save(tmp_path, a=bytes.fromhex(magic) + bytes(100))
    assert f"this is a compressed file, not an MCAP log; undo it with '{undo} a.mcap'" in refusal({"q": "/q.data"})


def named(order: list[str], values: dict[str, float]) -> dict[str, Any]:
    """A state of joints, in this order."""
    return {"name": order, "position": [values[name] for name in order], "velocity": []}


def swapping(count: int = 30) -> list[Any]:
    """States with the names in one order, then in the other."""
    values = [{"elbow": 1 + i / 1000, "shoulder": -2 - i / 1000} for i in range(2 * count)]
    orders = [["elbow", "shoulder"]] * count + [["shoulder", "elbow"]] * count
    return [named(order, each) for order, each in zip(orders, values, strict=True)]


@pytest.mark.parametrize("as_ros2", [False, True])
@pytest.mark.parametrize("as_files", [False, True])
def test_arrays_follow_the_names_beside_them(tmp_path: Path, as_ros2: bool, as_files: bool) -> None:
    states = timed("/j", swapping())
    messages = sorted([*states, *timed("/u", [{"data": 0.0}] * 60)], key=lambda each: each[1])
    halves = [messages[:60], messages[60:]] if as_files else [messages]
    types = {"/j": (JOINTS, JOINT_STATE), "/u": ("std_msgs/msg/Float64", "float64 data")}
    logs = [ros2_log(half, types) if as_ros2 else json_log(half) for half in halves]
    save(tmp_path, **{f"part_{number}": log for number, log in enumerate(logs)})
    fields = {"elbow": "/j.position[elbow]", "first": "/j.position[0]", "second": "/j.position[1]"}
    transitions = imported(fields)
    np.testing.assert_allclose(transitions.observation[:, 0], transitions.observation[:, 1])
    assert transitions.observation[:, 1].min() >= 1
    assert transitions.observation[:, 2].max() <= -2
    assert account()["totals"]["reordered"] == 30
    assert account()["details"]["logs/part_0.mcap"]["names"]["/j.position"] == ["elbow", "shoulder"]


def test_a_name_that_is_not_there_is_said_with_those_that_are(tmp_path: Path) -> None:
    messages = [*timed("/j", swapping(3)), *timed("/u", [{"data": 0.0}] * 6)]
    save(tmp_path, a=json_log(sorted(messages, key=lambda each: each[1])))
    message = refusal({"q": "/j.position[wrist]"})
    assert "has no field 'position[wrist]'; the names beside the array are: elbow, shoulder" in message
    assert "has no field 'position[2]'" in refusal({"q": "/j.position[2]"})


def test_a_message_that_lacks_a_joint_has_no_value_for_it(tmp_path: Path) -> None:
    states = swapping(5)
    states[3] = {"name": ["shoulder"], "position": [-9.0], "velocity": []}
    messages = [*timed("/j", states), *timed("/u", [{"data": 0.0}] * 10)]
    save(tmp_path, a=json_log(sorted(messages, key=lambda each: each[1])))
    transitions = imported({"q": "/j.position[elbow]"})
    assert account()["totals"]["not_finite"] == 1
    assert transitions.observation.min() >= 1


@settings(max_examples=30)
@given(orders=st.lists(st.permutations(["a", "b", "c"]), min_size=2, max_size=8))
def test_whatever_the_order_of_the_names_each_value_stays_with_its_name(
    tmp_path_factory: pytest.TempPathFactory, orders: list[list[str]]
) -> None:
    folder = tmp_path_factory.mktemp("orders")
    states = [named(order, {"a": i, "b": 100 + i, "c": 200 + i}) for i, order in enumerate(orders)]
    messages = [*timed("/j", states), *timed("/u", [{"data": 0.0}] * len(orders))]
    save(folder, a=json_log(sorted(messages, key=lambda each: each[1])))
    transitions = imported({"q": "/j.position[0:3]"}, files=[str(folder / "logs" / "*.mcap")])
    first = {"a": 0, "b": 100, "c": 200}
    expected = [[first[name] + i for name in orders[0]] for i in range(len(orders) - 1)]
    assert transitions.observation.tolist() == expected


def test_an_empty_array_is_a_missing_value(tmp_path: Path) -> None:
    states = [{"name": ["j"], "position": [1.0 * i], "velocity": [] if i % 7 == 3 else [0.5]} for i in range(20)]
    messages = [*timed("/j", states), *timed("/u", [{"data": 0.0}] * 20)]
    types = {"/j": (JOINTS, JOINT_STATE), "/u": ("std_msgs/msg/Float64", "float64 data")}
    save(tmp_path, a=ros2_log(sorted(messages, key=lambda each: each[1]), types))
    transitions = imported({"q": "/j.position[0]", "v": "/j.velocity[0]"}, tolerance_s=0.01)
    assert account()["totals"]["not_finite"] == 3
    assert set(transitions.observation[:, 1].tolist()) == {0.5}


def test_each_channel_is_decoded_by_its_own_definition(tmp_path: Path) -> None:
    commands = timed("/u", [{"data": 0.0}] * 5)
    texts = ["float64 q\nfloat64 v", "# the state of joints\nfloat64 q\nfloat64 v", "float64 v\nfloat32 q"]
    for number, text in enumerate(texts):
        start = SECOND + number * 100 * SECOND
        moved = [(topic, time + start, message) for topic, time, message in commands]
        messages = sorted([*timed("/j", [{"q": 1.5, "v": -i} for i in range(5)], SECOND + start), *moved],
                          key=lambda each: each[1])  # fmt: skip
        types = {"/j": ("arm/msg/State", text), "/u": ("std_msgs/msg/Float64", "float64 data")}
        save(tmp_path, **{f"log{number}": ros2_log(messages, types)})
    transitions = imported({"q": "/j.q", "v": "/j.v"})
    assert transitions.observation.tolist() == [[1.5, -i] for i in range(4)] * 3


def test_keys_with_dots_are_named_in_quotes(tmp_path: Path) -> None:
    states = timed("/s", [{"pos.x": 1.0 * i} for i in range(5)])
    save(tmp_path, a=json_log(sorted([*states, *timed("/u", [{"data": 0.0}] * 5)], key=lambda each: each[1])))
    assert imported({"x": '/s."pos.x"'}).observation[:, 0].tolist() == [0, 1, 2, 3]
    assert """has no field 'pos.x'; its fields are: "pos.x\"""" in refusal({"x": "/s.pos.x"})


@pytest.mark.parametrize(
    "stamped",
    [
        lambda s, n: {"header": {"stamp": {"sec": s, "nanosec": n}}},
        lambda s, n: {"header": {"stamp": {"secs": s, "nsecs": n}}},
        lambda s, n: {"timestamp": {"sec": s, "nsec": n}},
        lambda s, n: {"stamp": {"seconds": s, "nanos": n}},
    ],
)
def test_the_time_that_messages_say_of_themselves_can_be_taken(tmp_path: Path, stamped: Any) -> None:
    # They were logged in a burst, a second late, and the commands say no time.
    states = [("/s", 10 * SECOND + i, {"q": 1.0 * i, **stamped(9, i * STEP)}) for i in range(10)]
    commands = timed("/u", [{"data": 0.5}] * 12, 9 * SECOND - STEP)
    save(tmp_path, a=json_log([*commands, *states]))
    transitions = imported({"q": "/s.q"}, time="header", topics={"/u": {"time": "log"}})
    assert transitions.observation[:, 0].tolist() == list(range(9))
    assert "says no time of itself (looked for header.stamp, stamp, timestamp" in refusal({"q": "/s.q"}, time="header")


def test_times_that_nobody_set_are_refused(tmp_path: Path) -> None:
    states = timed("/s", [{"q": 1.0, "stamp": {"sec": 0, "nanosec": 0}}] * 5)
    save(tmp_path, a=json_log([*states, *timed("/u", [{"data": 0.0}] * 5)]))
    message = refusal({"q": "/s.q"}, topics={"/s": {"time": "header"}})
    assert "all messages of topic /s say that their time is 0, which nobody set" in message


def test_a_slow_topic_has_a_tolerance_of_its_own_and_what_is_sent_once_is_held(tmp_path: Path) -> None:
    states = timed("/s", [{"q": 1.0 * i} for i in range(60)], 10 * SECOND)
    slow = [("/u", 10 * SECOND + i * SECOND, {"data": 1.0 * i}) for i in range(3)]
    goal = [("/goal", SECOND, {"x": 7.0})]
    save(tmp_path, a=json_log([*goal, *sorted([*states, *slow], key=lambda each: each[1])]))
    fields = {"q": "/s.q", "goal": "/goal.x"}
    assert "a value that is sent once needs 'hold: true'" in refusal(fields)
    held = {"/goal": {"hold": True}}
    assert len(imported(fields, topics={**held, "/u": {"tolerance_s": 1.0}})) == 59
    assert account()["totals"]["late"] == 0
    assert len(imported(fields, topics=held, min_length=2)) == 3
    assert account()["totals"]["late"] == 36


def test_an_episode_ends_where_the_clock_goes_back_and_what_is_held_holds_on(tmp_path: Path) -> None:
    messages = [("/goal", 1, {"x": 7.0})]
    for turn in range(3):
        states = timed("/s", [{"q": 100.0 * turn + i} for i in range(10)])
        messages += sorted([*states, *timed("/u", [{"data": turn}] * 10)], key=lambda each: each[1])
    save(tmp_path, a=json_log(messages))
    fields = {"q": "/s.q", "goal": "/goal.x"}
    changes: dict[str, Any] = {"topics": {"/goal": {"hold": True}}}
    assert "end episodes there with 'by: reset'" in refusal(fields, **changes)
    transitions = imported(fields, **changes, episode={"by": "reset"})
    assert transitions.observation[:, 0].tolist() == [100 * turn + i for turn in range(3) for i in range(9)]
    assert transitions.action[:, 0].tolist() == [turn for turn in range(3) for _ in range(9)]
    assert set(transitions.observation[:, 1].tolist()) == {7.0}
    assert account()["totals"]["messages"] == 61


def test_what_is_held_over_a_reset_is_the_last_finite_value_and_no_period(tmp_path: Path) -> None:
    messages: list[Timed] = [("/goal", 1, {"x": 7.0}), ("/goal", 2, {"x": float("nan")})]
    for turn in range(3):
        goals = timed("/goal", [{"x": 8.0}] * 2, start=SECOND + 5 * STEP) if turn else []
        states = timed("/s", [{"q": 100.0 * turn + i} for i in range(10)])
        messages += sorted([*states, *goals, *timed("/u", [{"data": turn}] * 10)], key=lambda each: each[1])
    save(tmp_path, a=json_log(messages))
    changes: dict[str, Any] = {"topics": {"/goal": {"hold": True}}, "episode": {"by": "reset"}}
    transitions = imported({"q": "/s.q", "goal": "/goal.x"}, **changes)
    assert transitions.observation[:, 1].tolist() == [7.0] * (9 + 5) + [8.0] * (4 + 9)
    (details,) = account()["details"].values()
    goal = details["topics"]["/goal"]
    assert (goal["messages"], goal["not_finite"], goal["measured_hz"]) == (6, 1, 20.0)


def split_recording(folder: Path, **first: Any) -> list[Timed]:
    """Three files of a second each, the first of which has all messages of `first` as well."""
    messages = states_and_commands(3.0)
    marks = [(topic, 100 * SECOND, message) for topic, message in first.items()]
    borders = [100 * SECOND, 101 * SECOND, 102 * SECOND, 104 * SECOND]
    for number, (start, end) in enumerate(pairwise(borders)):
        part = [each for each in messages if start <= each[1] < end]
        save(folder, **{f"bag_{[2, 9, 10][number]}": json_log([*(marks if number == 0 else []), *part])})
    return messages


@pytest.mark.parametrize("episode", [{"by": "gap", "seconds": 1.0}, {"by": "topic", "field": "/ep.id"}])
def test_files_that_follow_each_other_are_one_recording(tmp_path: Path, episode: dict[str, Any]) -> None:
    messages = split_recording(tmp_path, **{"/ep": {"id": 4}})
    (tmp_path / "x").mkdir()
    save(tmp_path / "x", whole=json_log([("/ep", 100 * SECOND, {"id": 4}), *messages]))
    changes = {"observation": {"q": {"field": "/joint_states.position[0]"}}, "episode": episode}
    found = []
    for files, folder in (("logs/*.mcap", Path("split")), ("x/logs/*.mcap", Path("whole"))):
        import_logs(source(**changes, files=[files]), folder, name="arm", progress=lambda _: None)
        found.append(read_transitions(folder))
        assert len(np.unique(found[-1].episode)) == 1
    np.testing.assert_array_equal(found[0].observation, found[1].observation)
    np.testing.assert_array_equal(found[0].action, found[1].action)


def test_the_files_of_a_recording_are_counted_and_named(tmp_path: Path) -> None:
    split_recording(tmp_path)
    import_logs(source(episode={"by": "gap", "seconds": 1.0}), Path("out"), name="arm", progress=lambda _: None)
    assert account()["totals"]["joined_files"] == 2
    files = ["logs/bag_2.mcap", "logs/bag_9.mcap", "logs/bag_10.mcap"]
    assert account()["details"]["logs/bag_2.mcap"]["files"] == files
    import_logs(source(), Path("out"), name="arm", progress=lambda _: None)
    assert account()["totals"]["episodes"] == 3


def test_files_apart_in_time_stay_apart(tmp_path: Path) -> None:
    save(tmp_path, b=json_log(states_and_commands(1.0)), a=json_log(states_and_commands(1.0, start=200 * SECOND)))
    import_logs(source(episode={"by": "gap", "seconds": 1.0}), Path("out"), name="arm", progress=lambda _: None)
    assert list(account()["files"]) == ["logs/b.mcap", "logs/a.mcap"]
    assert account()["totals"]["joined_files"] == 0


def test_a_clock_that_ticks_faster_than_the_log_is_a_warning_with_the_measured_rate(tmp_path: Path) -> None:
    save(tmp_path, a=json_log(states_and_commands()))
    for rate, warned in ((20.0, False), (500.0, True)):
        import_logs(source(rate_hz=rate), Path("out"), name="arm", progress=lambda _: None)
        details = account()["details"]["logs/a.mcap"]
        assert details["topics"]["/joint_states"]["measured_hz"] == pytest.approx(20.0)
        assert bool(details["warnings"]) == warned
    assert "the clock ticks at 500 Hz, but /joint_states has 20 messages a second" in details["warnings"][0]
