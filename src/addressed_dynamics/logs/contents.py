"""What a log holds beside its transitions: one record per episode, and one that says where the log comes from."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from addressed_dynamics.episodes.transitions import SpaceSpec, Transitions

FORMAT_VERSION = "1"
"""Version of the layout of logs; a log of another version is refused."""

Ended = Literal["cut", "terminated", "truncated"]
"""How an episode ended; `cut`: the recording stopped or the environment was reset before its end."""


@dataclass(frozen=True, slots=True)
class EpisodeRecord:
    """One episode of a log; with slots, because there may be a million."""

    episode: int
    """Identifier of the episode, as in `Transitions.episode`."""
    seed: int | None
    """Seed that the environment was reset with, if one was given."""
    episode_return: float
    """Sum of the recorded rewards."""
    length: int
    """Number of recorded transitions."""
    ended: Ended
    """How it ended."""
    end_time_ns: int
    """Simulated time of the end of its last step, in nanoseconds (less one, so that times in a log never repeat)."""


@dataclass(frozen=True)
class RunInfo:
    """Where a log comes from. Everything in it is for people; nothing is needed to read the transitions."""

    environment: str
    """Gymnasium identifier, for instance `MountainCar-v0`."""
    kwargs: Mapping[str, Any] = field(default_factory=dict)
    """Keyword arguments that the environment was made with; JSON-compatible."""
    segment: str = ""
    """Segment of the recording plan, if there is a plan."""
    behaviour: str = ""
    """Who acted, for instance `dqn`."""
    seed: int | None = None
    """Seed of the recording."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Versions of the libraries that made the data, by name."""
    git_commit: str = ""
    """Commit of the code that made the data."""
    started: str = ""
    """Wall clock at the start of the recording, ISO 8601."""


@dataclass(frozen=True)
class LogContents:
    """Everything in a log."""

    transitions: Transitions
    """All transitions, in the order of recording."""
    episodes: tuple[EpisodeRecord, ...]
    """One record for each episode, in the same order."""
    run: RunInfo
    """Where the log comes from."""
    recording: str
    """The same text for all logs of one recording, and for those of recordings that say the same of themselves."""


@dataclass(frozen=True)
class RunRecord:
    """The `run` record of a file: the public `RunInfo`, and what it takes to decode the messages."""

    info: RunInfo
    spec: SpaceSpec
    topic: str
    """Prefix of the transition topic, for instance `/env_00`."""

    @property
    def recording(self) -> str:
        """What tells a recording from others: all that is known of it, the moment of its start included."""
        return json.dumps(self.to_metadata())

    def to_metadata(self) -> dict[str, str]:
        """Return the record as the text values of an MCAP metadata record, with a checksum: MCAP has none for it."""
        values = {
            "format": FORMAT_VERSION,
            "topic": self.topic,
            "spec": json.dumps(self.spec.to_json()),
            "environment": self.info.environment,
            "kwargs": json.dumps(dict(self.info.kwargs), default=str),
            "segment": self.info.segment,
            "behaviour": self.info.behaviour,
            "seed": json.dumps(self.info.seed),
            "versions": json.dumps(dict(self.info.versions)),
            "git_commit": self.info.git_commit,
            "started": self.info.started,
        }
        return {**values, "crc32": _checksum(values)}

    @staticmethod
    def from_metadata(values: Mapping[str, str]) -> RunRecord:
        """Read what `to_metadata` wrote.

        Raises:
            ValueError: the record is incomplete, of another version, or does not match its checksum.
            TransitionsError: its description of spaces is malformed.
        """
        values = dict(values)
        if values.get("format", FORMAT_VERSION) != FORMAT_VERSION:
            message = f"its run record is of format {values['format']}, but this version reads format {FORMAT_VERSION}"
            raise ValueError(message)
        if values.pop("crc32", "") != _checksum(values):
            message = "its run record fails its checksum"
            raise ValueError(message)
        try:
            info = RunInfo(
                environment=values["environment"],
                kwargs=json.loads(values["kwargs"]),
                segment=values["segment"],
                behaviour=values["behaviour"],
                seed=json.loads(values["seed"]),
                versions=json.loads(values["versions"]),
                git_commit=values["git_commit"],
                started=values["started"],
            )
            return RunRecord(info=info, spec=SpaceSpec.from_json(json.loads(values["spec"])), topic=values["topic"])
        except KeyError as error:
            message = f"its run record lacks {error}"
            raise ValueError(message) from error


def _checksum(values: Mapping[str, str]) -> str:
    return f"{zlib.crc32(json.dumps(values, sort_keys=True).encode()):08x}"
