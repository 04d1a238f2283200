"""Write transitions one by one to an MCAP log that survives a crash."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from jaxtyping import UInt8

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.episodes.transitions import SpaceSpec
from addressed_dynamics.logs.contents import RunInfo
from addressed_dynamics.logs.log_file import (
    CHUNK_BYTES,
    EPISODE_CHANNEL,
    TRANSITION_CHANNEL,
    LogFile,
    TransitionRows,
    Vector,
    ended_as,
    episode_messages,
    index_entries,
    message_bytes,
    transition_packer,
)

_NOTHING: list[float] = []
"""The exogenous inputs of a step in a world without any."""


class TransitionLogWriter:
    """Writes one log: `path` with `.partial` appended, renamed to `path` when it is complete.

    A transition is packed straight into the open chunk. The end of an episode closes the chunk and hands it to the
    operating system, so that a process that is killed loses at most the episode it was in; `recover_log` makes a log of
    what is left. Log times are simulated: the number of transitions so far times the length of a step.

    Args:
        path: the log; an existing one is replaced, but only by a complete one.
        spec: names, units and bounds of observations, actions and exogenous inputs, and the length of a step.
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
        self._file = LogFile(path, spec, topic=topic, run=run)
        self.partial = self._file.partial
        self._chunked = 0
        """Transitions in the chunks before the open one."""
        self._first_step = first_step
        self._step_ns = spec.step_seconds * 1e9
        self._exogenous = len(spec.exogenous)
        self._episode_start, self._episode_return = 0, 0.0
        self._begin = len(self._file.container.description)
        self._message_bytes = message_bytes(self._file.transition_layout)
        room = CHUNK_BYTES - self._begin - message_bytes(self._file.episode_layout)
        capacity = max(room // self._message_bytes, 1)
        end = self._begin + capacity * self._message_bytes
        self._chunk = np.empty(end, np.uint8)
        self._chunk[: self._begin] = self._file.container.description
        messages = self._chunk[self._begin : end].reshape(capacity, self._message_bytes)
        self._numbers = np.arange(capacity)
        self._places = self._begin + self._numbers * self._message_bytes
        self._rows = TransitionRows(self._file.transition_layout, spec, messages)
        self._pack = transition_packer(self._file.transition_layout, spec, self._chunk)
        self._offset = self._begin
        """Where in the open chunk the next transition goes."""
        self._end = end
        """Where the open chunk is full; nowhere in it when the log is closed."""

    @property
    def count(self) -> int:
        """Transitions appended so far."""
        return self._chunked + self._filled

    @property
    def _filled(self) -> int:
        return (self._offset - self._begin) // self._message_bytes

    @property
    def safe_count(self) -> int:
        """Transitions that survive if the process is killed now."""
        return self._file.safe_count

    def append(
        self,
        episode: int,
        step: int,
        observation: Vector,
        action: int | Vector,
        reward: float,
        next_observation: Vector,
        terminated: bool,
        truncated: bool,
        exogenous: Vector = _NOTHING,
    ) -> None:
        """Add a transition; the fields are those of `Transitions`.

        Raises:
            LogError: the file cannot be written; the message says how many transitions are safe. Or there are more or
                fewer exogenous inputs than the spaces have.
        """
        if len(exogenous) != self._exogenous:
            message = (
                f"{self.path}: a transition has {len(exogenous)} exogenous inputs, but the spaces of the log have "
                f"{self._exogenous}; give one number for each of them"
            )
            raise LogError(message)
        if self._offset >= self._end:
            self._do(self._write_chunk)
        offset = self._offset
        self._pack(
            offset, episode, step, observation, action, reward, next_observation, terminated, truncated, exogenous
        )
        # Counted only when it is whole: Ctrl-C above leaves no trace.
        self._offset = offset + self._message_bytes

    def end_episode(self, seed: int | None, *, cut: bool) -> None:
        """End the episode of the last transition; does nothing if none was added since the last end.

        Args:
            seed: the seed of the episode, if known.
            cut: the episode goes on, but its recording does not: its last transition is marked truncated.

        Raises:
            LogError: as in `append`.
        """
        if not self._filled:
            return
        rows, filled = self._rows, self._filled
        last = filled - 1
        ended = "cut" if cut else ended_as(rows.terminated[last], rows.truncated[last])
        if ended == "cut":
            rows.truncated[last] = True
        messages = episode_messages(
            self._file.episode_layout,
            episode=rows.episode[last],
            seed=[seed],
            episode_return=self._episode_return + rows.reward[:filled].sum(dtype=np.float64),
            length=self.count - self._episode_start,
            ended=[ended],
            sequence=self.count - 1,
            time_ns=self._time_ns(self.count) - 1,
        )
        self._do(self._write_chunk, messages[0])
        self._do(self._file.container.flush)
        self._file.safe_count = self._episode_start = self.count
        self._episode_return = 0.0

    def close(self) -> None:
        """Complete the file and give it its name; an episode that has not ended is cut. Does nothing the second time.

        Raises:
            LogError: as in `append`.
        """
        if self._file.closed:
            return
        self.end_episode(None, cut=True)
        self._end = 0
        self._file.finish()

    def abandon(self) -> None:
        """Stop writing and leave the unfinished file for `recover_log`."""
        self._end = 0
        self._file.abandon()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is None:
            self.close()
        else:
            self.abandon()

    def _do(self, write: Callable[..., None], *arguments: Any) -> None:
        try:
            self._file.do(write, *arguments)
        except BaseException:
            self._end = 0
            raise

    def _write_chunk(self, episode_end: UInt8[np.ndarray, " byte"] | None = None) -> None:
        """Write the transitions since the last chunk, and the record of their episode if it has ended."""
        count, first = self._filled, self._chunked
        time_ns = np.rint((self._first_step + first + self._numbers[:count]) * self._step_ns).astype(np.int64)
        end_time = int(time_ns[-1])
        self._rows.stamp(first + self._numbers[:count], time_ns)
        self._episode_return += float(self._rows.reward[:count].sum(dtype=np.float64))
        index = {TRANSITION_CHANNEL: index_entries(time_ns, self._places[:count])}
        payload = self._chunk[: self._offset]
        if episode_end is not None:
            end_time = self._time_ns(self.count) - 1
            index[EPISODE_CHANNEL] = index_entries([end_time], [self._offset])
            payload = np.concatenate([payload, episode_end])
        self._file.container.write_chunk(payload, index, start_time=int(time_ns[0]), end_time=end_time)
        self._chunked += count
        self._offset = self._begin

    def _time_ns(self, steps: int) -> int:
        return round((self._first_step + steps) * self._step_ns)
