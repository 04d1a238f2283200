"""Blocks in time: every step is in one split or dropped, and nothing is tested beside what was learned."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.episodes.blocks import Block, block_borders, block_count, cut_in_blocks, shortest_block
from addressed_dynamics.episodes.splits import assign_blocks

shares = st.sampled_from([0.0, 0.05, 0.15, 0.3, 0.45])


@st.composite
def cuts(draw: st.DrawFn) -> tuple[int, int, list[Block]]:
    """A length, a gap, and the blocks of an episode of that length."""
    gap = draw(st.integers(0, 60))
    length = draw(st.integers(3 * shortest_block(gap), 12_000))
    count = block_count(length, blocks=draw(st.integers(3, 40)), gap=gap)
    cut = cut_in_blocks(
        draw(st.sampled_from(["a#0", "b#7"])),
        length,
        count=count,
        gap=gap,
        seed=draw(st.integers(0, 99)),
        validation_share=draw(shares),
        test_share=draw(shares),
    )
    return length, gap, cut


@given(cuts())
def test_no_step_of_a_block_is_within_the_gap_of_a_step_of_another_split(cut: tuple[int, int, list[Block]]) -> None:
    _, gap, blocks = cut
    for one in blocks:
        for other in blocks:
            if one.split != other.split and one.stop <= other.first:
                assert other.first - (one.stop - 1) > gap


@given(cuts())
def test_every_step_is_in_one_block_or_dropped_beside_a_block_of_another_split(
    cut: tuple[int, int, list[Block]],
) -> None:
    length, gap, blocks = cut
    owners = np.zeros(length, dtype=int)
    for block in blocks:
        owners[block.first : block.stop] += 1
    assert owners.max() == 1
    borders = sum(one.split != two.split for one, two in pairwise(blocks))
    assert int((owners == 0).sum()) == gap * borders


@given(cuts())
def test_blocks_follow_each_other_are_equally_long_and_keep_at_least_half(
    cut: tuple[int, int, list[Block]],
) -> None:
    length, _, blocks = cut
    borders = block_borders(length, len(blocks))
    lengths = np.diff(borders)
    assert (borders[0], borders[-1]) == (0, length)
    assert lengths.max() - lengths.min() <= 1
    for block, (begin, end) in zip(blocks, pairwise(borders), strict=True):
        assert begin <= block.first < block.stop <= end
        assert block.stop - block.first >= (end - begin) / 2


@given(cuts())
def test_blocks_for_testing_are_whole(cut: tuple[int, int, list[Block]]) -> None:
    length, _, blocks = cut
    for block, (begin, end) in zip(blocks, pairwise(block_borders(length, len(blocks))), strict=True):
        if block.split == "test":
            assert (block.first, block.stop) == (begin, end)


@pytest.mark.parametrize(
    ("length", "gap", "count"),
    [
        (3_000, 20, 20),
        (1_600, 20, 20),
        (1_599, 20, 19),
        (400, 20, 5),
        (240, 20, 3),
        (239, 20, 1),
        (60, 0, 3),
        (59, 0, 1),
    ],
)
def test_a_shorter_episode_has_fewer_blocks_and_one_too_short_for_three_stays_whole(
    length: int, gap: int, count: int
) -> None:
    assert block_count(length, blocks=20, gap=gap) == count


def numbers(count: int, seed: int = 0, validation: float = 0.1, test: float = 0.15) -> dict[str, int]:
    names = [f"drive#0.{number}" for number in range(count)]
    found = assign_blocks(names, seed=seed, validation_share=validation, test_share=test)
    return {split: found.count(split) for split in ("train", "validation", "test")}


@given(st.integers(0, 999))
def test_blocks_are_shared_as_asked_whatever_the_hash_says(seed: int) -> None:
    assert numbers(20, seed) == {"train": 15, "validation": 2, "test": 3}
    assert numbers(3, seed) == {"train": 1, "validation": 1, "test": 1}
    assert numbers(20, seed, validation=0.0) == {"train": 17, "validation": 0, "test": 3}


def test_which_blocks_are_for_testing_depends_on_the_name_and_the_seed_and_never_changes() -> None:
    def tests(name: str, seed: int) -> list[str]:
        cut = cut_in_blocks(name, 3_000, count=20, gap=20, seed=seed, validation_share=0.1, test_share=0.15)
        return [block.name for block in cut if block.split == "test"]

    assert tests("drive#0", 0) == ["drive#0.1", "drive#0.12", "drive#0.15"]
    assert tests("drive#0", 0) != [name.replace("#1", "#0") for name in tests("drive#1", 0)]
    assert tests("drive#0", 0) != tests("drive#0", 1)
