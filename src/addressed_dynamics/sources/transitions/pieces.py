"""What becomes of recorded episodes in the tables: each stays whole, or is cut in blocks; and what each is for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Int8

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.episodes.blocks import block_borders, block_count, cut_in_blocks, shortest_block
from addressed_dynamics.episodes.index import Episode
from addressed_dynamics.episodes.splits import SPLITS, Split, assign_splits
from addressed_dynamics.episodes.summary import BlockFigures
from addressed_dynamics.episodes.transitions import COLUMNS, Transitions
from addressed_dynamics.sources.transitions.params import ConvertParams


@dataclass(frozen=True, slots=True)
class Piece:
    """Consecutive steps of a recorded episode, which are an episode of the tables."""

    episode: Episode
    """What the list of episodes says of it; what a block earned and when it ended is known when its steps are read."""
    first: int
    """Its first step, counted from the first of the episode that is recorded."""
    stop: int
    """The step after its last one."""
    count: int
    """Number of pieces of the recorded episode; 1 if this is the whole of it."""

    @property
    def code(self) -> int:
        """Its split, as an index into `SPLITS`."""
        assert self.episode.split is not None
        return SPLITS.index(self.episode.split)


@dataclass(frozen=True, slots=True)
class Planned:
    """A recorded episode, and what becomes of it."""

    whole: Episode
    """The episode as it was recorded; without a split if it is cut."""
    pieces: tuple[Piece, ...]

    @property
    def cut(self) -> bool:
        """Whether it is cut in blocks."""
        return len(self.pieces) > 1


def plan_pieces(recording: Path, episodes: Sequence[Episode], params: ConvertParams) -> list[Planned]:
    """Say what becomes of each episode, segment by segment, so that each has its share of test episodes.

    Cut episodes are split by themselves. If there are any, all episodes of the tables are counted anew, from 0 in the
    order of `episodes`: a block has no number of its own in the logs.

    Args:
        recording: folder of the logs, for errors.
        episodes: all episodes in the order of the logs, without splits.
        params: how they are split.

    Raises:
        TableError: they are so few that a split that has a share would be empty.
    """
    counts = [
        block_count(each.length, blocks=params.blocks, gap=params.gap_steps) if params.split == "blocks" else 1
        for each in episodes
    ]
    numbers = [each.episode for each in episodes]
    if any(count > 1 for count in counts):
        numbers = np.cumsum([0, *counts[:-1]]).tolist()
    splits = _splits_of([each for each, count in zip(episodes, counts, strict=True) if count == 1], params)
    by_segment: dict[str, list[Planned]] = {}
    for each, number, count in zip(episodes, numbers, counts, strict=True):
        planned = _cut(each, number, count, params) if count > 1 else _whole(each, number, splits[each.name])
        by_segment.setdefault(each.segment, []).append(planned)
    result = [planned for segment in by_segment.values() for planned in segment]
    _refuse_empty_splits(recording, result, params)
    return result


def take_pieces(
    transitions: Transitions, pieces: Mapping[int, Sequence[Piece]]
) -> tuple[Transitions, Int8[np.ndarray, " step"], list[Episode]]:
    """Return the steps of the tables that some whole recorded episodes hold.

    Args:
        transitions: the recorded episodes.
        pieces: what becomes of each, by its number there.

    Returns:
        The steps, each with the number of its piece for its episode; the index into `SPLITS` of each; and what the list
        of episodes says of the blocks among the pieces.
    """
    parts, taken, blocks = list[np.ndarray](), list[Piece](), list[Episode]()
    for rows in transitions.episode_slices():
        for piece in pieces[int(transitions.episode[rows.start])]:
            part = np.arange(rows.start + piece.first, rows.start + piece.stop)
            blocks += [_measured(piece.episode, transitions, part)] if piece.count > 1 else []
            parts.append(part)
            taken.append(piece)
    lengths = np.array([len(part) for part in parts], dtype=np.int64)
    columns = {name: getattr(transitions, name) for name in COLUMNS}
    if blocks:
        kept = np.concatenate(parts)
        columns = {name: column[kept] for name, column in columns.items()}
    columns["episode"] = np.repeat(np.array([piece.episode.episode for piece in taken], dtype=np.int64), lengths)
    codes = np.repeat(np.array([piece.code for piece in taken], dtype=np.int8), lengths)
    return Transitions(transitions.spec, **columns), codes, blocks


def block_figures(planned: Sequence[Planned], gap: int) -> BlockFigures:
    """Return what the report says of the blocks."""
    cut = [each for each in planned if each.cut]
    lengths = [np.diff(block_borders(each.whole.length, len(each.pieces))) for each in cut]
    splits = [[piece.episode.split for piece in each.pieces] for each in cut]
    kept = sum(piece.episode.length for each in cut for piece in each.pieces)
    return BlockFigures(
        episodes=len(cut),
        lengths=tuple(int(length) for each in lengths for length in each),
        gap_steps=gap,
        gaps=sum(one != two for each in splits for one, two in pairwise(each)),
        dropped=sum(each.whole.length for each in cut) - kept,
    )


def _splits_of(episodes: Sequence[Episode], params: ConvertParams) -> dict[str, Split]:
    """Split whole episodes, those of each segment by themselves; return their splits by their names."""
    by_segment: dict[str, list[str]] = {}
    for each in episodes:
        by_segment.setdefault(each.segment, []).append(each.name)
    splits: dict[str, Split] = {}
    for names in by_segment.values():
        found = assign_splits(
            names, seed=params.split_seed, validation_share=params.validation_share, test_share=params.test_share
        )
        splits |= zip(names, found, strict=True)
    return splits


def _whole(episode: Episode, number: int, split: Split) -> Planned:
    recorded = replace(episode, split=split)
    piece = recorded if number == recorded.episode else replace(recorded, episode=number)
    return Planned(recorded, (Piece(piece, 0, episode.length, 1),))


def _cut(episode: Episode, number: int, count: int, params: ConvertParams) -> Planned:
    blocks = cut_in_blocks(
        episode.name,
        episode.length,
        count=count,
        gap=params.gap_steps,
        seed=params.split_seed,
        validation_share=params.validation_share,
        test_share=params.test_share,
    )
    pieces = []
    for place, block in enumerate(blocks):
        own = replace(
            episode,
            episode=number + place,
            name=block.name,
            split=block.split,
            seed=None if place else episode.seed,
            length=block.stop - block.first,
            ended=episode.ended if place == count - 1 else "cut",
        )
        pieces.append(Piece(own, block.first, block.stop, count))
    return Planned(episode, tuple(pieces))


def _measured(block: Episode, transitions: Transitions, rows: np.ndarray) -> Episode:
    """Add what is known when the steps of a block are read; as in a log, a nanosecond is missing to the end."""
    step_ns = round(transitions.spec.step_seconds * 1e9)
    return replace(
        block,
        total_reward=float(transitions.reward[rows].astype(np.float64).sum()),
        end_time_ns=int(transitions.time_ns[rows[-1]]) + step_ns - 1,
    )


def _refuse_empty_splits(recording: Path, planned: Sequence[Planned], params: ConvertParams) -> None:
    found = {piece.episode.split for each in planned for piece in each.pieces}
    shares = {"validation": params.validation_share, "test": params.test_share}
    words = {"train": "training"}
    empty = [words.get(split, split) for split in SPLITS if split not in found and shares.get(split, 1.0) > 0]
    if not empty:
        return
    number = f"its {len(planned)} episodes leave" if len(planned) > 1 else "its only episode leaves"
    advice = "record more episodes, or set 'split: blocks' under 'convert' to cut long ones in blocks in time"
    if params.split == "blocks":
        longest, needed = max(each.whole.length for each in planned), len(SPLITS) * shortest_block(params.gap_steps)
        advice = (
            f"to be cut, an episode needs {needed} steps with gap_steps {params.gap_steps}, but the longest has "
            f"{longest}; lower gap_steps, or record more"
        )
    message = f"{recording}: {number} nothing for {' and '.join(empty)}; {advice}"
    raise TableError(message)
