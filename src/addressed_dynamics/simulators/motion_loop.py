"""A frame of the closed loop of motion: a model on its own predictions, under commands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.episodes.layout import OUTPUT
from addressed_dynamics.features.motion.features import MotionFeatures
from addressed_dynamics.simulators.motion_controller import Commands, Pose, State, advance, follow, inputs, keep, pose
from addressed_dynamics.simulators.motion_predictor import MotionPredictor

FARTHEST = 1000.0
"""A run is dead once a joint is farther from the root than this, in cm, or an output is larger in its unit."""


class LoopFrame(NamedTuple):
    """What one frame of the closed loop makes of runs."""

    x: Float64[np.ndarray, "run 342"]
    """What the predictors were given."""
    y: Float64[np.ndarray, "run 311"]
    """What they answered; 0 of dead runs."""
    phase: Float32[np.ndarray, " run"]
    """What they were told of the phase."""
    alive: Bool[np.ndarray, " run"]
    """Which runs live."""
    shown: State
    """Where everybody is in this frame; a dead run stays where it was."""
    after: State
    """Where the next frame begins."""


def loop_frame(
    predictors: Mapping[str, MotionPredictor], state: State, commands: Commands, alive: Bool[np.ndarray, " run"]
) -> LoopFrame:
    """Advance runs by a frame, each as if it were alone.

    Args:
        predictors: the models, each of which moves as many runs as the others, in this order.
        state: where the runs are.
        commands: what is asked of them.
        alive: which of them live.

    Raises:
        EvaluationError: a predictor returns another shape.
    """
    following = follow(state, commands)
    x, phase = inputs(following), _phase(following)
    y = _predict(predictors, len(alive) // len(predictors), x, phase)
    living = alive & (np.abs(y) <= FARTHEST).all(axis=1)
    y[~living] = 0.0
    posed = pose(following, y)
    living &= _reach(posed) <= FARTHEST
    after = advance(posed, y)
    if living.all():
        return LoopFrame(x, y, phase, living, posed, after)
    return LoopFrame(x, y, phase, living, keep(state, posed, living), keep(state, after, living))


def mean_pose(features: MotionFeatures) -> Pose:
    """Return the mean pose of the frames that a model was trained on, with which the published controller begins.

    It is what a network means that answers the mean target to the mean input.
    """
    inputs = torch.tensor([features.input_mean])
    mean = features.decode(torch.zeros(1, features.outputs), inputs)[0].double().numpy()
    return Pose(mean[OUTPUT.joint_position].reshape(-1, 3), mean[OUTPUT.joint_velocity].reshape(-1, 3))


def _phase(state: State) -> Float32[np.ndarray, " run"]:
    phase = state.phase.astype(np.float32)
    # Rounding to single precision can reach 1, which is 0.
    phase[phase >= 1.0] = 0.0
    return phase


def _predict(
    predictors: Mapping[str, MotionPredictor],
    scripts: int,
    x: Float64[np.ndarray, "run 342"],
    phase: Float32[np.ndarray, " run"],
) -> Float64[np.ndarray, "run 311"]:
    y = np.empty((len(x), OUTPUT.width))
    given, at = torch.from_numpy(x).float(), torch.from_numpy(phase)
    for index, (name, predictor) in enumerate(predictors.items()):
        rows = slice(index * scripts, (index + 1) * scripts)
        predicted = predictor(given[rows], at[rows])
        if tuple(predicted.shape) != (scripts, OUTPUT.width):
            message = (
                f"predictor '{name}' should return outputs of shape ({scripts}, {OUTPUT.width}), "
                f"but returned {tuple(predicted.shape)}"
            )
            raise EvaluationError(message)
        y[rows] = predicted.double().numpy()
    return y


def _reach(state: State) -> Float64[np.ndarray, " run"]:
    """Return how far the farthest joint is from the root, in cm."""
    apart = np.maximum(np.abs(state.joint_ground - state.root[:, None]), np.abs(state.joint_height))
    farthest: Float64[np.ndarray, " run"] = apart.max(axis=1)
    return farthest
