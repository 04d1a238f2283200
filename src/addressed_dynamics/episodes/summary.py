"""A short report on recorded data: how long, how rewarding, how varied, and how well the learner did."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from addressed_dynamics.base.files import write_text
from addressed_dynamics.episodes.coverage import Occupancy
from addressed_dynamics.episodes.index import Episode
from addressed_dynamics.episodes.splits import SPLITS
from addressed_dynamics.episodes.transitions import Dimension, SpaceSpec

RECENT_EPISODES = 100
"""Number of last episodes by which a segment's success is judged."""
BLOCKS = 10
"""Number of equal blocks of episodes in which a segment's returns are averaged, to show learning."""


@dataclass(frozen=True)
class BlockFigures:
    """What became of long episodes that were cut in blocks in time."""

    episodes: int
    """Episodes that were cut."""
    lengths: tuple[int, ...]
    """Steps of each block, those that are dropped at its ends included."""
    gap_steps: int
    """Steps that are dropped between blocks of different splits."""
    gaps: int
    """How often that happened."""
    dropped: int
    """Steps that were dropped."""

    def to_json(self) -> dict[str, Any]:
        """Return the figures as JSON-compatible values."""
        return {
            "episodes": self.episodes,
            "blocks": len(self.lengths),
            "steps": _spread(self.lengths),
            "gap_steps": self.gap_steps,
            "gaps": self.gaps,
            "dropped": self.dropped,
        }


def data_report(
    spec: SpaceSpec,
    episodes: Sequence[Episode],
    behaviours: Mapping[str, str],
    *,
    splits: Mapping[str, Mapping[str, int]],
    ranges: Sequence[tuple[float, float]],
    occupancy: Occupancy,
    duplicates: int,
    exogenous: Sequence[tuple[float, float]] = (),
) -> dict[str, Any]:
    """Return the report as JSON-compatible values.

    Args:
        spec: what the numbers mean.
        episodes: all episodes of the recording; at least one.
        behaviours: who acted, by segment.
        splits: what each split has of them, from `split_sizes`.
        ranges: lowest and highest value of each dimension of the observation.
        occupancy: which cells of the state space hold data.
        duplicates: number of rows whose observation, action and exogenous inputs are exactly those of an earlier row.
        exogenous: lowest and highest value of each exogenous input.
    """
    transitions = sum(episode.length for episode in episodes)
    by_segment: dict[str, list[Episode]] = {name: [] for name in behaviours}
    for episode in episodes:
        by_segment[episode.segment].append(episode)
    return {
        "transitions": transitions,
        "episodes": _episode_figures(episodes),
        "splits": splits,
        "segments": {
            name: {"behaviour": behaviour, **_segment_figures(by_segment[name])}
            for name, behaviour in behaviours.items()
        },
        "ranges": _ranges(spec.observation, ranges),
        **({"exogenous": _ranges(spec.exogenous, exogenous)} if spec.exogenous else {}),
        "coverage": _coverage_figures(spec, occupancy),
        "duplicates": {"rows": duplicates, "share": duplicates / transitions},
    }


def split_sizes(episodes: Sequence[Episode]) -> dict[str, dict[str, int]]:
    """Return how many of the episodes, and of their transitions, each split has."""
    sizes: dict[str, dict[str, int]] = {}
    for split in SPLITS:
        lengths = [episode.length for episode in episodes if episode.split == split]
        sizes[split] = {"episodes": len(lengths), "transitions": sum(lengths)}
    return sizes


def write_learner_curve(path: Path, episodes: Sequence[Episode], *, step_seconds: float) -> None:
    """Write one CSV row for each finished episode, in the order of their ends (simulated time, all copies)."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["index", "segment", "end_step", "return", "length", "terminated"])
    for index, episode in enumerate(_finished(episodes)):
        # The clock of a log counts the steps of one copy of the environment.
        end_step = round(episode.end_time_ns / 1e9 / step_seconds)
        terminated = int(episode.ended == "terminated")
        writer.writerow([index, episode.segment, end_step, episode.total_reward, episode.length, terminated])
    write_text(path, text.getvalue())


def _finished(episodes: Sequence[Episode]) -> list[Episode]:
    """Leave out the episodes that the recording cut off, whose returns mean little, and sort the rest by their ends.

    Copies of an environment run side by side, so simulated time puts the episodes of all of them in order.
    """
    finished = [episode for episode in episodes if episode.ended != "cut"]
    return sorted(finished, key=lambda episode: (episode.end_time_ns, episode.episode))


def _episode_figures(episodes: Sequence[Episode]) -> dict[str, Any]:
    ended = Counter(episode.ended for episode in episodes)
    finished = _finished(episodes)
    return {
        "count": len(episodes),
        "length": _spread([episode.length for episode in finished]),
        "return": _spread([episode.total_reward for episode in finished]),
        "ended": {how: ended[how] for how in ("terminated", "truncated", "cut")},
    }


def _segment_figures(episodes: Sequence[Episode]) -> dict[str, Any]:
    finished = _finished(episodes)
    recent = finished[-RECENT_EPISODES:]
    blocks = [block for block in np.array_split([episode.total_reward for episode in finished], BLOCKS) if len(block)]
    return {
        **_episode_figures(episodes),
        "transitions": sum(episode.length for episode in episodes),
        "terminated_share_last_100": _terminated_share(recent),
        "mean_return_by_block": [float(block.mean()) for block in blocks],
    }


def _terminated_share(episodes: Sequence[Episode]) -> float | None:
    return sum(episode.ended == "terminated" for episode in episodes) / len(episodes) if episodes else None


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    if not values:
        return None
    return {
        "mean": float(np.mean(values)),
        "median": float(np.median(values)),
        "min": float(np.min(values)),
        "max": float(np.max(values)),
    }


def _ranges(dimensions: Sequence[Dimension], found: Sequence[tuple[float, float]]) -> dict[str, dict[str, Any]]:
    return {
        dimension.name: {"min": low, "max": high, **_bounds(dimension), "unit": dimension.unit}
        for dimension, (low, high) in zip(dimensions, found, strict=True)
    }


def _bounds(dimension: Dimension) -> dict[str, float | None]:
    return {
        "low": dimension.low if np.isfinite(dimension.low) else None,
        "high": dimension.high if np.isfinite(dimension.high) else None,
    }


def _coverage_figures(spec: SpaceSpec, occupancy: Occupancy) -> dict[str, Any]:
    shares = occupancy.per_dimension.mean(axis=1)
    return {
        "cells_per_dimension": occupancy.per_dimension.shape[1],
        "per_dimension": dict(zip(spec.observation_names, map(float, shares), strict=True)),
        "plane": None if occupancy.grid is None else float(occupancy.grid.mean()),
    }
