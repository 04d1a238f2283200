"""What is held out of training, and how far it is from what is trained on.

- `test`: clips held out whole, together with their mirrors.
- `validation`: likewise, to choose recipes by; where there are few clips, runs of cycles of the others.
- `cycles`: whole gait cycles of clips that are trained on.
- `rows`: single frames out of cycles that are trained on. They lie between two near copies, 1/60 s before and after
  them, so a small error on them says little; the paper's test set was drawn like this.

But for `rows` a moment is held out, not a row: the frame that two cycles share, and the same frame in the mirrored
clip, go along. Still, only `test` shares nothing with training: inputs and outputs show the trajectory of a second
before and after them, so those beside a cycle that is held out have seen its path, though not its poses.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float64, Int8, Int64

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.fingerprints import row_fingerprints
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.sources.motion.contents import CycleRows, Survey, cycle_starts
from addressed_dynamics.sources.motion.params import MotionConvertParams

MotionSplit = Literal["train", "validation", "test", "cycles", "rows"]
MOTION_SPLITS: tuple[MotionSplit, ...] = get_args(MotionSplit)
"""Names of the splits."""
TRAIN, VALIDATION, TEST, CYCLES, ROWS = range(len(MOTION_SPLITS))
ENOUGH_CLIPS = 5
"""Clips, each counted with its mirror, of which one is spared for validation."""
RUN_CYCLES = 4
"""Consecutive cycles that are held out together for validation, where there are fewer clips."""


@dataclass(frozen=True)
class SplitPlan:
    """Which moments are held out."""

    groups: Mapping[str, str]
    """The group of each clip; its frames count alike in all of them."""
    frames: Mapping[str, Int8[np.ndarray, " frame"]]
    """The split of each frame of a group, as an index into `MOTION_SPLITS`."""
    rows_share: float
    """Share of the rows in training that are held out one by one."""
    seed: int
    """Seed of the hash that chooses those rows."""

    def of(self, motion: Motion) -> Int8[np.ndarray, " row"]:
        """Return the split of each row, as an index into `MOTION_SPLITS`."""
        splits = np.empty(len(motion), dtype=np.int8)
        starts = cycle_starts(motion).tolist()
        for start, stop in zip(starts, [*starts[1:], len(motion)], strict=True):
            clip, rows = str(motion.clip[start]), slice(start, stop)
            group = self.groups[clip]
            splits[rows] = self.frames[group][motion.frame[rows]]
            drawn = _row_places(clip, motion.cycle[rows], motion.frame[rows], self.seed) < self.rows_share
            splits[rows][drawn & (splits[rows] == TRAIN)] = ROWS
        return splits


def plan_splits(survey: Survey, params: MotionConvertParams) -> SplitPlan:
    """Decide what is held out, by hashes of names and a seed: the order of the clips does not matter.

    Of the things that it is chosen from, each split gets at least one if it has a share, and never all.

    Raises:
        MotionError: a clip in `params.test_clips` does not exist.
    """
    by_group: dict[str, list[CycleRows]] = {}
    for cycle in sorted(survey.cycles, key=lambda each: (each.clip, each.cycle)):
        by_group.setdefault(survey.groups[cycle.clip], []).append(cycle)
    whole = _whole_groups(sorted(by_group), survey.groups, params)
    frames = {
        group: np.full(max(cycle.frame + cycle.rows for cycle in cycles), whole.get(group, TRAIN), dtype=np.int8)
        for group, cycles in by_group.items()
    }
    moments = [each for group, cycles in by_group.items() if group not in whole for each in _moments(cycles)]
    if VALIDATION not in whole.values():
        runs = [f"{cycle.clip}:{cycle.cycle // RUN_CYCLES}" for cycle in moments]
        chosen = _chosen(runs, params.validation_share, params.split_seed, "validation")
        held_out = [cycle for cycle, run in zip(moments, runs, strict=True) if run in chosen]
        _hold_out(frames, held_out, survey.groups, VALIDATION)
        moments = [cycle for cycle, run in zip(moments, runs, strict=True) if run not in chosen]
    names = [f"{cycle.clip}:{cycle.cycle}" for cycle in moments]
    chosen = _chosen(names, params.cycles_share, params.split_seed, "cycles")
    held_out = [cycle for cycle, name in zip(moments, names, strict=True) if name in chosen]
    _hold_out(frames, held_out, survey.groups, CYCLES)
    return SplitPlan(survey.groups, frames, params.rows_share, params.split_seed)


def _whole_groups(names: Sequence[str], groups: Mapping[str, str], params: MotionConvertParams) -> dict[str, int]:
    """Return the split of the groups that are held out whole."""
    if missing := sorted(set(params.test_clips) - set(groups)):
        known = ", ".join(sorted(groups))
        message = f"test_clips: there is no clip '{missing[0]}' to hold out; the clips are {known}"
        raise MotionError(message)
    tests = {groups[clip] for clip in params.test_clips}
    tests = tests or _chosen(names, params.test_share, params.split_seed, "clips")
    rest = [name for name in names if name not in tests]
    validations = set[str]()
    if len(names) >= ENOUGH_CLIPS:
        validations = _chosen(rest, params.validation_share, params.split_seed, "clips to choose by")
    return dict.fromkeys(tests, TEST) | dict.fromkeys(validations, VALIDATION)


def _moments(cycles: Sequence[CycleRows]) -> list[CycleRows]:
    """Return the cycles of a group that do not overlap those before them: a mirror shows what its clip has shown."""
    seen = np.zeros(max(cycle.frame + cycle.rows for cycle in cycles), dtype=bool)
    moments = []
    for cycle in cycles:
        # Its first and its last frame are also the last and the first of its neighbours.
        if not seen[cycle.frame + 1 : cycle.frame + cycle.rows - 1].any():
            moments.append(cycle)
            seen[cycle.frame : cycle.frame + cycle.rows] = True
    return moments


def _hold_out(
    frames: Mapping[str, Int8[np.ndarray, " frame"]], cycles: Sequence[CycleRows], groups: Mapping[str, str], split: int
) -> None:
    for cycle in cycles:
        held_out = frames[groups[cycle.clip]][cycle.frame : cycle.frame + cycle.rows]
        held_out[held_out == TRAIN] = split


def _chosen(names: Sequence[str], share: float, seed: int, purpose: str) -> set[str]:
    """Return about `share` of the names; at least one if there is a share, and never all."""
    places = {name: _place(f"{seed}:{purpose}:{name}") for name in names}
    count = sum(place < share for place in places.values())
    count = min(max(count, int(share > 0)), max(len(places) - 1, 0))
    return set(sorted(places, key=lambda name: (places[name], name))[:count])


def _place(text: str) -> float:
    """Return a number in [0, 1): a stable hash."""
    # 53 bits are what a float64 can hold exactly, so that no place rounds up to 1.
    return (int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest()) >> 11) / 2**53


def _row_places(
    clip: str, cycle: Int64[np.ndarray, " row"], frame: Int64[np.ndarray, " row"], seed: int
) -> Float64[np.ndarray, " row"]:
    """Return a number in [0, 1) for each row: a stable hash of its clip, cycle and frame."""
    place = np.full(len(frame), _place(f"{seed}:rows:{clip}"))
    places: Float64[np.ndarray, " row"] = (row_fingerprints(place, cycle, frame) >> np.uint64(11)).astype(
        np.float64
    ) / 2**53
    return places
