"""Clips that mirror each other in a database that does not name its clips.

A mirror exchanges left and right and changes nothing vertical: the hips rise and fall in it bit for bit alike. So a run
of their velocities tells which clips show the same performance, and how their frames count against each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float32, Int64

from addressed_dynamics.sources.motion.contents import CycleRows
from addressed_dynamics.sources.motion.fingerprints import window_fingerprints

WINDOW = 8
"""Frames whose velocities have to be equal: two or three dozen bytes that no two performances share."""
MATCHES = 8
"""Equal windows that it takes to call two clips one performance."""


def align_mirrors(
    cycles: Sequence[CycleRows], hips_rise: Float32[np.ndarray, " row"]
) -> tuple[tuple[CycleRows, ...], dict[str, str]]:
    """Let the frames of clips that show the same performance count alike.

    Args:
        cycles: cycles of clips whose frames count from 0 each.
        hips_rise: vertical velocity of the hips in each row of the source.

    Returns:
        The cycles with their frames in the performance, of which the first is 0, and the group of each clip: the name
        of the first clip of the performance.
    """
    clips = list(dict.fromkeys(cycle.clip for cycle in cycles))
    groups, shifts = np.arange(len(clips)), np.zeros(len(clips), dtype=np.int64)
    for clip, other, offset in _matches(_rises(cycles, clips, hips_rise)).tolist():
        if groups[clip] != groups[other]:
            members = groups == groups[clip]
            shifts[members] += shifts[other] + offset - shifts[clip]
            groups[members] = groups[other]
    first_frames = np.full(len(clips), np.iinfo(np.int64).max)
    index = {clip: number for number, clip in enumerate(clips)}
    for cycle in cycles:
        number = index[cycle.clip]
        group = groups[number]
        first_frames[group] = min(first_frames[group], cycle.frame + shifts[number])
    shifts -= first_frames[groups]
    leaders = {group: clips[int(np.flatnonzero(groups == group)[0])] for group in np.unique(groups).tolist()}
    aligned = tuple(replace(cycle, frame=cycle.frame + int(shifts[index[cycle.clip]])) for cycle in cycles)
    return aligned, {clip: leaders[int(group)] for clip, group in zip(clips, groups, strict=True)}


def _rises(
    cycles: Sequence[CycleRows], clips: Sequence[str], hips_rise: Float32[np.ndarray, " row"]
) -> list[Float32[np.ndarray, " frame"]]:
    """Return the velocities of each clip by frame, NaN where frames are missing."""
    by_clip: dict[str, list[CycleRows]] = {clip: [] for clip in clips}
    for cycle in cycles:
        by_clip[cycle.clip].append(cycle)
    rises = []
    for members in by_clip.values():
        rise = np.full(max(cycle.frame + cycle.rows for cycle in members), np.nan, dtype=np.float32)
        for cycle in members:
            rise[cycle.frame : cycle.frame + cycle.rows] = hips_rise[cycle.row : cycle.row + cycle.rows]
        rises.append(rise)
    return rises


def _matches(rises: Sequence[Float32[np.ndarray, " frame"]]) -> Int64[np.ndarray, "match 3"]:
    """Return pairs of clips with an equal run, the later one first, and the frames by which the earlier is ahead."""
    keys, clips, frames = [np.empty(0, np.uint64)], [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for clip, rise in enumerate(rises):
        if len(rise) < WINDOW:
            continue
        windows = np.lib.stride_tricks.sliding_window_view(rise, WINDOW)
        # Where nothing moves, all performances are alike. A comparison with NaN is false.
        telling = np.flatnonzero(windows.max(axis=1) > windows.min(axis=1))
        keys.append(window_fingerprints(windows[telling]))
        clips.append(np.full(len(telling), clip))
        frames.append(telling)
    key, clip_of, frame_of = np.concatenate(keys), np.concatenate(clips), np.concatenate(frames)
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    earliest = first[inverse]
    pairs = np.stack([clip_of, clip_of[earliest], frame_of[earliest] - frame_of], axis=1)
    pairs, votes = np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0, return_counts=True)
    enough = votes >= MATCHES
    matches: Int64[np.ndarray, "match 3"] = pairs[enough][np.argsort(-votes[enough], kind="stable")]
    return matches
