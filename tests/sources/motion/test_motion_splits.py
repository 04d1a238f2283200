"""Splits of motion: by moments, with mirrors together, whatever the order of the clips."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motion_examples import concatenate, make_clip

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.sources.motion.params import MotionConvertParams
from addressed_dynamics.sources.motion.splits import CYCLES, MOTION_SPLITS, ROWS, TEST, TRAIN, VALIDATION, plan_splits
from addressed_dynamics.sources.motion.survey import survey_clips

PARAMS = MotionConvertParams(
    test_share=0.1, validation_share=0.1, cycles_share=0.2, rows_share=0.1, split_seed=0, row_group_rows=100
)


def clips(count: int, cycles: int = 6, *, mirrors: bool = True) -> list[Motion]:
    """Return clips, each followed by a mirror whose cycles begin half a cycle earlier."""
    found = []
    for number in range(count):
        found.append(make_clip(f"c{number}", [7] * cycles, seed=number, first_frame=60))
        if mirrors:
            found.append(make_clip(f"c{number}_mirror", [7] * (cycles + 1), seed=-number % 99, first_frame=57))
    return found


def split(motions: list[Motion], **params: Any) -> tuple[Motion, np.ndarray[Any, Any]]:
    """Return all rows and their splits."""
    plan = plan_splits(survey_clips(motions), PARAMS.model_copy(update=params))
    whole = concatenate(motions)
    return whole, plan.of(whole)


def by_moment(motion: Motion, splits: np.ndarray[Any, Any]) -> dict[tuple[str, int], set[int]]:
    """Return the splits of the rows of each moment of a performance."""
    moments: dict[tuple[str, int], set[int]] = {}
    for clip, frame, code in zip(motion.clip.tolist(), motion.frame.tolist(), splits.tolist(), strict=True):
        moments.setdefault((clip.removesuffix("_mirror"), frame), set()).add(code)
    return moments


@settings(max_examples=40)
@given(
    count=st.integers(1, 8), cycles=st.integers(1, 9), mirrors=st.booleans(), seed=st.integers(0, 99),
    shares=st.tuples(*[st.sampled_from([0.0, 0.1, 0.3])] * 4),
)  # fmt: skip
def test_a_moment_is_in_one_split_but_for_rows_that_were_drawn_one_by_one(
    count: int, cycles: int, mirrors: bool, seed: int, shares: tuple[float, ...]
) -> None:
    names = ("test_share", "validation_share", "cycles_share", "rows_share")
    motion, splits = split(
        clips(count, cycles, mirrors=mirrors), split_seed=seed, **dict(zip(names, shares, strict=True))
    )
    assert set(splits.tolist()) <= set(range(len(MOTION_SPLITS)))
    for codes in by_moment(motion, splits).values():
        assert len(codes - {ROWS} if TRAIN in codes else codes) == 1 or codes == {ROWS}
    test_groups = {clip.removesuffix("_mirror") for clip in motion.clip[splits == TEST].tolist()}
    for clip in set(motion.clip.tolist()):
        assert (clip.removesuffix("_mirror") in test_groups) == (set(splits[motion.clip == clip].tolist()) == {TEST})
    assert (splits == TRAIN).any() or shares[3]


@settings(max_examples=25)
@given(count=st.integers(1, 7), seed=st.integers(0, 99), data=st.data())
def test_the_order_of_the_clips_and_the_size_of_blocks_do_not_matter(count: int, seed: int, data: Any) -> None:
    motions = clips(count, 3)
    motion, splits = split(motions, split_seed=seed)
    order = data.draw(st.permutations(range(len(motions))))
    _, shuffled = split([motions[index] for index in order], split_seed=seed)
    starts = np.cumsum([0, *(len(each) for each in motions)])
    np.testing.assert_array_equal(shuffled, np.concatenate([splits[starts[i] : starts[i + 1]] for i in order]))
    plan = plan_splits(survey_clips(motions), PARAMS.model_copy(update={"split_seed": seed}))
    np.testing.assert_array_equal(np.concatenate([plan.of(motion.select(slice(row, row + 1))) for row in range(40)]),
                                  splits[:40])  # fmt: skip


def test_whole_clips_are_for_validation_if_there_are_five_and_runs_of_cycles_if_there_are_fewer() -> None:
    for count, whole in ((5, True), (4, False)):
        motion, splits = split(clips(count, 12), rows_share=0.0)
        of_clips = [set(splits[motion.clip == clip].tolist()) for clip in set(motion.clip.tolist())]
        assert any(codes == {VALIDATION} for codes in of_clips) == whole
        assert any(codes > {VALIDATION, TRAIN} for codes in of_clips) != whole
        assert {TRAIN, VALIDATION, TEST, CYCLES} == set(splits.tolist())


def test_cycles_are_held_out_whole() -> None:
    motion, splits = split(clips(6, 9, mirrors=False), rows_share=0.0)
    whole = 0
    for clip in set(motion.clip[splits == CYCLES].tolist()):
        for cycle in range(9):
            codes = splits[(motion.clip == clip) & (motion.cycle == cycle)]
            inner = set(codes[1:-1].tolist())
            assert len(inner) == 1
            whole += inner == {CYCLES}
            # A neighbour gives up the frame that it shares with a cycle that is held out.
            assert inner != {CYCLES} or set(codes.tolist()) == {CYCLES}
    assert whole > 0


def test_named_clips_are_for_testing_with_their_mirrors_and_no_others() -> None:
    motion, splits = split(clips(3), test_clips=("c1_mirror",))
    assert set(motion.clip[splits == TEST].tolist()) == {"c1", "c1_mirror"}
    with pytest.raises(MotionError, match="test_clips: there is no clip 'c9' to hold out; the clips are c0, c0_mirror"):
        split(clips(3), test_clips=("c1", "c9"))


def test_rows_are_drawn_in_about_their_share_of_what_is_left() -> None:
    motion, splits = split(clips(6, 60), rows_share=0.2)
    left = np.isin(splits, [TRAIN, ROWS])
    assert abs((splits[left] == ROWS).mean() - 0.2) < 0.03
    again = split(clips(6, 60), rows_share=0.2, split_seed=1)[1]
    assert (again != splits).any()
    assert len(motion) == len(splits)


def test_the_hash_never_changes() -> None:
    _, splits = split(clips(3, 4, mirrors=False), rows_share=0.3)
    found = "".join(map(str, splits.tolist()))
    assert found == "1" * 28 + "2" * 28 + "0400403333333330400440400044"
