"""What the earlier stages measured of an experiment of motion, read and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.evaluation.motion.records import MotionEvaluation
from addressed_dynamics.reporting.common.missing import remedy_of
from addressed_dynamics.reporting.common.results import Results, read_results
from addressed_dynamics.reporting.motion.recorded import MotionData


@dataclass(frozen=True)
class Loop:
    """The closed loop of one model under the test script; what leads to the next frame is one shorter."""

    joint_position: Float[np.ndarray, "time 31 3"]
    """In the world, in cm."""
    root_position: Float[np.ndarray, "time 2"]
    """x and z, in cm."""
    commanded_velocity: Float[np.ndarray, "time 2"]
    """x and z, in cm/frame."""
    contact: Float[np.ndarray, "time 4"]
    """Probability that each of `layout.CONTACTS` touches the ground."""
    speed: Float[np.ndarray, " step"]
    """Of the root over half a second, in cm/s, as all speeds that follow."""
    commanded_speed: Float[np.ndarray, " step"]
    facing_error: Float[np.ndarray, " step"]
    """In degrees."""
    limb_speed: Float[np.ndarray, " step"]
    slowest_foot_speed: Float[np.ndarray, " step"]
    bone_drift: Float[np.ndarray, " step"]
    """Mean share by which bones are too long or too short."""
    living: Bool[np.ndarray, " step"]


@dataclass(frozen=True)
class MotionArrays:
    """arrays.npz: what the figures show."""

    true: Float[np.ndarray, "time joint 3"]
    """Hips and head over the first frames of a held-out clip, in the frame of the root, in cm."""
    frames: Mapping[str, Float[np.ndarray, "time joint 3"]]
    """What each model predicts of them one step ahead, by its name."""
    loops: Mapping[str, Loop]
    """The closed loop of each."""


@dataclass(frozen=True)
class MotionResults(Results[MotionData, MotionEvaluation, MotionArrays]):
    """All that a report is made from."""


def load_motion_results(figures: Path, evaluation: Path) -> MotionResults:
    """Read what the stages before the report wrote.

    Args:
        figures: folder of what the stages before the evaluation found, one folder a stage.
        evaluation: folder of what the evaluation found.

    Raises:
        ReportError: a file is missing or malformed.
    """
    results = MotionResults(**read_results(figures, evaluation, MotionData, MotionEvaluation, _arrays))
    own = results.evaluation.own_name
    if own not in results.arrays.loops:
        path = evaluation / "arrays.npz"
        message = f"{path}: there is nothing of {own}; run evaluate again ('{remedy_of(path)}')"
        raise ReportError(message)
    return results


def _arrays(file: Mapping[str, np.ndarray]) -> MotionArrays:
    names = [name.removeprefix("frames.") for name in file if name.startswith("frames.")]
    names.remove("true")
    return MotionArrays(
        file["frames.true"],
        {name: file[f"frames.{name}"] for name in names},
        {name: Loop(**{each.name: file[f"loop.{name}.{each.name}"] for each in fields(Loop)}) for name in names},
    )
