"""Blocks in time: what a long recording without episodes is cut into, so that it can be split."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from addressed_dynamics.episodes.splits import SPLITS, Split, assign_blocks

SHORTEST = 20
"""Steps that a block has at least."""
GAPS = 4
"""A block is at least as long as so many gaps, so that the gaps on both sides take at most half of it."""


@dataclass(frozen=True)
class Block:
    """Consecutive steps of an episode, without those that are dropped at its ends."""

    name: str
    """Stable name, which its split depends on: that of the episode and the number of the block, such as `run-7#0.3`."""
    split: Split
    first: int
    """Its first step that is kept, counted from the first of the episode that is recorded."""
    stop: int
    """The step after its last one that is kept."""


def shortest_block(gap: int) -> int:
    """Return how many steps a block has at least."""
    return max(SHORTEST, GAPS * gap)


def block_count(length: int, *, blocks: int, gap: int) -> int:
    """Return in how many blocks an episode of `length` steps is cut: fewer than asked for if they would be too short.

    An episode that is too short for a block of each split is not cut: 1.
    """
    count = min(blocks, length // shortest_block(gap))
    return count if count >= len(SPLITS) else 1


def block_borders(length: int, count: int) -> list[int]:
    """Return where `count` blocks of an episode of `length` steps begin, and the end of the last one."""
    return [length * number // count for number in range(count + 1)]


def cut_in_blocks(
    name: str, length: int, *, count: int, gap: int, seed: int, validation_share: float, test_share: float
) -> list[Block]:
    """Cut an episode in blocks in time, which differ in length by at most a step, and give each its split.

    Between two blocks of different splits `gap` steps are dropped, for they are near copies of those beyond the border:
    of the one for training, or between validation and test of the one for validation, so that what is tested stays
    whole.

    Args:
        name: stable name of the episode.
        length: its number of steps.
        count: number of blocks, from `block_count`.
        gap: steps between blocks of different splits.
        seed: seed of the hash; see `assign_blocks`, as for the shares.
        validation_share: share of the blocks that are for validation.
        test_share: share of the blocks that are for testing.
    """
    names = [f"{name}.{number}" for number in range(count)]
    splits = assign_blocks(names, seed=seed, validation_share=validation_share, test_share=test_share)
    borders = block_borders(length, count)
    return [
        Block(
            name=names[number],
            split=splits[number],
            first=borders[number] + gap * _gives_way(splits, number, number - 1),
            stop=borders[number + 1] - gap * _gives_way(splits, number, number + 1),
        )
        for number in range(count)
    ]


def _gives_way(splits: Sequence[Split], block: int, neighbour: int) -> bool:
    """Whether steps of a block are dropped beside a neighbour, if there is one."""
    if not 0 <= neighbour < len(splits):
        return False
    return SPLITS.index(splits[block]) < SPLITS.index(splits[neighbour])
