"""Clips of motion capture: a BVH file with its phase, its gaits and its footsteps beside it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.layout import FRAME_RATE, JOINTS, PARENTS
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.logs.bvh import Bvh, read_bvh
from addressed_dynamics.logs.text import parse_table, read_lines
from addressed_dynamics.sources.motion.extraction import (
    GAIT_LABELS,
    crouch_by_height,
    extract_inputs,
    extract_outputs,
    fold_gaits,
    row_phases,
)
from addressed_dynamics.sources.motion.footsteps import parse_cycles, rows_of, within
from addressed_dynamics.sources.motion.kinematics import Poses, facing, forward_kinematics, joint_rotations
from addressed_dynamics.sources.motion.terrain import flat_ground, mapped_ground, read_height_map

CENTIMETRES = 5.6444
"""Length of a unit of the BVH files, in cm."""
SIDE_FILES = (".phase", ".gait", "_footsteps.txt")
"""What the name of a clip goes on with in the files beside its BVH file, all of which it needs."""
HEIGHT_MAP = "_heightmap.txt"
"""The file that a clip on uneven ground may have beside them."""


def read_clips(folder: Path) -> Iterator[Motion]:
    """Yield the clips of a folder, in the order of their names; mirrored ones are clips of their own.

    A BVH file without any side file, such as a rest pose, is no clip.

    Raises:
        MotionError: the folder holds no clip, a clip lacks a file, no clip has a gait cycle that can be used, or
            `read_clip` fails.
    """
    found = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    names = {name.removesuffix(end) for end in (".bvh", *SIDE_FILES) for name in found if name.endswith(end)}
    clips = sorted(name for name in names if any(name + end in found for end in SIDE_FILES))
    if not clips:
        message = f"{folder}: expected a folder of clips (.bvh with {', '.join(SIDE_FILES)}), but found none"
        raise MotionError(message)
    rows = 0
    for name in clips:
        motion = read_clip(folder / f"{name}.bvh")
        rows += len(motion)
        yield motion
    if not rows:
        message = (
            f"{folder}: none of its {len(clips)} clips has a gait cycle that is a second away from both of its ends"
        )
        raise MotionError(message)


def read_clip(path: Path) -> Motion:
    """Read one clip: a row for every frame of its gait cycles.

    Without a height map beside it, the clip is taken to be on flat ground. A clip has no rows if none of its cycles
    can be used: see `cycles.parse_cycles` and `cycles.within`.

    Args:
        path: its BVH file, at 120 Hz or at another multiple of 60 Hz, which its side files share.

    Raises:
        MotionError: a file is missing or damaged, the clip has another skeleton than `layout.SKELETON` or another
            rate, a side file has another length than the clip, or a phase is not in [0, 1].
    """
    missing = [
        name for name in (path.name, *(path.stem + end for end in SIDE_FILES)) if not (path.parent / name).exists()
    ]
    if missing:
        message = f"{path.parent}: the clip '{path.stem}' lacks {', '.join(missing)}"
        raise MotionError(message)
    bvh = read_bvh(path)
    step = _frames_to_one(path, bvh)
    poses = _poses(path, bvh, step)
    phase = _read_phase(path.with_suffix(".phase"), len(bvh.positions))[::step]
    gaits = fold_gaits(_read_side_file(path.with_suffix(".gait"), len(GAIT_LABELS), len(bvh.positions))[::step])
    footsteps = path.with_name(f"{path.stem}_footsteps.txt")
    cycles = within(parse_cycles(footsteps, read_lines(footsteps), step), len(poses))
    rows = rows_of(cycles)
    height_map = path.with_name(path.stem + HEIGHT_MAP)
    if height_map.exists():
        ground = mapped_ground(poses, rows.frame, read_height_map(height_map))
    else:
        ground, gaits = flat_ground(poses, cycles), crouch_by_height(gaits, poses)
    return Motion(
        x=extract_inputs(poses, gaits, ground, rows.frame),
        y=extract_outputs(poses, phase, ground, rows.frame),
        phase=row_phases(phase, rows),
        clip=np.full(len(rows.frame), path.stem),
        frame=rows.frame,
        cycle=rows.cycle,
    )


def _frames_to_one(path: Path, bvh: Bvh) -> int:
    """Return how many frames of the clip go by in one at 60 Hz."""
    ratio = 1 / (bvh.frame_time * FRAME_RATE)
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 0.01:
        message = f"{path}: expected 120 frames per second or another multiple of 60, but found {1 / bvh.frame_time:g}"
        raise MotionError(message)
    return round(ratio)


def _poses(path: Path, bvh: Bvh, step: int) -> Poses:
    """Return the poses of every `step`-th frame."""
    joints = _joint_order(path, bvh)
    orders = tuple(bvh.skeleton.orders[joint] for joint in joints)
    rotations = joint_rotations(bvh.rotations[::step, joints], orders)
    positions, rotations = forward_kinematics(CENTIMETRES * bvh.positions[::step, joints], rotations, PARENTS)
    return Poses(positions, rotations, facing(positions))


def _joint_order(path: Path, bvh: Bvh) -> list[int]:
    """Return where the file has each of the joints of `layout.SKELETON`; it may list them in another order."""
    names, parents = bvh.skeleton.names, bvh.skeleton.parents
    missing, unexpected = [name for name in JOINTS if name not in names], [name for name in names if name not in JOINTS]
    if missing or unexpected:
        message = (
            f"{path}: expected the {len(JOINTS)} joints of the PFNN skeleton; missing: {', '.join(missing) or 'none'}; "
            f"unexpected: {', '.join(unexpected) or 'none'}"
        )
        raise MotionError(message)
    for name, parent in zip(JOINTS, PARENTS, strict=True):
        found, expected = parents[names.index(name)], JOINTS[parent] if parent >= 0 else "nothing"
        if (names[found] if found >= 0 else "nothing") != expected:
            message = f"{path}: expected the joint {name} to hang on {expected}, but it hangs on {names[found]}"
            raise MotionError(message)
    return [names.index(name) for name in JOINTS]


def _read_side_file(path: Path, columns: int, frames: int) -> Float64[np.ndarray, "frame column"]:
    """Read a file that has a line for every frame of the clip."""
    values = parse_table(path, read_lines(path), columns)
    if len(values) != frames:
        message = f"{path}: expected {frames} lines, one for each frame of the clip, but found {len(values)}"
        raise MotionError(message)
    return values


def _read_phase(path: Path, frames: int) -> Float64[np.ndarray, " frame"]:
    phase = _read_side_file(path, 1, frames)[:, 0]
    outside = np.flatnonzero((phase < 0) | (phase > 1))
    if len(outside):
        message = f"{path}: expected phases in [0, 1], but found {phase[outside[0]]:g} at frame {outside[0]}"
        raise MotionError(message)
    return phase
