"""What is driven as a log, in the layout of all logs."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from addressed_dynamics.base.errors import DriveError, LogError
from addressed_dynamics.envs import LEARNED
from addressed_dynamics.episodes.transitions import SpaceSpec
from addressed_dynamics.logs import RunInfo, TransitionLogWriter
from addressed_dynamics.simulators.delivery import Origin

BEHAVIOUR = "driven"
"""Who acted: a person."""
_LIBRARIES = ("addressed-dynamics", "gymnasium", "numpy", "torch")


def imagined_by_hand(folder: Path, origin: Origin | None, mode: str) -> RunInfo:
    """Return what a log says of itself of a drive through what a model predicts.

    Args:
        folder: where its models are.
        origin: which of them it is; None if its own folder was named.
        mode: how the outputs of its networks are used.
    """
    return driven_by_hand(LEARNED, {"model": str(folder), "which": str(origin or ""), "mode": mode})


def driven_by_hand(environment: str, kwargs: dict[str, object]) -> RunInfo:
    """Return what a log of a drive that begins now says of itself.

    Args:
        environment: Gymnasium identifier of what was driven.
        kwargs: how it was made; JSON-compatible.
    """
    return RunInfo(
        environment=environment,
        kwargs=kwargs,
        segment=BEHAVIOUR,
        behaviour=BEHAVIOUR,
        versions={name: version(name) for name in _LIBRARIES},
        started=datetime.now(UTC).isoformat(timespec="microseconds"),
    )


class Recorded(NamedTuple):
    """A transition to record."""

    step: int
    before: Float32[np.ndarray, " observation"]
    action: int | list[float]
    reward: float
    after: Float32[np.ndarray, " observation"]
    terminated: bool = False
    truncated: bool = False
    exogenous: Sequence[float] = ()


class DriveRecorder:
    """Records one world, from when a person says so until they say stop; each time into a new file."""

    def __init__(self, folder: Path, spaces: SpaceSpec) -> None:
        """Prepare to record.

        Args:
            folder: where logs go; it is made with the first.
            spaces: what the numbers mean.
        """
        self._folder = folder
        self._spaces = spaces
        self._writer: TransitionLogWriter | None = None
        self._run: RunInfo | None = None
        self._episode = 0
        self._in_episode = False
        self._seed: int | None = None

    @property
    def recording(self) -> bool:
        """Whether it records."""
        return self._run is not None

    @property
    def count(self) -> int:
        """Transitions in the open log."""
        return self._writer.count if self._writer else 0

    @property
    def path(self) -> Path | None:
        """The open log; None before its first transition."""
        return self._writer.path if self._writer else None

    def start(self, run: RunInfo) -> None:
        """Record from the next transition on.

        Raises:
            DriveError: it records already.
        """
        if self.recording:
            message = "this drive is recorded already; stop that first"
            raise DriveError(message)
        self._run = run
        self._episode, self._in_episode = 0, False

    def add(self, each: Recorded) -> None:
        """Record a transition; does nothing while it is not to record.

        Raises:
            DriveError: the log cannot be written, or a number is not finite; nothing more is recorded.
        """
        if self._run is None:
            return
        try:
            if not np.isfinite([*each.before, *each.after, each.reward]).all():
                message = "a number in this step is not finite, and a log takes only numbers"
                raise LogError(message)
            if self._writer is None:
                self._folder.mkdir(parents=True, exist_ok=True)
                self._writer = TransitionLogWriter(_unused(self._folder, self._run), self._spaces, run=self._run)
            self._writer.append(
                self._episode, each.step, each.before.tolist(), each.action, each.reward, each.after.tolist(),
                each.terminated, each.truncated, list(each.exogenous),
            )  # fmt: skip
            self._in_episode = True
            if each.terminated or each.truncated:
                self._end(cut=False)
        except (LogError, OSError) as error:
            raise self._failed(error) from error

    def begin_episode(self, seed: int | None) -> None:
        """Let the next transition begin an episode; one that was not over is cut.

        Args:
            seed: what the world was reset with, if there is such a thing.

        Raises:
            DriveError: the log cannot be written.
        """
        try:
            self._end(cut=True)
        except LogError as error:
            raise self._failed(error) from error
        self._seed = seed

    def stop(self) -> tuple[Path, int] | None:
        """Complete the log.

        Returns:
            It, and how many transitions it has; None if there were none, and so there is no log.

        Raises:
            DriveError: the log cannot be written.
        """
        writer = self._writer
        if writer is None:
            self._run = None
            return None
        try:
            self._end(cut=True)
            writer.close()
        except LogError as error:
            raise self._failed(error) from error
        self._writer = self._run = None
        return writer.path, writer.count

    def _end(self, *, cut: bool) -> None:
        """End the episode of the last transition; does nothing if none was recorded since an end."""
        if self._writer is None or not self._in_episode:
            return
        self._writer.end_episode(self._seed, cut=cut)
        self._episode += 1
        self._in_episode = False

    def _failed(self, error: Exception) -> DriveError:
        """Give the recording up, and return what to say of it; what is intact stays."""
        writer, self._writer, self._run = self._writer, None, None
        where = ""
        if writer is not None:
            writer.abandon()
            where = f"; 'addressed-dynamics recover {writer.partial}' saves {writer.safe_count} transitions"
        return DriveError(f"recording ended: {error}{where}")


def _unused(folder: Path, run: RunInfo) -> Path:
    """Return a name for a new log by the time at which it begins, one that no other log has or had."""
    stem = f"drive-{datetime.fromisoformat(run.started):%Y%m%d-%H%M%S}"
    names = (stem, *(f"{stem}-{number}" for number in range(2, 10_000)))
    for name in names:
        path = folder / f"{name}.mcap"
        if not path.exists() and not path.with_name(f"{path.name}.partial").exists():
            return path
    message = f"{folder}: no name is left for a recording; name another folder with --record-to"
    raise LogError(message)
