"""The file of a log while it is being written: its name, its beginning, its blocks of messages, and its end."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Sequence
from functools import lru_cache
from importlib.metadata import version
from io import BufferedWriter
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int, Int64, Shaped, UInt8
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from numpy.typing import ArrayLike

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.episodes.transitions import DiscreteAction, SpaceSpec
from addressed_dynamics.logs.container import MESSAGE_HEADER
from addressed_dynamics.logs.container_writer import INDEX_ENTRY, ContainerWriter
from addressed_dynamics.logs.contents import Ended, RunInfo, RunRecord
from addressed_dynamics.logs.layout import MessageLayout
from addressed_dynamics.logs.schema import (
    ENDED,
    EPISODE_SCHEMA,
    TRANSITION_SCHEMA,
    UNKNOWN_SEED,
    episode_file,
    episode_layout,
    schema_data,
    transition_file,
    transition_layout,
)

CHUNK_BYTES = 1024 * 1024
"""Most bytes in a chunk, before compression."""

RUN_RECORD = "run"
"""Name of the metadata record that says where a log comes from."""

TRANSITION_CHANNEL, EPISODE_CHANNEL = 1, 2
"""Ids of the two channels of every log, and of their schemas."""

_LARGEST_SEQUENCE = 0xFFFFFFFF


class LogFile:
    """The unfinished file of a log, `path` with `.partial` appended; it gets its name when it is complete.

    Args:
        path: of the complete log.
        spec: what its numbers mean.
        topic: of its transitions, without their last part.
        run: where they come from.
        is_kept: whether the unfinished file stays if it cannot be completed, for `recover_log`.

    Raises:
        SpaceError: a dimension has a name that a log cannot hold.
        LogError: the file cannot be written, or another recording is using it or has left it unfinished.
    """

    def __init__(self, path: Path, spec: SpaceSpec, *, topic: str, run: RunInfo, is_kept: bool = True) -> None:
        self.path = path
        self._is_kept = is_kept
        self.partial = path.with_name(f"{path.name}.partial")
        self.spec = spec
        self.safe_count = 0
        """Transitions that survive if the process is killed now."""
        transition, episode = transition_file(spec), episode_file()
        self.transition_layout = transition_layout(spec)
        self.episode_layout = episode_layout()
        self._file = _create(self.partial)
        self._container: ContainerWriter | None = None
        try:
            self.do(self._begin, RunRecord(run, spec, topic), schema_data(transition), schema_data(episode))
        except BaseException:
            self.partial.unlink()
            raise

    @property
    def container(self) -> ContainerWriter:
        """The writer of the file's records."""
        assert self._container is not None
        return self._container

    @property
    def closed(self) -> bool:
        """Whether nothing can be written any more."""
        return self._file.closed

    def do(self, write: Callable[..., Any], *arguments: Any) -> None:
        """Call what writes to the file; whatever goes wrong in it leaves the unfinished file for `recover_log`.

        Raises:
            LogError: the file is closed or cannot be written; the message says how many transitions are safe.
        """
        if self._file.closed:
            message = f"{self.path}: the log is closed, so nothing can be added to it; record to a new one"
            raise LogError(message)
        try:
            write(*arguments)
        except OSError as error:
            self.abandon()
            raise LogError(self._unwritten(error)) from error
        except BaseException:
            # Ctrl-C inside a record leaves half of it in the file, which must not be completed with that.
            self.abandon()
            raise

    def _unwritten(self, error: OSError) -> str:
        if not self._is_kept:
            return f"{self.path}: the log cannot be written ({error.strerror}); make room, and write it again"
        return (
            f"{self.partial}: the log cannot be written ({error.strerror}); {self.safe_count} transitions are safe "
            f"in it: make room, then 'addressed-dynamics recover {self.partial}' writes them to a new file"
        )

    def finish(self) -> None:
        """Complete the file and give it its name."""
        self.do(self._finish)

    def abandon(self) -> None:
        """Close the unfinished file and leave it where it is."""
        try:
            self._file.close()
        except OSError:
            # Closing flushes what is left; on a full disk that fails again, and the file is closed all the same.
            self._file.raw.close()

    def _begin(self, record: RunRecord, transition: bytes, episode: bytes) -> None:
        metadata = record.to_metadata()
        container = ContainerWriter(self._file, library=f"addressed-dynamics {version('addressed-dynamics')}")
        container.add_metadata(RUN_RECORD, metadata)
        # The channel has a copy of the run record, because every chunk and the summary repeat it.
        container.describe(
            [
                Schema(TRANSITION_CHANNEL, data=transition, name=TRANSITION_SCHEMA, encoding=SchemaEncoding.Protobuf),
                Schema(EPISODE_CHANNEL, data=episode, name=EPISODE_SCHEMA, encoding=SchemaEncoding.Protobuf),
            ],
            [
                _channel(TRANSITION_CHANNEL, f"{record.topic}/transition", metadata),
                _channel(EPISODE_CHANNEL, "/episode", {}),
            ],
        )
        container.flush()
        self._container = container

    def _finish(self) -> None:
        self.container.finish()
        os.fsync(self._file.fileno())
        self._file.close()
        self.partial.replace(self.path)


class TransitionRows:
    """A block of encoded transitions: an array of messages, with a view of each of their fields.

    Args:
        layout: where the fields are.
        spec: which fields there are.
        messages: memory for the messages with their headers; tags, lengths and the channel are filled in.
    """

    def __init__(self, layout: MessageLayout, spec: SpaceSpec, messages: UInt8[np.ndarray, "message byte"]) -> None:
        messages[:] = _template(layout, TRANSITION_CHANNEL)
        records = messages.view(_record(layout.dtype))[:, 0]
        self.messages = messages
        self._header, rows = records["header"], records["message"]
        self.episode: Int64[np.ndarray, " message"] = layout.scalar(rows, "episode")
        self.step: Int[np.ndarray, " message"] = layout.scalar(rows, "step")
        self.reward: Float32[np.ndarray, " message"] = layout.scalar(rows, "reward")
        self.terminated: UInt8[np.ndarray, " message"] = layout.scalar(rows, "terminated")
        self.truncated: UInt8[np.ndarray, " message"] = layout.scalar(rows, "truncated")
        self.observation = _parts(layout, rows, "observation")
        self.next_observation = _parts(layout, rows, "next_observation")
        self.action = (
            [(layout.scalar(rows, "action"), ...)]
            if isinstance(spec.action, DiscreteAction)
            else _parts(layout, rows, "action")
        )
        self.exogenous = _parts(layout, rows, "exogenous") if spec.exogenous else []

    def stamp(self, sequence: Int64[np.ndarray, " message"], time_ns: Int64[np.ndarray, " message"]) -> None:
        """Give the first messages their numbers and their times."""
        header = self._header[: len(sequence)]
        header["sequence"] = sequence & _LARGEST_SEQUENCE
        header["log_time"] = header["publish_time"] = time_ns


Vector = Float[np.ndarray, " component"] | list[float]
"""The components of an observation, of an action or of exogenous inputs; a list is packed as it is."""

Pack = Callable[..., None]
"""Packs the fields of one transition, in the order of `Transitions` without the time, from a byte of a chunk on."""


def transition_packer(layout: MessageLayout, spec: SpaceSpec, chunk: UInt8[np.ndarray, " byte"]) -> Pack:
    """Return what packs transitions into `chunk` one by one, in half the time of filling in an array's fields.

    Args:
        layout: where the fields are.
        spec: which fields there are.
        chunk: memory to pack into.
    """
    template, header = _template(layout, TRANSITION_CHANNEL).tobytes(), MESSAGE_HEADER.itemsize
    arguments: list[Any] = []
    fields: dict[str, list[int]] = {}
    codes, position = "<", 0
    for offset, code, name in layout.values():
        codes += f"{header + offset - position}s{_STRUCT_CODES[code]}"
        arguments += [template[position : header + offset], 0]
        fields.setdefault(name, []).append(len(arguments) - 1)
        position = header + offset + code.itemsize
    # A tag stands before every value, so the values of a vector are every other argument.
    place: dict[str, Any] = {name: slice(indices[0], indices[-1] + 1, 2) for name, indices in fields.items()}
    for name in ("episode", "step", "reward", "terminated", "truncated"):
        place[name] = fields[name][0]
    at_episode, at_step, at_reward = place["episode"], place["step"], place["reward"]
    at_observation, at_next, at_action = place["observation"], place["next_observation"], place["action"]
    at_terminated, at_truncated = place["terminated"], place["truncated"]
    at_exogenous = place.get("exogenous")
    discrete = isinstance(spec.action, DiscreteAction)
    if discrete:
        at_action = at_action.start
    memory, pack_into = memoryview(chunk.data), struct.Struct(codes).pack_into

    def pack(  # every name is a local one: this is called at every step of an environment
        byte: int,
        episode: int,
        step: int,
        observation: Vector,
        action: Any,
        reward: float,
        next_observation: Vector,
        terminated: bool,
        truncated: bool,
        exogenous: Vector,
    ) -> None:
        arguments[at_episode] = episode
        arguments[at_step] = step
        arguments[at_observation] = observation if isinstance(observation, list) else observation.tolist()
        arguments[at_action] = action if discrete or isinstance(action, list) else action.tolist()
        arguments[at_reward] = reward
        arguments[at_next] = next_observation if isinstance(next_observation, list) else next_observation.tolist()
        arguments[at_terminated] = terminated
        arguments[at_truncated] = truncated
        if at_exogenous is not None:
            arguments[at_exogenous] = exogenous if isinstance(exogenous, list) else exogenous.tolist()
        pack_into(memory, byte, *arguments)

    return pack


_STRUCT_CODES = {
    np.dtype("<f4"): "f",
    np.dtype("<f8"): "d",
    np.dtype("<i4"): "i",
    np.dtype("<i8"): "q",
    np.dtype("|u1"): "?",
}


def episode_messages(
    layout: MessageLayout,
    *,
    episode: ArrayLike,
    seed: Sequence[int | None],
    episode_return: ArrayLike,
    length: ArrayLike,
    ended: Sequence[Ended],
    sequence: ArrayLike,
    time_ns: ArrayLike,
) -> UInt8[np.ndarray, "episode byte"]:
    """Return the encoded messages, with their headers, that tell how episodes ended."""
    messages = np.tile(_template(layout, EPISODE_CHANNEL), (len(ended), 1))
    records = messages.view(_record(layout.dtype))[:, 0]
    header, rows = records["header"], records["message"]
    header["sequence"] = np.asarray(sequence) & _LARGEST_SEQUENCE
    header["log_time"] = header["publish_time"] = time_ns
    rows["episode"], rows["return"], rows["length"] = episode, episode_return, length
    rows["seed"] = [UNKNOWN_SEED if each is None else each for each in seed]
    rows["ended"] = [ENDED.index(each) for each in ended]
    return messages


def message_bytes(layout: MessageLayout) -> int:
    """Return the length of a message with its header."""
    return MESSAGE_HEADER.itemsize + layout.size


def index_entries(
    time_ns: Int64[np.ndarray, " message"] | list[int], offset: Int[np.ndarray, " message"] | list[int]
) -> Shaped[np.ndarray, " message"]:
    """Return the index of messages at these times and places in their chunk."""
    entries = np.empty(len(time_ns), INDEX_ENTRY)
    entries["log_time"], entries["offset"] = time_ns, offset
    return entries


def ended_as(terminated: bool, truncated: bool) -> Ended:
    """Return how an episode ended whose last transition has these flags."""
    return "terminated" if terminated else "truncated" if truncated else "cut"


Part = tuple[np.ndarray, Any]
"""A view of some components of a field, and which components of a vector they are (all: an ellipsis)."""


def _parts(layout: MessageLayout, rows: Shaped[np.ndarray, " message"], field: str) -> list[Part]:
    views = layout.vector_parts(rows, field)
    if len(views) == 1:
        return [(views[0], ...)]
    stops = np.cumsum([view.shape[1] for view in views]).tolist()
    return [(view, (..., slice(stop - view.shape[1], stop))) for view, stop in zip(views, stops, strict=True)]


@lru_cache(maxsize=16)
def _record(message: np.dtype[Any]) -> np.dtype[Any]:
    return np.dtype([("header", MESSAGE_HEADER), ("message", message)])


def _template(layout: MessageLayout, channel: int) -> UInt8[np.ndarray, " byte"]:
    header = np.zeros(1, MESSAGE_HEADER)
    header["opcode"], header["channel"] = Opcode.MESSAGE, channel
    header["length"] = message_bytes(layout) - (1 + 8)
    template: UInt8[np.ndarray, " byte"] = np.concatenate([header.view(np.uint8), layout.template])
    return template


def _channel(number: int, topic: str, metadata: dict[str, str]) -> Channel:
    return Channel(number, topic, MessageEncoding.Protobuf, metadata, schema_id=number)


def _create(partial: Path) -> BufferedWriter:
    try:
        partial.parent.mkdir(parents=True, exist_ok=True)
        return partial.open("xb")
    except OSError as error:
        if partial.exists():
            message = (
                f"{partial}: another recording is writing this file, or was interrupted; "
                f"'addressed-dynamics recover {partial}' saves what is in it; then remove it"
            )
        else:
            message = f"{partial}: the log cannot be created ({error.strerror}); choose a folder that can be written"
        raise LogError(message) from error
