"""Write transitions to an MCAP log that survives a crash."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.metadata import version
from io import BufferedWriter
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from jaxtyping import Float, Shaped
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from addressed_dynamics.errors import LogError
from addressed_dynamics.logs.container import MESSAGE_HEADER
from addressed_dynamics.logs.contents import Ended, RunInfo, RunRecord
from addressed_dynamics.logs.layout import MessageLayout, Rows, message_layout
from addressed_dynamics.logs.schema import (
    ENDED,
    EPISODE_SCHEMA,
    TRANSITION_SCHEMA,
    UNKNOWN_SEED,
    episode_file,
    schema_data,
    transition_file,
)
from addressed_dynamics.transitions import DiscreteAction, SpaceSpec

CHUNK_BYTES = 1024 * 1024
"""Most bytes of messages in a chunk, before compression."""

RUN_RECORD = "run"
"""Name of the metadata record that says where a log comes from."""

TRANSITION_CHANNEL, EPISODE_CHANNEL = 1, 2
"""Ids of the two channels of every log; `mcap.Writer` counts from 1."""


class TransitionLogWriter:
    """Writes one log: `path` with `.partial` appended, renamed to `path` when it is complete.

    The end of an episode closes a chunk and hands it to the operating system, so that a process that is killed loses
    at most the episode it was in; `recover_log` makes a log of what is left. Log times are simulated: the number of
    transitions so far times the length of a step.

    Args:
        path: the log; an existing one is replaced, but only by a complete one.
        spec: names, units and bounds of observations and actions, and the length of a step.
        topic: transitions go to the topic `<topic>/transition`, episodes to `/episode`.
        run: where the data comes from.
        first_step: number of transitions in the logs before this one, if it continues them; so does its clock.

    Raises:
        SpaceError: a dimension has a name that a log cannot hold.
        LogError: the file cannot be written, or another recording is using it or has left it unfinished.
    """

    def __init__(
        self, path: Path, spec: SpaceSpec, *, topic: str = "/env_00", run: RunInfo, first_step: int = 0
    ) -> None:
        self.path = path
        self.partial = path.with_name(f"{path.name}.partial")
        self.count = 0
        """Transitions appended so far."""
        self.safe_count = 0
        """Transitions that survive if the process is killed now."""
        self._first_step = first_step
        self._step_ns = spec.step_seconds * 1e9
        self._episode_length, self._episode_return = 0, 0.0
        self._pending = False
        transition, episode = transition_file(spec), episode_file()
        self._transition = _Slots(message_layout(transition.message_type[0]), spec)
        self._episode_layout = message_layout(episode.message_type[0])
        self._file = _create(self.partial)
        # A chunk is closed after the message that takes it past the limit; leave room for one message of each kind.
        headroom = self._transition.layout.size + self._episode_layout.size + 2 * MESSAGE_HEADER.itemsize
        self._mcap = Writer(self._file, chunk_size=max(CHUNK_BYTES - headroom, 0), enable_data_crcs=True)
        self._do(self._begin, RunRecord(run, spec, topic), schema_data(transition), schema_data(episode))

    def append(
        self,
        episode: int,
        step: int,
        observation: Float[np.ndarray, " observation"],
        action: int | Float[np.ndarray, " action"],
        reward: float,
        next_observation: Float[np.ndarray, " observation"],
        terminated: bool,
        truncated: bool,
    ) -> None:
        """Add a transition; the fields are those of `Transitions`.

        Raises:
            LogError: the file cannot be written; the message says how many transitions are safe.
        """
        self._write_pending()
        self._transition.fill(episode, step, observation, action, reward, next_observation, terminated, truncated)
        self._pending = True
        self.count += 1
        self._episode_length += 1
        self._episode_return += float(self._transition.reward[0])

    def end_episode(self, seed: int | None, *, cut: bool) -> None:
        """End the episode of the last transition; does nothing if none was added since the last end.

        Args:
            seed: the seed of the episode, if known.
            cut: the episode goes on, but its recording does not: its last transition is marked truncated.

        Raises:
            LogError: as in `append`.
        """
        if not self._pending:
            return
        slots = self._transition
        if cut or not (slots.terminated[0] or slots.truncated[0]):
            ended: Ended = "cut"
            slots.truncated[0] = True
        else:
            ended = "terminated" if slots.terminated[0] else "truncated"
        self._write_pending()
        row = self._episode_layout.blank()
        row["episode"] = slots.episode[0]
        row["seed"] = UNKNOWN_SEED if seed is None else seed
        row["return"] = self._episode_return
        row["length"] = self._episode_length
        row["ended"] = ENDED.index(ended)
        self._episode_length, self._episode_return = 0, 0.0
        self._write_message(EPISODE_CHANNEL, row, self._time_ns(self.count) - 1)
        self._do(self._mcap.flush)
        self.safe_count = self.count

    def close(self) -> None:
        """Complete the file and give it its name; an episode that has not ended is cut. Does nothing the second time.

        Raises:
            LogError: as in `append`.
        """
        if self._file.closed:
            return
        self.end_episode(None, cut=True)
        self._do(self._finish)

    def abandon(self) -> None:
        """Stop writing and leave the unfinished file for `recover_log`."""
        try:
            self._file.close()
        except OSError:
            # Closing flushes what is left; on a full disk that fails again, and the file is closed all the same.
            self._file.raw.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:
            self.abandon()

    def _begin(self, record: RunRecord, transition: bytes, episode: bytes) -> None:
        metadata = record.to_metadata()
        self._mcap.start(profile="", library=f"addressed-dynamics {version('addressed-dynamics')}")
        self._mcap.add_metadata(RUN_RECORD, metadata)
        schema = self._mcap.register_schema(TRANSITION_SCHEMA, SchemaEncoding.Protobuf, transition)
        # This copy of the run record gets into a chunk and into the summary, which MCAP protects by checksums.
        self._mcap.register_channel(f"{record.topic}/transition", MessageEncoding.Protobuf, schema, metadata)
        schema = self._mcap.register_schema(EPISODE_SCHEMA, SchemaEncoding.Protobuf, episode)
        self._mcap.register_channel("/episode", MessageEncoding.Protobuf, schema)
        self._mcap.flush()

    def _finish(self) -> None:
        self._mcap.finish()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
        self.partial.replace(self.path)

    def _write_pending(self) -> None:
        # The last transition waits here, because the end of its episode may still mark it as truncated.
        if self._pending:
            self._pending = False
            self._write_message(TRANSITION_CHANNEL, self._transition.row, self._time_ns(self.count - 1))

    def _write_message(self, channel: int, row: Rows, time_ns: int) -> None:
        sequence = (self.count - 1) & 0xFFFFFFFF
        self._do(self._mcap.add_message, channel, time_ns, row.tobytes(), time_ns, sequence)

    def _do(self, write: Callable[..., Any], *arguments: Any) -> None:
        if self._file.closed:
            message = f"{self.path}: the log is closed, so nothing can be added to it; record to a new one"
            raise LogError(message)
        try:
            write(*arguments)
        except OSError as error:
            raise self._failed(error) from error
        except BaseException:
            # Ctrl-C inside a record leaves half of it in the chunk: the file must not be completed with that.
            self.abandon()
            raise

    def _time_ns(self, steps: int) -> int:
        return round((self._first_step + steps) * self._step_ns)

    def _failed(self, error: OSError) -> LogError:
        self.abandon()
        message = (
            f"{self.partial}: the log cannot be written ({error.strerror}); {self.safe_count} transitions are safe in "
            f"it: make room, then 'addressed-dynamics recover {self.partial}' writes them to a new file"
        )
        return LogError(message)


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


class _Slots:
    """One transition being written, with a view of each of its fields."""

    def __init__(self, layout: MessageLayout, spec: SpaceSpec) -> None:
        self.layout = layout
        self.row = layout.blank()
        self.episode = layout.scalar(self.row, "episode")
        self.step = layout.scalar(self.row, "step")
        self.reward = layout.scalar(self.row, "reward")
        self.terminated = layout.scalar(self.row, "terminated")
        self.truncated = layout.scalar(self.row, "truncated")
        self._observation = self._vector("observation")
        self._next_observation = self._vector("next_observation")
        discrete = isinstance(spec.action, DiscreteAction)
        self._action_number = layout.scalar(self.row, "action") if discrete else None
        self._action = [] if discrete else self._vector("action")

    def fill(
        self,
        episode: int,
        step: int,
        observation: Float[np.ndarray, " observation"],
        action: int | Float[np.ndarray, " action"],
        reward: float,
        next_observation: Float[np.ndarray, " observation"],
        terminated: bool,
        truncated: bool,
    ) -> None:
        self.episode[0] = episode
        self.step[0] = step
        self.reward[0] = reward
        self.terminated[0] = terminated
        self.truncated[0] = truncated
        for view, part in self._observation:
            view[...] = observation[part]
        for view, part in self._next_observation:
            view[...] = next_observation[part]
        if self._action_number is not None:
            self._action_number[0] = action
        else:
            components = np.asarray(action)
            for view, part in self._action:
                view[...] = components[part]

    def _vector(self, field: str) -> list[tuple[Shaped[np.ndarray, " part"], slice]]:
        views, start = [], 0
        for (view,) in self.layout.vector_parts(self.row, field):
            views.append((view, slice(start, start + len(view))))
            start += len(view)
        return views
