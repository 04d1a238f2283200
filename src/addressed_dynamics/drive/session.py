"""A drive by one page: what it says goes in, frames come out. Nothing here knows of sockets or clocks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from addressed_dynamics.base.errors import DriveError
from addressed_dynamics.drive.protocol import AnyMessage, Plain, Speed, read_message
from addressed_dynamics.drive.recorder import DriveRecorder, Recorded
from addressed_dynamics.logs import RunInfo

FASTEST = 60.0
"""Most steps in a second."""
SLOWEST = 0.5
"""Fewest; who wants fewer pauses and steps."""

Said = dict[str, Any]
"""A message to the page."""
NO_RECORDING: Said = {"type": "recording", "on": False}
"""What a page is told when a recording has ended because it failed."""


class Session(ABC):
    """One world that one page drives."""

    step_seconds: float
    """Simulated time of a step."""

    def __init__(self, recorder: DriveRecorder) -> None:
        """Begin a drive that is not paused, at the speed at which it would happen, or as near to that as one can look.

        Args:
            recorder: what may record it.
        """
        self.recorder = recorder
        self.paused = False
        self._notices = list[Said]()
        self.rate = min(FASTEST, max(SLOWEST, 1.0 / self.step_seconds))
        """Steps in a second."""

    @abstractmethod
    def hello(self) -> Said:
        """Return what the page has to know before the first frame."""

    @abstractmethod
    def reset(self) -> Said:
        """Start anew and return the first frame."""

    @abstractmethod
    def step(self) -> Said:
        """Make a step and return what there is to see after it."""

    @abstractmethod
    def take(self, message: AnyMessage) -> Said | None:
        """Do what only this kind of world understands; return what there is to say to that.

        Raises:
            DriveError: it cannot be done.
        """

    @abstractmethod
    def run_info(self) -> RunInfo:
        """Return what a recording that begins now says of itself."""

    def record(self, each: Recorded) -> None:
        """Record a transition if it is to be; if that fails, the page is told and the drive goes on."""
        self._try_to_record(lambda recorder: recorder.add(each))

    def begin_episode(self, seed: int | None) -> None:
        """Let a recording know that the next transition does not follow the last."""
        self._try_to_record(lambda recorder: recorder.begin_episode(seed))

    def _try_to_record(self, do: Callable[[DriveRecorder], None]) -> None:
        try:
            do(self.recorder)
        except DriveError as error:
            self._notices += [refused(error), NO_RECORDING]

    def tick(self) -> list[Said]:
        """Make a step, and return what there is to tell of it."""
        frame = self.step()
        return [*self._told(), frame]

    def _told(self) -> list[Said]:
        told, self._notices = self._notices, []
        return told

    def close(self) -> Path | None:
        """End the drive; return the log that was open, which is complete."""
        done = self.recorder.stop()
        return done[0] if done else None

    def hear(self, text: str) -> list[Said]:
        """Do what the page says, and return what to answer: a refusal is one line, and the drive goes on."""
        try:
            answers = [each for each in self._hear(read_message(text)) if each is not None]
            return [*self._told(), *answers]
        except DriveError as error:
            return [refused(error)]

    def _hear(self, message: AnyMessage) -> Iterable[Said | None]:
        match message:
            case Speed(rate=rate):
                self.rate = min(FASTEST, max(SLOWEST, rate))
                return [self._status()]
            case Plain(type="pause" | "resume" as told):
                self.paused = told == "pause"
                return [self._status()]
            case Plain(type="step"):
                self.paused = True
                return [self._status(), self.step()]
            case Plain(type="reset"):
                return [self.reset()]
            case Plain(type="record"):
                self.recorder.start(self.run_info())
                return [{"type": "recording", "on": True}]
            case Plain(type="stop"):
                return self._stop_recording()
            case _:
                return [self.take(message)]

    def _stop_recording(self) -> list[Said]:
        try:
            return [recorded(self.recorder.stop())]
        except DriveError as error:
            return [refused(error), NO_RECORDING]

    def _status(self) -> Said:
        return {"type": "status", "paused": self.paused, "rate": self.rate}


def refused(error: DriveError) -> Said:
    """Return what a page is told that asked for what cannot be done."""
    return {"type": "refused", "message": str(error)}


def recorded(done: tuple[Path, int] | None) -> Said:
    """Return what a page is told when a recording has ended."""
    if done is None:
        return {"type": "recording", "on": False, "path": None, "count": 0}
    return {"type": "recording", "on": False, "path": str(done[0]), "count": done[1]}


def plain(values: Iterable[float] | np.ndarray, digits: int = 7) -> list[float | None]:
    """Return numbers as JSON has them, none of those that it has not, rounded to what single precision tells."""
    return [float(f"{each:.{digits}g}") if np.isfinite(each) else None for each in np.asarray(values).tolist()]
