"""Logs of a million transitions: writing, reading and converting them, and what a live recorder adds to a step."""

import io
import tempfile
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from google.protobuf import descriptor_pb2, message_factory
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer
from measuring import median_ratio, print_table, take_turns

from addressed_dynamics.episodes.parquet import TransitionTable, write_table
from addressed_dynamics.episodes.transitions import Dimension, DiscreteAction, SpaceSpec, Transitions
from addressed_dynamics.logs import RunInfo, TransitionLogWriter, read_log, write_log
from addressed_dynamics.logs.schema import TRANSITION_SCHEMA, schema_data, transition_file
from addressed_dynamics.sources.transitions.reading import read_transitions

TRANSITIONS = 1_000_000
SLOW = 50_000
"""Transitions for the contestants that need a dozen microseconds for each; their times are scaled up."""
RECORDED = 100_000
"""Transitions of a log that was recorded live."""
EPISODE = 200
ROUNDS = 3
RUN = RunInfo(environment="benchmark")


def random_walks(transitions: int, dimensions: int) -> Transitions:
    """Return episodes of a random walk, which compress about as well as an environment's states."""
    spec = SpaceSpec(
        tuple(Dimension(f"x{index}", "m", -np.inf, np.inf) for index in range(dimensions)),
        DiscreteAction(("left", "none", "right")),
        step_seconds=1 / 30,
    )
    generator, episodes = np.random.default_rng(0), transitions // EPISODE
    walk = generator.standard_normal((episodes, EPISODE + 1, dimensions)).astype(np.float32) * np.float32(0.01)
    states = np.cumsum(walk, axis=1)
    truncated = np.zeros((episodes, EPISODE), np.bool_)
    truncated[:, -1] = True
    return Transitions(
        spec,
        episode=np.repeat(np.arange(episodes), EPISODE),
        step=np.tile(np.arange(EPISODE, dtype=np.int32), episodes),
        time_ns=np.rint(np.arange(transitions) * (spec.step_seconds * 1e9)).astype(np.int64),
        observation=states[:, :-1].reshape(transitions, dimensions).copy(),
        action=generator.integers(0, 3, transitions),
        reward=np.full(transitions, -1.0, np.float32),
        next_observation=states[:, 1:].reshape(transitions, dimensions).copy(),
        terminated=np.zeros(transitions, np.bool_),
        truncated=truncated.reshape(transitions),
    )


def payloads(log: Path) -> list[bytes]:
    """Return the encoded transitions of a log."""
    with log.open("rb") as stream:
        reader = make_reader(stream)
        return [message.data for _, _, message in reader.iter_messages(topics=["/env_00/transition"])]


def write_one_by_one(path: Path, spec: SpaceSpec, messages: list[bytes]) -> None:
    """Write messages that are encoded already with `mcap.Writer`, as one does."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(TRANSITION_SCHEMA, SchemaEncoding.Protobuf, schema_data(transition_file(spec)))
        channel = writer.register_channel("/env_00/transition", MessageEncoding.Protobuf, schema)
        for number, data in enumerate(messages):
            writer.add_message(channel, number, data, number, number)
        writer.finish()


def decode_one_by_one(log: Path) -> dict[str, list[Any]]:
    """Read a log with `iter_messages` and protobuf into lists, as one does."""
    columns: dict[str, list[Any]] = {}
    with log.open("rb") as stream:
        types: dict[int, Any] = {}
        for schema, _, message in make_reader(stream, validate_crcs=True).iter_messages(topics=["/env_00/transition"]):
            if schema.id not in types:
                files = descriptor_pb2.FileDescriptorSet.FromString(schema.data).file
                types[schema.id] = message_factory.GetMessages(list(files))[schema.name]
            decoded = types[schema.id].FromString(message.data)
            for descriptor in decoded.DESCRIPTOR.fields:
                value = getattr(decoded, descriptor.name)
                if descriptor.message_type is not None:
                    for inner in descriptor.message_type.fields:
                        name = f"{descriptor.name}_{inner.name}"
                        columns.setdefault(name, []).append(getattr(value, inner.name))
                else:
                    columns.setdefault(descriptor.name, []).append(value)
    return columns


def iterate(log: Path) -> None:
    """Go through the messages of a log with `iter_messages`, and decode none."""
    with log.open("rb") as stream:
        for _ in make_reader(stream).iter_messages():
            pass


def to_table(path: Path, transitions: Transitions) -> None:
    """Write transitions as Parquet."""
    split = np.zeros(len(transitions), np.int8)
    write_table(path, TransitionTable(transitions, split, "benchmark"), row_group_rows=131_072)


def recording_of(path: Path, transitions: Transitions) -> Callable[[], None]:
    """Return what records transitions one by one, as rows of arrays that are there already."""
    columns = [transitions.episode.tolist(), transitions.step.tolist(), list(transitions.observation)]
    columns += [transitions.action.tolist(), transitions.reward.tolist(), list(transitions.next_observation)]
    columns += [transitions.terminated.tolist(), transitions.truncated.tolist()]
    rows = list(zip(*columns, strict=True))

    def run() -> None:
        with TransitionLogWriter(path, transitions.spec, run=RUN) as writer:
            for row in rows:
                writer.append(*row)
                if row[-1]:
                    writer.end_episode(None, cut=False)

    return run


def compare(folder: Path, dimensions: int) -> list[list[str]]:
    """Measure everything for observations with so many dimensions."""
    number = count()

    def new(suffix: str) -> Path:
        return folder / f"{dimensions}-{next(number)}{suffix}"

    many, few = random_walks(TRANSITIONS, dimensions), random_walks(SLOW, dimensions)
    log, small = new(".mcap"), new(".mcap")
    write_log(log, many, run=RUN)
    write_log(small, few, run=RUN)
    messages = payloads(small)
    chunks = [each for each in StreamReader(io.BytesIO(log.read_bytes()), emit_chunks=True).records
              if isinstance(each, Chunk)]  # fmt: skip
    live = recording_of(new(".mcap"), few)
    contestants: dict[str, tuple[Callable[[], object], int]] = {
        "write": (lambda: write_log(new(".mcap"), many, run=RUN), TRANSITIONS),
        "mcap.Writer": (lambda: write_one_by_one(new(".mcap"), few.spec, messages), SLOW),
        "parquet": (lambda: to_table(new(".parquet"), many), TRANSITIONS),
        "read": (lambda: read_log(log), TRANSITIONS),
        "iter_messages": (lambda: decode_one_by_one(small), SLOW),
        "zstd": (lambda: [zstandard.ZstdDecompressor().decompress(each.data) for each in chunks], TRANSITIONS),
        "convert": (lambda: to_table(new(".parquet"), read_log(log).transitions), TRANSITIONS),
        "convert naively": (lambda: pq.write_table(pa.table(decode_one_by_one(small)), new(".parquet")), SLOW),
        "live": (live, SLOW),
    }
    seconds = take_turns({name: call for name, (call, _) in contestants.items()}, rounds=ROUNDS)
    wall = {name: [each / rows for each in seconds[name].wall] for name, (_, rows) in contestants.items()}

    def row(ours: str, others: dict[str, tuple[str, str]]) -> list[str]:
        cells = []
        for other, (kind, target) in others.items():
            faster = kind == "faster"
            ratio = median_ratio(wall[other], wall[ours]) if faster else median_ratio(wall[ours], wall[other])
            cells.append(f"{ratio:.1f}x {'faster than' if faster else 'the time of'} {other} ({target})")
        return [f"{dimensions}-d {ours}", f"{1e6 * min(wall[ours]):.2f} µs", *cells, *[""] * (2 - len(cells))]

    return [
        row("write", {"mcap.Writer": ("faster", "at least 6"), "parquet": ("slower", "at most 2.5")}),
        row("read", {"iter_messages": ("faster", "at least 20"), "zstd": ("slower", "at most 5")}),
        row("convert", {"convert naively": ("faster", "at least 15")}),
        [f"{dimensions}-d live", f"{1e6 * min(wall['live']):.2f} µs", "at most 2 µs a step", ""],
    ]


def compare_recorded(folder: Path) -> list[str]:
    """Measure reading a log of 100,000 transitions that was recorded live, with a chunk for each episode."""
    log = folder / "recorded.mcap"
    recording_of(log, random_walks(RECORDED, 2))()
    seconds = take_turns({"read": lambda: read_transitions(log), "iterate": lambda: iterate(log)}, rounds=9)
    ratio = median_ratio(seconds["iterate"].cpu, seconds["read"].cpu)
    each = 1e6 * min(seconds["read"].cpu) / RECORDED
    return [
        "2-d read, recorded live",
        f"{each:.2f} µs",
        f"{ratio:.1f}x faster than iter_messages undecoded (at least 10)",
        "",
    ]


def main() -> None:
    """Print the time per transition, and the ratios."""
    with tempfile.TemporaryDirectory() as temporary:
        rows = [row for dimensions in (2, 6) for row in compare(Path(temporary), dimensions)]
        rows.append(compare_recorded(Path(temporary)))
    print_table(["transitions", "each", "ratio (target)", "ratio (target)"], rows)


if __name__ == "__main__":
    main()
