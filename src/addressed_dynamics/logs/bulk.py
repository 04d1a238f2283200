"""Write arrays of transitions to an MCAP log, whole chunks at a time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.logs.contents import RunInfo
from addressed_dynamics.logs.log_file import (
    CHUNK_BYTES,
    EPISODE_CHANNEL,
    TRANSITION_CHANNEL,
    LogFile,
    TransitionRows,
    ended_as,
    episode_messages,
    index_entries,
    message_bytes,
)

UNKNOWN = RunInfo(environment="unknown")
"""What is said of data whose origin nobody names."""

ADDED_AT_ONCE = 2**16
"""Rewards of an episode that are added up at once; the sums of so many are added one after the other."""


def write_log(
    path: Path | str,
    transitions: Transitions | Iterable[Transitions],
    *,
    run: RunInfo = UNKNOWN,
    topic: str = "/env_00",
    seeds: Sequence[int | None] | None = None,
) -> None:
    """Write a log: the same messages as `TransitionLogWriter` writes, in fewer and larger chunks.

    Args:
        path: the log; it appears when it is complete.
        transitions: one block or several of the same spaces, one after the other. A block may begin with the next steps
            of the last episode of the block before; how they are cut makes no difference to the log. Memory is needed
            for one block and one chunk at a time. Log times are those of the transitions and must increase. The last
            step of an episode is marked truncated if it has no other end.
        run: where the data comes from.
        topic: transitions go to the topic `<topic>/transition`, episodes to `/episode`.
        seeds: the seed of each episode, if known.

    Raises:
        SpaceError: a dimension has a name that a log cannot hold.
        LogError: there is no block, the blocks do not fit together, times do not increase, or the file cannot be
            written.
        TransitionsError: an episode goes on in the next block, but not with its next step.
    """
    path = Path(path)
    blocks = iter([transitions] if isinstance(transitions, Transitions) else transitions)
    first = next(blocks, None)
    if first is None:
        message = f"{path}: there is nothing to write, not even a description of spaces; give at least one block"
        raise LogError(message)
    file = LogFile(path, first.spec, topic=topic, run=run, is_kept=False)
    try:
        writer = _BulkWriter(file, seeds or ())
        for block in chain([first], blocks):
            writer.write(block)
        writer.write_rest()
        file.finish()
    except BaseException:
        file.abandon()
        file.partial.unlink()
        raise


@dataclass(frozen=True)
class _EpisodeEnds:
    """The records of the episodes that end in a block."""

    rows: Int64[np.ndarray, " episode"]
    """Row after the last one of each episode."""
    messages: UInt8[np.ndarray, "episode byte"]
    time_ns: Int64[np.ndarray, " episode"]


@dataclass(frozen=True)
class _Return:
    """The sum of an episode's rewards so far, to the bit the same in whatever parts they come."""

    steps: int = 0
    added: float = 0.0
    """The sum of all that do not wait."""
    waiting: Float32[np.ndarray, " step"] = field(default_factory=lambda: np.zeros(0, np.float32))
    """The latest ones, which are fewer than are added up at once."""

    def plus(self, rewards: Float32[np.ndarray, " step"]) -> _Return:
        """Return the sum after further steps."""
        waiting = np.concatenate([self.waiting, rewards])
        whole = len(waiting) // ADDED_AT_ONCE * ADDED_AT_ONCE
        added = self.added
        for start in range(0, whole, ADDED_AT_ONCE):
            added += _sum(waiting[start : start + ADDED_AT_ONCE])
        return _Return(self.steps + len(rewards), added, waiting[whole:])

    @property
    def value(self) -> float:
        """The sum."""
        return self.added + _sum(self.waiting) if len(self.waiting) else self.added


def _sum(rewards: Float32[np.ndarray, " step"]) -> float:
    return float(np.add.reduceat(rewards, [0], dtype=np.float64)[0])


class _BulkWriter:
    def __init__(self, file: LogFile, seeds: Sequence[int | None]) -> None:
        self._file = file
        self._seeds = seeds
        self._begin = len(file.container.description)
        self._row_bytes = message_bytes(file.transition_layout)
        self._end_bytes = message_bytes(file.episode_layout)
        self._count, self._last_time = 0, -1
        self._ended = 0
        """Episodes whose records are written."""
        self._rest: Transitions | None = None
        """Rows that wait for those after them, because they do not fill a chunk; the last row is always one of them."""
        self._return = _Return()
        """That of the written steps of the episode that has not ended."""

    def write(self, block: Transitions) -> None:
        """Write all chunks that no later row can change."""
        self._check(block)
        if self._rest is not None:
            block = Transitions.concatenate([self._rest, block])
        self._write(block, last=False)

    def write_rest(self) -> None:
        """Write what waits; the last episode ends with it."""
        if self._rest is not None:
            self._write(self._rest, last=True)

    def _write(self, block: Transitions, *, last: bool) -> None:
        ends = self._ends(block, last=last)
        # Where each row stands in the stream of messages, in which the record of an episode follows its last row.
        row = np.arange(len(block) + 1)
        place = row * self._row_bytes + np.searchsorted(ends.rows, row, side="right") * self._end_bytes
        start = 0
        room = CHUNK_BYTES - self._begin
        while start < len(block):
            stop = max(int(np.searchsorted(place, place[start] + room, side="right")) - 1, start + 1)
            if stop == len(block) and not last:
                break
            self._file.do(self._write_chunk, block, ends, start, stop)
            self._count += stop - start
            self._file.safe_count = self._count
            start = stop
        ended = int(np.searchsorted(ends.rows, start, side="right"))
        begun = _Return() if ended else self._return
        self._return = begun.plus(block.reward[ends.rows[ended - 1] if ended else 0 : start])
        self._ended += ended
        self._rest = block.select(slice(start, None))

    def _check(self, block: Transitions) -> None:
        if block.spec != self._file.spec:
            message = f"{self._file.path}: a block has other spaces than the first; keep one environment per log"
            raise LogError(message)
        times = np.concatenate([[self._last_time], block.time_ns])
        backwards = np.flatnonzero(np.diff(times) <= 0)
        if len(backwards):
            row = int(backwards[0])
            number = self._count + (0 if self._rest is None else len(self._rest)) + row
            message = (
                f"{self._file.path}: the time of transition {number} is {times[row + 1]} ns, which is not "
                f"after that of the one before it ({times[row]} ns); sort them, or write them to different logs"
            )
            raise LogError(message)
        self._last_time = int(times[-1])

    def _ends(self, block: Transitions, *, last: bool) -> _EpisodeEnds:
        """Return the records of the episodes of a block; whether the last one ends is known only if nothing follows."""
        slices = list(block.episode_slices())[: None if last else -1]
        stop = np.array([rows.stop for rows in slices], np.int64)
        final = stop - 1
        step_ns = max(round(block.spec.step_seconds * 1e9), 1)
        # Before the next transition, wherever that is: times in a log never repeat.
        following = np.append(block.time_ns, np.iinfo(np.int64).max)[stop]
        time_ns = np.minimum(block.time_ns[final] + step_ns, following) - 1
        length, returns = self._returns(block, stop)
        flags = zip(block.terminated[final], block.truncated[final], strict=True)
        messages = episode_messages(
            self._file.episode_layout,
            episode=block.episode[final],
            seed=[self._seed(self._ended + number) for number in range(len(slices))],
            episode_return=returns,
            length=length,
            ended=[ended_as(*each) for each in flags],
            sequence=self._count + final,
            time_ns=time_ns,
        )
        return _EpisodeEnds(stop, messages, time_ns)

    def _returns(
        self, block: Transitions, stop: Int64[np.ndarray, " episode"]
    ) -> tuple[Int64[np.ndarray, " episode"], Float64[np.ndarray, " episode"]]:
        """Return the steps of the episodes that end at these rows, and the sums of their rewards."""
        if not len(stop):
            return stop, np.zeros(0)
        start = np.append(0, stop[:-1])
        length, returns = stop - start, np.add.reduceat(block.reward[: stop[-1]], start, dtype=np.float64)
        for episode in np.flatnonzero(length > ADDED_AT_ONCE):
            returns[episode] = _Return().plus(block.reward[start[episode] : stop[episode]]).value
        # The first episode may have begun before the block.
        first = self._return.plus(block.reward[: stop[0]])
        length[0], returns[0] = first.steps, first.value
        return length, returns

    def _seed(self, episode: int) -> int | None:
        return self._seeds[episode] if episode < len(self._seeds) else None

    def _write_chunk(self, block: Transitions, ends: _EpisodeEnds, start: int, stop: int) -> None:
        rows = self._encode(block, ends, start, stop)
        first, last = np.searchsorted(ends.rows, [start, stop], side="right").tolist()
        inside = (ends.rows[first:last] - start).tolist()
        pieces = [self._file.container.description]
        for begin, end, message in zip([0, *inside], inside, ends.messages[first:last], strict=False):
            pieces += [rows.messages[begin:end].reshape(-1), message]
        pieces.append(rows.messages[inside[-1] if inside else 0 :].reshape(-1))
        row = np.arange(stop - start)
        offset = self._begin + row * self._row_bytes
        offset += np.searchsorted(inside, row, side="right") * self._end_bytes
        index = {TRANSITION_CHANNEL: index_entries(block.time_ns[start:stop], offset)}
        if inside:
            places = self._begin + np.array(inside) * self._row_bytes + np.arange(len(inside)) * self._end_bytes
            index[EPISODE_CHANNEL] = index_entries(ends.time_ns[first:last], places)
        latest = ends.time_ns[last - 1] if inside and inside[-1] == stop - start else block.time_ns[stop - 1]
        self._file.container.write_chunk(
            np.concatenate(pieces), index, start_time=int(block.time_ns[start]), end_time=int(latest)
        )

    def _encode(self, block: Transitions, ends: _EpisodeEnds, start: int, stop: int) -> TransitionRows:
        part, count = slice(start, stop), stop - start
        messages = np.empty((count, self._row_bytes), np.uint8)
        rows = TransitionRows(self._file.transition_layout, block.spec, messages)
        rows.stamp(self._count + np.arange(count), block.time_ns[part])
        rows.episode[:], rows.step[:] = block.episode[part], block.step[part]
        rows.reward[:] = block.reward[part]
        rows.terminated[:], rows.truncated[:] = block.terminated[part], block.truncated[part]
        last = ends.rows[(ends.rows > start) & (ends.rows <= stop)] - start - 1
        rows.truncated[last] |= ~block.terminated[part][last]
        for views, values in (
            (rows.observation, block.observation),
            (rows.next_observation, block.next_observation),
            (rows.action, block.action),
            (rows.exogenous, block.exogenous),
        ):
            for view, components in views:
                view[:] = values[part][components]
        return rows
