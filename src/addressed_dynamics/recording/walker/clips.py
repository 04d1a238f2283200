"""Clips of the walker, and their files: those of the published motion capture."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.base.files import atomic_path, write_json, write_text
from addressed_dynamics.episodes.layout import JOINTS, MADE_UP, PARENTS
from addressed_dynamics.logs.bvh import write_bvh
from addressed_dynamics.logs.hierarchy import Skeleton
from addressed_dynamics.recording.walker.body import MIRRORED, OFFSETS
from addressed_dynamics.recording.walker.course import MARGIN, follow
from addressed_dynamics.recording.walker.curves import RATE, Vectors, angles_of
from addressed_dynamics.recording.walker.feet import swing
from addressed_dynamics.recording.walker.pose import Joints, pose
from addressed_dynamics.recording.walker.script import GAITS, SCRIPTS, Command, commands, draw_style

PREFIX = "Walker"
"""What the names of all clips begin with."""
CM_PER_UNIT = 5.6444
"""Length of a unit of the files, in cm."""
SKELETON = Skeleton(JOINTS, PARENTS, OFFSETS / CM_PER_UNIT, ("zyx",) * len(JOINTS))
_WINDOW = RATE
"""Frames that a gait cycle keeps from both ends of a clip: inputs look one second back and ahead."""


@dataclass(frozen=True)
class Clip:
    """What the files of a clip say."""

    name: str
    """Name of its files, without suffix."""
    place: Vectors
    """Where the hips are, in cm."""
    turns: Joints
    """How each joint of `layout.SKELETON` is turned against its parent."""
    gaits: Float64[np.ndarray, "frame 8"]
    """Share of each of `script.GAITS`."""
    strikes: Int64[np.ndarray, " strike"]
    """Frames, from 0, in which a foot strikes: the right one, the left one, and so on."""


def walk(name: str, script: tuple[Command, ...], seconds: float, generator: np.random.Generator) -> Clip:
    """Return a clip of a walker that follows a script, in a style of its own."""
    frames = round(seconds * RATE)
    style = draw_style(generator)
    course = follow(commands(script, seconds, generator), frames, style, generator)
    feet = {name: swing(course, side, style) for name, side in (("Left", 1), ("Right", -1))}
    place, turns = pose(course, feet, style, generator)
    shown = slice(MARGIN, MARGIN + frames)
    halves = 2 * course.phase[shown]
    events = np.arange(2 * np.ceil(halves[0] / 2), halves[-1])
    strikes = np.interp(events, halves, np.arange(frames)).round().astype(np.int64)
    return Clip(name, place[shown], turns[shown], course.gaits[shown], strikes)


def mirrored(clip: Clip) -> Clip:
    """Return the clip as a mirror shows it, left and right exchanged."""
    flip = np.array([-1.0, 1.0, 1.0])
    turns = flip[:, None] * clip.turns[:, MIRRORED] * flip
    return replace(clip, name=f"{clip.name}_mirror", place=clip.place * flip, turns=turns, strikes=clip.strikes[1:])


def write_clip(folder: Path, clip: Clip) -> None:
    """Write the files of a clip: `.bvh`, `.phase`, `.gait`, `_footsteps.txt` and `_gait.txt`."""
    frames = len(clip.place)
    angles = np.degrees(angles_of(clip.turns))
    write_bvh(folder / f"{clip.name}.bvh", SKELETON, clip.place / CM_PER_UNIT, angles, 1 / RATE)
    strikes = _whole_cycles(clip.strikes, frames)
    halves = np.interp(np.arange(frames), strikes, np.arange(len(strikes)), left=0, right=0)
    _write_lines(folder / f"{clip.name}.phase", [f"{value:.5f}" for value in halves / 2 % 1])
    _write_lines(folder / f"{clip.name}.gait", [" ".join(f"{share:.5f}" for share in row) for row in clip.gaits])
    numbers = [str(strike + 1) for strike in strikes]  # the published files count from 1
    _write_lines(
        folder / f"{clip.name}_footsteps.txt", [" ".join(numbers[i : i + 2]) for i in range(0, len(numbers), 2)]
    )
    label = clip.gaits.argmax(axis=1)
    changes = np.flatnonzero(np.diff(label, prepend=-1))
    _write_lines(folder / f"{clip.name}_gait.txt", [f"{frame + 1} {GAITS[label[frame]]}" for frame in changes])


def _whole_cycles(strikes: Int64[np.ndarray, " strike"], frames: int) -> Int64[np.ndarray, " inside"]:
    """Return the strikes from the first of the right foot to the last that leave a window at both ends."""
    rights = np.flatnonzero((strikes[::2] >= _WINDOW) & (strikes[::2] < frames - _WINDOW))
    if len(rights) < 2:
        message = f"a clip of {frames / RATE:.1f} s has no gait cycle with a second before and after it: make it longer"
        raise MotionError(message)
    return strikes[2 * rights[0] : 2 * rights[-1] + 1]


def _write_lines(path: Path, lines: list[str]) -> None:
    write_text(path, "".join(f"{line}\n" for line in lines))


def make_walker_clips(folder: Path, *, seed: int, minutes: float = 3.0) -> None:
    """Write made-up clips and their mirrors into `folder`, as a whole or not at all.

    Args:
        folder: where to; what earlier clips of the walker are in it is replaced.
        seed: the same seed makes the same bytes.
        minutes: length of all clips together, mirrors included.

    Raises:
        MotionError: the folder holds something else, or the clips would be too short for a gait cycle.
    """
    foreign = (
        sorted(path.name for path in folder.iterdir() if not path.name.startswith((PREFIX, MADE_UP)))
        if folder.exists()
        else []
    )
    if foreign:
        message = f"{folder}: holds '{foreign[0]}', which is not a clip of the walker: give a folder of its own"
        raise MotionError(message)
    seconds = 60 * minutes / (2 * len(SCRIPTS))
    generators = np.random.default_rng(seed).spawn(len(SCRIPTS))
    with atomic_path(folder) as temporary:
        for (name, script), generator in zip(SCRIPTS.items(), generators, strict=True):
            clip = walk(f"{PREFIX}_{name}", script, seconds, generator)
            write_clip(temporary, clip)
            write_clip(temporary, mirrored(clip))
        write_json(temporary / MADE_UP, {"program": "walker", "seed": seed, "minutes": minutes})
