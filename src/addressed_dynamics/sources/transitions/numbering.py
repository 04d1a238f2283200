"""Identifiers of episodes that are unique in a folder, although each of its recordings may number its own from 0."""

from __future__ import annotations

import filecmp
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.episodes.transitions import Transitions


@dataclass(frozen=True)
class NumberedLog:
    """A log and its episodes."""

    log: Path
    recording: str
    """What is the same in all logs of one recording; see `LogContents.recording`."""
    episodes: tuple[int, ...]
    """Identifiers of its episodes, in order."""


def unique_numbers(logs: Sequence[NumberedLog]) -> list[dict[int, int]]:
    """Return for each log the identifiers that its episodes have in the folder, by those that they have in it.

    They stay what they are if none is in two recordings. Otherwise all episodes are counted from 0, log by log.

    Raises:
        LogError: two logs of one recording have the same episode, or one is a copy of the other.
    """
    owners: dict[tuple[str, int], Path] = {}
    for each in logs:
        for episode in each.episodes:
            other = owners.setdefault((each.recording, episode), each.log)
            if other != each.log:
                raise _clash(each.log, other, episode)
    if len({episode for _, episode in owners}) == len(owners):
        return [{episode: episode for episode in each.episodes} for each in logs]
    firsts = np.cumsum([0, *(len(each.episodes) for each in logs)]).tolist()
    return [
        {episode: number for number, episode in enumerate(each.episodes, first)}
        for each, first in zip(logs, firsts[:-1], strict=True)
    ]


def renumber(transitions: Transitions, numbers: Mapping[int, int]) -> Transitions:
    """Give the episodes other identifiers.

    Raises:
        KeyError: an episode is not in `numbers`.
    """
    identifiers, inverse = np.unique(transitions.episode, return_inverse=True)
    found = np.array([numbers[identifier] for identifier in identifiers.tolist()], dtype=np.int64)
    if np.array_equal(found, identifiers):
        return transitions
    return replace(transitions, episode=found[inverse])


def _clash(log: Path, other: Path, episode: int) -> LogError:
    if filecmp.cmp(log, other, shallow=False):
        return LogError(f"{log}: it is a copy of {other.name}; remove one of the two")
    return LogError(
        f"{log}: episode {episode} is also in {other.name}, and both say that they are of the same recording; remove "
        "one of the two, or give each recorder a run, a topic or a first_episode of its own"
    )
