"""What is in MCAP files, ours or anyone's: the container, its topics, and what a log of transitions has to learn from.

A damaged file is shown as far as it is intact, with the first problem. One file is in memory at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from addressed_dynamics.base.errors import LogError, TransitionsError
from addressed_dynamics.episodes.experience import Experience
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.importing.finding import SUFFIXES
from addressed_dynamics.logs import RunInfo, read_log
from addressed_dynamics.logs.container import Damage
from addressed_dynamics.logs.decoding import episode_records, run_record, transition_columns
from addressed_dynamics.logs.reader import open_source
from addressed_dynamics.logs.schema import EPISODE_SCHEMA, TRANSITION_SCHEMA
from addressed_dynamics.logs.survey import Problem, Survey, survey


@dataclass(frozen=True)
class Topic:
    """One topic of a file."""

    name: str
    schema: str
    """Name of the message's schema; empty if it has none."""
    encoding: str
    """How messages are encoded, for instance `protobuf`."""
    messages: int
    """Number of messages found."""
    rate_hz: float | None
    """Messages per second between the first and the last; None with fewer than two times."""
    longest_gap_seconds: float | None
    """Longest time without a message between the first and the last."""


@dataclass(frozen=True)
class FileInspection:
    """What is in one file."""

    path: Path
    size: int
    """Bytes."""
    library: str = ""
    """Who wrote the file, in its own words."""
    profile: str = ""
    """What it says about its topics, for instance `ros2`."""
    compression: Mapping[str, int] = field(default_factory=dict)
    """Number of chunks by their compression; those without any are `none`."""
    start_ns: int | None = None
    """Time of the first message, in nanoseconds; None without messages."""
    end_ns: int | None = None
    """Time of the last message, in nanoseconds."""
    topics: tuple[Topic, ...] = ()
    """Topics in the order of their names."""
    run: RunInfo | None = None
    """Where a log of transitions comes from; None for other files."""
    experience: Experience | None = None
    """What there is to learn from in a log of transitions; None for other files."""
    problem: Problem | None = None
    """The first thing that is wrong; all other figures are about what comes before it."""

    @property
    def messages(self) -> int:
        """Messages in all topics."""
        return sum(topic.messages for topic in self.topics)

    def to_json(self) -> dict[str, Any]:
        """Return everything as JSON-compatible values."""
        return {
            "path": str(self.path),
            "size": self.size,
            "library": self.library,
            "profile": self.profile,
            "compression": dict(self.compression),
            "messages": self.messages,
            "start_ns": self.start_ns,
            "end_ns": self.end_ns,
            "topics": [asdict(topic) for topic in self.topics],
            "run": asdict(self.run) if self.run else None,
            "experience": self.experience.to_json() if self.experience else None,
            "problem": asdict(self.problem) if self.problem else None,
        }


@dataclass(frozen=True)
class Inspection:
    """What is in some files."""

    files: tuple[FileInspection, ...]
    """Each of them."""

    @property
    def experience(self) -> Experience | None:
        """What there is to learn from in all logs of transitions; None if there is none, or their spaces differ."""
        parts = [file.experience for file in self.files if file.experience]
        return reduce(Experience.merge, parts) if parts and all(each.spec == parts[0].spec for each in parts) else None

    @property
    def damaged(self) -> int:
        """Number of files with a problem."""
        return sum(file.problem is not None for file in self.files)

    @property
    def size(self) -> int:
        """Bytes in all files."""
        return sum(file.size for file in self.files)

    @property
    def messages(self) -> int:
        """Messages in all files."""
        return sum(file.messages for file in self.files)

    def to_json(self) -> dict[str, Any]:
        """Return everything as JSON-compatible values."""
        return {
            "files": [file.to_json() for file in self.files],
            "totals": {
                "files": len(self.files),
                "damaged": self.damaged,
                "size": self.size,
                "messages": self.messages,
                "experience": self.experience.to_json() if self.experience else None,
            },
        }


def is_of_logs(paths: Sequence[Path]) -> bool:
    """Say whether MCAP files are meant: by their names, by what a folder holds, or because nothing else is there."""
    return all(
        bool([*path.rglob("*.mcap"), *path.rglob("*.mcap.partial")])
        if path.is_dir()
        else path.suffix.lower() not in (set(SUFFIXES) - {".mcap"})
        for path in paths
    )


def log_files(path: Path) -> list[Path]:
    """Return `path` itself, or the logs in that folder and the folders in it, finished or not.

    Raises:
        LogError: there is no such file or folder, or no log in it.
    """
    if not path.exists():
        message = f"{path}: there is no such file or folder; give an MCAP file or a folder with some"
        raise LogError(message)
    if not path.is_dir():
        return [path]
    found = sorted([*path.rglob("*.mcap"), *path.rglob("*.mcap.partial")])
    if not found:
        message = f"{path}: expected MCAP files (*.mcap) in this folder, but there are none; give another folder"
        raise LogError(message)
    return found


def inspect_file(path: Path) -> FileInspection:
    """Return what is in the file at `path`; damage is told in the result, never raised."""
    try:
        with open_source(path) as source:
            seen = survey(source)
    except LogError as error:
        size = path.stat().st_size if path.exists() else 0
        return FileInspection(path, size, problem=Problem(_without(path, error), 0 if size else None))
    run, experience, misread = _learning(path, seen)
    problem = seen.problem
    if problem and run:
        hint = f"; 'addressed-dynamics recover {path}' writes what is intact to a new file"
        problem = Problem(problem.message + hint, problem.offset)
    times = [part for parts in seen.times.values() for part in parts]
    return FileInspection(
        path=path,
        size=seen.size,
        library=seen.library,
        profile=seen.profile,
        compression=seen.compression,
        start_ns=min((int(part.min()) for part in times), default=None),
        end_ns=max((int(part.max()) for part in times), default=None),
        topics=tuple(_topics(seen)),
        run=run,
        experience=experience,
        problem=problem or misread,
    )


def _topics(seen: Survey) -> Iterator[Topic]:
    for channel in sorted(seen.found.channels.values(), key=lambda each: (each.topic, each.id)):
        schema = seen.found.schemas.get(channel.schema_id)
        times = np.sort(np.concatenate([np.empty(0, np.uint64), *seen.times.get(channel.id, [])]))
        seconds = float(times[-1] - times[0]) / 1e9 if len(times) else 0.0
        yield Topic(
            name=channel.topic,
            schema=schema.name if schema else "",
            encoding=channel.message_encoding,
            messages=len(times),
            rate_hz=(len(times) - 1) / seconds if seconds else None,
            longest_gap_seconds=float(np.diff(times).max()) / 1e9 if len(times) > 1 else None,
        )


def _learning(path: Path, seen: Survey) -> tuple[RunInfo | None, Experience | None, Problem | None]:
    """Read a log of transitions: all of it if it is sound, else what comes before the damage."""
    found = seen.found
    if not found.channels_of(TRANSITION_SCHEMA):
        return None, None, None
    run = None
    try:
        record = run_record(path, found)
        run = record.info
        if seen.problem:
            columns = transition_columns(record.spec, found.runs_of(TRANSITION_SCHEMA))
            transitions = Transitions(record.spec, **columns)
            episodes = list(episode_records(found.runs_of(EPISODE_SCHEMA)))
        else:
            # The reader holds all messages again.
            found.runs.clear()
            contents = read_log(path)
            transitions, episodes = contents.transitions, list(contents.episodes)
    except (LogError, TransitionsError, Damage) as error:
        return run, None, Problem(_without(path, error), getattr(error, "offset", None))
    ends = {each.episode: each.ended for each in episodes}
    identifiers = [int(transitions.episode[rows.start]) for rows in transitions.episode_slices()]
    return run, Experience.of(transitions, [ends.get(each, "cut") for each in identifiers]), None


def _without(path: Path, error: Exception) -> str:
    """Return the message of an error without the file's name before it: it stands beside the file."""
    return str(error).removeprefix(f"{path}: ")
