"""Simulate a torque-driven pendulum and log it as robots do: three MCAP logs with noisy, unsynchronised topics.

Each log has its own encoding (protobuf, JSON, ROS 2 CDR) and the same two topics: `/joint_states` at about 100 Hz and
`/command` at about 40 Hz, whose messages have their own clocks. Between two episodes nothing is logged for a while.
"""

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from jaxtyping import Float64
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer
from mcap_ros2.writer import Writer as Ros2Writer

GRAVITY, LENGTH, MASS = 9.81, 0.5, 1.0  # m/s², m, kg
VISCOUS, DRY, DRY_SPEED = 0.4, 0.1, 0.05  # N m s, N m, rad/s at which dry friction has three quarters of its torque
TORQUE = 2.0  # N m; with so much friction no choice of torques swings the pendulum beyond 1.7 rad
TICK = 0.001  # s, of the integration
COMMAND_PERIOD, COMMAND_JITTER, COMMAND_HOLD = 0.025, 0.002, 16  # s, s, messages in the mean
SENSOR_PERIOD, SENSOR_JITTER = 0.010, 0.0015  # s
POSITION_NOISE, VELOCITY_NOISE = 0.002, 0.01  # rad, rad/s
PAUSE = 2.0  # s between two episodes
START_NS = 1_700_000_000_000_000_000

JOINTS, COMMAND = "/joint_states", "/command"
Write = Callable[[str, int, Mapping[str, Any]], None]
"""Writes one message: topic, time in nanoseconds, fields."""
Encode = Callable[[str, Mapping[str, Any]], bytes]
"""Makes a message's bytes of its topic and fields."""
Log = tuple[Write, Callable[[], None]]
"""Writes a message; finishes the file."""
Message = tuple[float, str, dict[str, Any]]
"""Seconds since the start of its episode, topic, fields."""
Times = Float64[np.ndarray, " time"]
"""Seconds since the start of an episode."""
State = Float64[np.ndarray, "2 episode"]
"""Angle (rad, 0 where the pendulum hangs) and speed (rad/s)."""


def integrate(
    torque: Float64[np.ndarray, "tick episode"], angle: Float64[np.ndarray, " episode"], length: float = LENGTH
) -> Float64[np.ndarray, "time 2 episode"]:
    """Return the states before each tick and after the last one, from rest at `angle` (rad) under `torque` (N m).

    The mass is at the end of an arm of `length` (m).
    """
    states = np.empty((len(torque) + 1, 2, len(angle)))
    states[0] = angle, np.zeros_like(angle)
    for tick, applied in enumerate(torque):  # Runge and Kutta, order 4
        state = states[tick]
        k1 = _derivative(state, applied, length)
        k2 = _derivative(state + TICK / 2 * k1, applied, length)
        k3 = _derivative(state + TICK / 2 * k2, applied, length)
        k4 = _derivative(state + TICK * k3, applied, length)
        states[tick + 1] = state + TICK / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return states


def _derivative(state: State, torque: Float64[np.ndarray, " episode"], length: float) -> State:
    angle, speed = state
    friction = VISCOUS * speed + DRY * np.tanh(speed / DRY_SPEED)
    gravity = MASS * GRAVITY * length * np.sin(angle)
    return np.stack([speed, (torque - friction - gravity) / (MASS * length**2)])


def simulate(
    episodes: int, seconds: float, generator: np.random.Generator, length: float = LENGTH
) -> list[list[Message]]:
    """Return the messages of some episodes, in the order of their times.

    A torque is drawn and held for a random number of commands. The longest possible episode takes `seconds`, the
    shortest 0.7 of that. The arm has `length` (m).
    """
    torque = np.empty((round(seconds / TICK), episodes))
    grid = np.arange(len(torque) + 1) * TICK
    logged: list[list[Message]] = []
    for episode in range(episodes):
        sent = _jittered(seconds, COMMAND_PERIOD, COMMAND_JITTER, generator)
        changes = np.append(True, generator.random(len(sent) - 1) < 1 / COMMAND_HOLD)
        drawn = generator.uniform(-TORQUE, TORQUE, len(sent))
        torques = drawn[np.maximum.accumulate(np.where(changes, np.arange(len(sent)), 0))]
        newest = np.searchsorted(sent, grid[:-1], side="right") - 1
        torque[:, episode] = np.where(newest < 0, 0.0, torques[newest])
        logged.append([(at, COMMAND, {"data": each}) for at, each in zip(sent.tolist(), torques.tolist(), strict=True)])
    states = integrate(torque, generator.uniform(-0.8, 0.8, episodes), length)
    for episode, messages in enumerate(logged):
        read = _jittered(seconds, SENSOR_PERIOD, SENSOR_JITTER, generator)
        noise = generator.normal(0.0, [POSITION_NOISE, VELOCITY_NOISE], (len(read), 2)).T
        angle, speed = (np.interp(read, grid, states[:, place, episode]) + noise[place] for place in (0, 1))
        for at, position, velocity in zip(read.tolist(), angle.tolist(), speed.tolist(), strict=True):
            messages.append((at, JOINTS, {"position": [position], "velocity": [velocity]}))
        end = seconds * generator.uniform(0.7, 1.0)
        logged[episode] = sorted((each for each in messages if each[0] < end), key=lambda each: each[:2])
    return logged


def _jittered(seconds: float, period: float, jitter: float, generator: np.random.Generator) -> Times:
    """Return times about `period` apart with a random phase, none of them earlier than the one before."""
    count = int(seconds / period) - 1
    shift = generator.normal(0.0, jitter, count).clip(-0.4 * period, 0.4 * period)
    times: Times = (np.arange(count) + generator.uniform(0.4, 1.0)) * period + shift
    return times


def protobuf_log(file: IO[bytes]) -> Log:
    """Begin a log of messages whose types are made here, as a compiler of .proto files would make them."""
    shapes = {JOINTS: ("JointStates", {"position": True, "velocity": True}), COMMAND: ("Command", {"data": False})}
    proto = FileDescriptorProto(name="pendulum.proto", package="pendulum", syntax="proto3")
    for name, fields in shapes.values():
        message = proto.message_type.add(name=name)
        for number, (field, several) in enumerate(fields.items(), start=1):
            label = FieldDescriptorProto.LABEL_REPEATED if several else FieldDescriptorProto.LABEL_OPTIONAL
            message.field.add(name=field, number=number, label=label, type=FieldDescriptorProto.TYPE_DOUBLE)
    pool = DescriptorPool()
    pool.Add(proto)
    schema = FileDescriptorSet(file=[proto]).SerializeToString()
    names = {topic: f"pendulum.{name}" for topic, (name, _) in shapes.items()}
    types = {topic: GetMessageClass(pool.FindMessageTypeByName(name)) for topic, name in names.items()}
    schemas = {topic: (name, SchemaEncoding.Protobuf, schema) for topic, name in names.items()}
    return _log(
        file, schemas, MessageEncoding.Protobuf, lambda topic, fields: types[topic](**fields).SerializeToString()
    )


def json_log(file: IO[bytes]) -> Log:
    """Begin a log of JSON messages."""
    numbers = {"type": "array", "items": {"type": "number"}}
    fields = {JOINTS: {"position": numbers, "velocity": numbers}, COMMAND: {"data": {"type": "number"}}}
    schemas = {
        topic: (topic[1:], SchemaEncoding.JSONSchema, json.dumps({"type": "object", "properties": each}).encode())
        for topic, each in fields.items()
    }
    return _log(file, schemas, MessageEncoding.JSON, lambda _, fields: json.dumps(fields).encode())


def _log(file: IO[bytes], schemas: Mapping[str, tuple[str, str, bytes]], encoding: str, encode: Encode) -> Log:
    writer = Writer(file)
    writer.start(library="make_logs.py")
    channels = {
        topic: writer.register_channel(topic, encoding, writer.register_schema(*schema))
        for topic, schema in schemas.items()
    }

    def write(topic: str, time_ns: int, fields: Mapping[str, Any]) -> None:
        writer.add_message(channels[topic], time_ns, encode(topic, fields), time_ns)

    return write, writer.finish


def ros2_log(file: IO[bytes]) -> Log:
    """Begin a log of two types that every ROS 2 system has, as `ros2 bag record` does."""
    parts = (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
        "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n",
        "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n",
    )
    writer = Ros2Writer(file)
    schemas = {
        JOINTS: writer.register_msgdef("sensor_msgs/msg/JointState", f"{'=' * 80}\n".join(parts)),
        COMMAND: writer.register_msgdef("std_msgs/msg/Float64", "float64 data\n"),
    }

    def write(topic: str, time_ns: int, fields: Mapping[str, Any]) -> None:
        seconds, nanoseconds = divmod(time_ns, 10**9)
        header = {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": ""}
        rest = {"header": header, "name": ["hinge"], "effort": []} if topic == JOINTS else {}
        writer.write_message(topic, schemas[topic], {**rest, **fields}, time_ns, time_ns)

    return write, writer.finish


LOGS = {"protobuf": protobuf_log, "json": json_log, "ros2": ros2_log}
"""What begins each log, by the name of its file."""


def write_logs(folder: Path, *, episodes: int, seconds: float, seed: int, length: float = LENGTH) -> None:
    """Write a log in each encoding, with so many episodes, the longest of which take `seconds`.

    The arm has `length` (m).
    """
    folder.mkdir(parents=True, exist_ok=True)
    simulated = simulate(len(LOGS) * episodes, seconds, np.random.default_rng(seed), length)
    for index, (name, log) in enumerate(LOGS.items()):
        start_ns = START_NS
        with (folder / f"{name}.mcap").open("wb") as file:
            write, finish = log(file)
            for messages in simulated[index :: len(LOGS)]:
                for at, topic, fields in messages:
                    write(topic, start_ns + round(at * 1e9), fields)
                start_ns += round((messages[-1][0] + PAUSE) * 1e9)
            finish()


def main() -> None:
    """Write the logs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "logs", help="folder of the logs")
    parser.add_argument("--episodes", type=int, default=12, help="episodes in each log")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of the longest episodes")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    write_logs(options.out, episodes=options.episodes, seconds=options.seconds, seed=options.seed)


if __name__ == "__main__":
    main()
