"""Judging a trace: does the character do what it is told, does it move like a living one, does it stay whole?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex128, Float64

from addressed_dynamics.episodes.layout import FRAME_RATE
from addressed_dynamics.evaluation.motion.closed_loop.commands import KINDS, Script
from addressed_dynamics.evaluation.motion.closed_loop.measures import (
    HIPS,
    TOUCHING,
    MotionReference,
    bone_drift,
    foot_speeds,
    limb_speed,
    mean_or_none,
    smoothed_velocity,
)
from addressed_dynamics.evaluation.motion.closed_loop.run import Trace

SETTLING = FRAME_RATE
"""Frames at the beginning of a segment that do not count: nobody follows a command at once."""
CYCLE = 30
"""Frames over which velocities are averaged: about a step, within which the hips swing."""
FROZEN_SPEED = 10.0
"""Limbs slower than this, in cm/s, on average over `CYCLE` frames, are frozen."""
ALIVE_SHARE = 0.9
"""A run is alive if it lasts to the end and of the frames in which it should move at most the rest is frozen, and as
many have the hips at a plausible height."""


@dataclass(frozen=True)
class KindJudgement:
    """How a run did while one kind of thing was asked for; speeds in cm/s, angles in degrees.

    Only frames count that are settled and before the run died. All figures are None if there are none.
    """

    kind: str
    """One of `commands.KINDS`, or `moving` (all but standing), or `all`."""
    frames: int
    """Frames that count."""
    lost: int
    """Settled frames that came after the run's death."""
    commanded_speed: float | None = None
    speed: float | None = None
    """Mean speed of the root."""
    speed_ratio: float | None = None
    """Speed as a share of the commanded; None if none is."""
    speed_error: float | None = None
    """Mean |speed - commanded speed|."""
    velocity_error: float | None = None
    """Mean length of velocity - commanded velocity."""
    facing_error: float | None = None
    """Mean angle between where the root faces and the command; None where nothing is."""
    course_error: float | None = None
    """Mean angle between where the root goes and the command; 90 for a root that goes nowhere."""
    limb_speed: float | None = None
    """Mean speed of the joints relative to the root."""
    frozen_share: float | None = None
    """Share of frames with frozen limbs."""
    skate_speed: float | None = None
    """Mean speed along the ground of feet that the model says touch it; None if it never says so."""
    contact_share: float | None = None
    """Share of heels and toes that touch the ground, as the model says."""
    slowest_foot_speed: float | None = None
    """Mean speed along the ground of the slowest of heels and toes, whatever the model says of contacts."""
    bone_drift: float | None = None
    """Mean share by which bones are too long or too short."""
    plausible_height_share: float | None = None
    """Share of frames with the hips at a height that occurs in recorded motion."""


@dataclass(frozen=True)
class RunJudgement:
    """How a run did."""

    seconds: float
    """Length of the script."""
    lived_seconds: float
    """How long all values were finite and no joint flew off."""
    alive: bool
    """Whether it lasted, moved when it should, and kept its height (`ALIVE_SHARE`)."""
    largest_bone_drift: float | None
    """The worst bone in the worst frame, as a share of its length."""
    kinds: tuple[KindJudgement, ...]
    """Everything, all that moves, and each kind that occurs."""

    def of(self, kind: str) -> KindJudgement:
        """Return the judgement of one kind; one of no frames if it does not occur."""
        return next((each for each in self.kinds if each.kind == kind), KindJudgement(kind, 0, 0))


@dataclass(frozen=True)
class Course:
    """What a run did, frame by frame: the last frame is left out, for velocities lead to the next."""

    velocity: Complex128[np.ndarray, " frame"]
    """Of the root, averaged over `CYCLE` frames, in cm/s (`simulators.motion_ground`)."""
    commanded: Complex128[np.ndarray, " frame"]
    """In cm/s."""
    facing_error: Float64[np.ndarray, " frame"]
    """In degrees, as the next."""
    course_error: Float64[np.ndarray, " frame"]
    limb_speed: Float64[np.ndarray, " frame"]
    """In cm/s, as the speed of feet."""
    frozen: Bool[np.ndarray, " frame"]
    foot_speed: Float64[np.ndarray, "frame 4"]
    touching: Bool[np.ndarray, "frame 4"]
    """Whether a foot touches the ground, as the model says."""
    bone_drift: Float64[np.ndarray, "frame bone"]
    """Share of its length by which a bone is too long or too short."""
    plausible_height: Bool[np.ndarray, " frame"]
    settled: Bool[np.ndarray, " frame"]
    """Whether it is long enough since the command changed, and before it changes."""
    living: Bool[np.ndarray, " frame"]

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what a figure shows over time."""
        return {
            "speed": np.abs(self.velocity),
            "commanded_speed": np.abs(self.commanded),
            "facing_error": self.facing_error,
            "limb_speed": self.limb_speed,
            "slowest_foot_speed": self.foot_speed.min(axis=1),
            "bone_drift": self.bone_drift.mean(axis=1),
            "living": self.living,
        }


def courses(trace: Trace, reference: MotionReference) -> tuple[Course, ...]:
    """Measure every run of a trace, frame by frame."""
    return tuple(_course(trace, run, reference) for run in range(len(trace.scripts)))


def judge(trace: Trace, reference: MotionReference) -> tuple[RunJudgement, ...]:
    """Judge every run of a trace.

    Args:
        trace: what a model made of the scripts.
        reference: recorded motion, for the lengths of bones and the height of hips.
    """
    return tuple(
        _judged(course, script, int(lived))
        for course, script, lived in zip(courses(trace, reference), trace.scripts, trace.lived, strict=True)
    )


def _course(trace: Trace, run: int, reference: MotionReference) -> Course:
    script, root, last = trace.scripts[run], trace.root[run], -1
    joints = trace.joint_position[run].astype(np.float64)
    velocity = np.diff(joints, axis=0)
    commanded = script.velocity[:last]
    averaged = smoothed_velocity(root, CYCLE)[:last]
    moving = np.abs(commanded) > 0
    ahead = np.where(moving, commanded, script.facing[:last])
    limbs = limb_speed(velocity, np.diff(root))
    return Course(
        velocity=averaged * FRAME_RATE,
        commanded=commanded * FRAME_RATE,
        facing_error=_apart(trace.heading[run, :last], ahead),
        course_error=np.where(np.abs(averaged) * FRAME_RATE < 1.0, 90.0, _apart(averaged, ahead)),
        limb_speed=limbs,
        frozen=_averaged(limbs, CYCLE) < FROZEN_SPEED,
        foot_speed=foot_speeds(velocity),
        touching=trace.contact[run, :last] > TOUCHING,
        bone_drift=bone_drift(joints[:last], reference),
        plausible_height=_between(joints[:last, HIPS, 1], reference.lowest_hips, reference.highest_hips),
        settled=_settled(script)[:last],
        # The velocity of the last frame before death leads into the frozen pose.
        living=np.arange(len(script) - 1) < trace.lived[run] - 1,
    )


def _judged(course: Course, script: Script, lived: int) -> RunJudgement:
    kinds = np.array([script.segments[index].kind for index in script.segment[:-1]])
    groups = {"all": kinds != "", "moving": kinds != "stand"} | {kind: kinds == kind for kind in KINDS}
    judged = {name: _of_kind(course, name, frames) for name, frames in groups.items() if frames.any()}
    moving = judged.get("moving", KindJudgement("moving", 0, 0))
    drift = course.bone_drift[course.living]
    alive = (
        lived == len(script)
        and (moving.frozen_share or 0.0) <= 1.0 - ALIVE_SHARE
        and (judged["all"].plausible_height_share or 0.0) >= ALIVE_SHARE
    )
    return RunJudgement(
        seconds=len(script) / FRAME_RATE,
        lived_seconds=lived / FRAME_RATE,
        alive=alive,
        largest_bone_drift=float(drift.max()) if drift.size else None,
        kinds=tuple(judged.values()),
    )


def _of_kind(course: Course, kind: str, frames: Bool[np.ndarray, " frame"]) -> KindJudgement:
    settled = frames & course.settled
    rows = settled & course.living
    lost = int((settled & ~course.living).sum())
    if not rows.any():
        return KindJudgement(kind, 0, lost)
    velocity, commanded = course.velocity[rows], course.commanded[rows]
    speed, asked = np.abs(velocity), np.abs(commanded)
    moving = asked > 0
    return KindJudgement(
        kind=kind,
        frames=int(rows.sum()),
        lost=lost,
        commanded_speed=float(asked.mean()),
        speed=float(speed.mean()),
        speed_ratio=float(speed[moving].mean() / asked[moving].mean()) if moving.any() else None,
        speed_error=float(np.abs(speed - asked).mean()),
        velocity_error=float(np.abs(velocity - commanded).mean()),
        facing_error=mean_or_none(course.facing_error[rows][moving]),
        course_error=mean_or_none(course.course_error[rows][moving]),
        limb_speed=float(course.limb_speed[rows].mean()),
        frozen_share=float(course.frozen[rows].mean()),
        skate_speed=mean_or_none(course.foot_speed[rows][course.touching[rows]]),
        contact_share=float(course.touching[rows].mean()),
        slowest_foot_speed=float(course.foot_speed[rows].min(axis=1).mean()),
        bone_drift=float(course.bone_drift[rows].mean()),
        plausible_height_share=float(course.plausible_height[rows].mean()),
    )


def _settled(script: Script) -> Bool[np.ndarray, " frame"]:
    """Return which frames come at least `SETTLING` after their segment's first, and are averaged within it."""
    frames = np.arange(len(script))
    begins = np.flatnonzero(np.diff(script.segment, prepend=-1))
    ends = np.append(begins[1:], len(script))
    settled: Bool[np.ndarray, " frame"] = (frames - begins[script.segment] >= SETTLING) & (
        frames + CYCLE // 2 < ends[script.segment]
    )
    return settled


def _apart(first: np.ndarray, second: np.ndarray) -> Float64[np.ndarray, " frame"]:
    apart: Float64[np.ndarray, " frame"] = np.degrees(np.abs(np.angle(first * second.conj())))
    return apart


def _averaged(values: Float64[np.ndarray, " frame"], window: int) -> Float64[np.ndarray, " frame"]:
    """Return the mean over the `window` frames around each frame, fewer at the ends."""
    summed = np.append(0.0, np.cumsum(values))
    frames = np.arange(len(values))
    first, after = np.maximum(frames - window // 2, 0), np.minimum(frames + window // 2, len(values) - 1) + 1
    averaged: Float64[np.ndarray, " frame"] = (summed[after] - summed[first]) / (after - first)
    return averaged


def _between(values: Float64[np.ndarray, " frame"], low: float, high: float) -> Bool[np.ndarray, " frame"]:
    inside: Bool[np.ndarray, " frame"] = (values >= low) & (values <= high)
    return inside
