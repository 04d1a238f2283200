"""One-step errors of predictors of motion: in each column's unit and in units of its deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.episodes.layout import JOINTS, OUTPUT
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.evaluation.motion.unit_errors import UNITS, UnitError, unit_errors
from addressed_dynamics.simulators.motion_predictor import MotionPredictor

SMALLEST_DEVIATION = 1e-3
"""Errors are divided by no less than this: columns that never change would have infinite errors."""
CHUNK_ROWS = 4096
"""Rows predicted at once."""


@dataclass(frozen=True)
class BlockError:
    """Mean absolute error of a block of outputs."""

    block: str
    """One of `layout.OUTPUT`."""
    unit: str
    columns: int
    raw: float
    """In the block's unit."""
    normalised: float
    """In units of the deviation of each column."""


@dataclass(frozen=True)
class JointError:
    """How far a joint is from where it was, and its velocity from what it was: mean lengths of the difference."""

    joint: str
    position: float
    """In cm."""
    velocity: float
    """In cm/frame."""


@dataclass(frozen=True)
class OneStepErrors:
    """Errors of one predictor on the rows of some motion."""

    rows: int
    raw: float
    """Mean absolute error over all 311 outputs, whatever their units: the paper's figure."""
    normalised: float
    """The same in units of the deviation of each output."""
    blocks: tuple[BlockError, ...]
    joints: tuple[JointError, ...]
    units: tuple[UnitError, ...]
    """What the blocks are off by in cm, cm/s, degrees and so on, each as one would measure it."""


def one_step_errors(predictor: MotionPredictor, motion: Motion, deviation: Float[np.ndarray, " 311"]) -> OneStepErrors:
    """Return the errors of a predictor on every row of `motion`.

    Args:
        predictor: the model.
        motion: the rows; a phase of 1 is given to the model as 0, which is the same.
        deviation: of each output over the training rows, floored here at `SMALLEST_DEVIATION`. Take deviations that are
            averaged over blocks, as networks are trained with (`block_deviation`), or constant columns dominate.

    Raises:
        EvaluationError: there are no rows, a deviation is not a positive number, or a prediction is not finite or has
            another shape.
    """
    if not len(motion):
        message = "there are no frames of motion to evaluate a model on"
        raise EvaluationError(message)
    if np.shape(deviation) != (OUTPUT.width,) or not np.isfinite(deviation).all() or np.min(deviation) < 0:
        message = f"deviations should be {OUTPUT.width} numbers of at least 0, but have shape {np.shape(deviation)}"
        raise EvaluationError(message)
    absolute = np.zeros(OUTPUT.width)
    distances = {"joint_position": np.zeros(len(JOINTS)), "joint_velocity": np.zeros(len(JOINTS))}
    units = dict.fromkeys(UNITS, 0.0)
    for first in range(0, len(motion), CHUNK_ROWS):
        rows = slice(first, first + CHUNK_ROWS)
        predicted, true = _predicted(predictor, motion, rows), motion.y[rows].astype(np.float64)
        error = predicted - true
        absolute += np.abs(error).sum(axis=0)
        for name, total in distances.items():
            total += np.linalg.norm(error[:, OUTPUT[name]].reshape(len(error), -1, 3), axis=-1).sum(axis=0)
        for name, each in unit_errors(predicted, true).items():
            units[name] += float(each.sum())
    return _summary(len(motion), absolute / len(motion), distances, units, np.asarray(deviation, np.float64))


def block_deviation(y: Float[np.ndarray, "row 311"]) -> Float64[np.ndarray, " 311"]:
    """Return the standard deviation of every output, averaged over its block, as PFNN is trained with.

    x and z of a trajectory make one block.
    """
    own = y.std(axis=0, dtype=np.float64)
    deviation = np.empty(OUTPUT.width)
    groups: dict[str, list[int]] = {}
    for index, name in enumerate(OUTPUT.names):
        groups.setdefault(name.split(".")[0].removesuffix("_x").removesuffix("_z"), []).append(index)
    for columns in groups.values():
        deviation[columns] = own[columns].mean()
    return deviation


def _predicted(predictor: MotionPredictor, motion: Motion, rows: slice) -> Float64[np.ndarray, "row 311"]:
    x, phase = torch.from_numpy(motion.x[rows]), torch.from_numpy(motion.phase[rows]) % 1.0
    with torch.inference_mode():
        predicted = predictor(x, phase)
    if tuple(predicted.shape) != (len(x), OUTPUT.width):
        message = (
            f"a predictor of motion should return outputs of shape ({len(x)}, {OUTPUT.width}), "
            f"but returned {tuple(predicted.shape)}"
        )
        raise EvaluationError(message)
    if not torch.isfinite(predicted).all():
        message = "a model predicts motion that is not finite: its training diverged"
        raise EvaluationError(message)
    values: Float64[np.ndarray, "row 311"] = predicted.double().numpy()
    return values


def _summary(
    rows: int,
    raw: Float64[np.ndarray, " 311"],
    distances: dict[str, Float64[np.ndarray, " joint"]],
    units: dict[str, float],
    deviation: Float64[np.ndarray, " 311"],
) -> OneStepErrors:
    normalised = raw / np.maximum(deviation, SMALLEST_DEVIATION)
    return OneStepErrors(
        rows=rows,
        raw=float(raw.mean()),
        normalised=float(normalised.mean()),
        blocks=tuple(
            BlockError(
                block=block.name,
                unit=block.unit,
                columns=len(block.columns),
                raw=float(raw[OUTPUT[block.name]].mean()),
                normalised=float(normalised[OUTPUT[block.name]].mean()),
            )
            for block in OUTPUT.blocks
        ),
        joints=tuple(
            JointError(joint, float(position) / rows, float(velocity) / rows)
            for joint, position, velocity in zip(
                JOINTS, distances["joint_position"], distances["joint_velocity"], strict=True
            )
        ),
        units=tuple(UnitError(name, UNITS[name], total / rows) for name, total in units.items()),
    )
