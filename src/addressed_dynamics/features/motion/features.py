"""MotionFeatures: from frames of motion to a network's inputs and targets, and from its outputs back to frames.

Normalisation is that of phase-functioned neural networks: every column has its own mean, the columns of a group share
one deviation, and the joints' inputs are made small.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from addressed_dynamics.base.errors import ModelError, MotionError
from addressed_dynamics.episodes.layout import GAITS, INPUT, NOW, OFFSETS, OUTPUT, Layout
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.sources.motion.params import MotionFeatureParams

INPUT_GROUPS = (
    ("trajectory_position_x",), ("trajectory_position_z",), ("trajectory_direction_x",), ("trajectory_direction_z",),
    tuple(f"gait_{gait}" for gait in GAITS), ("joint_position",), ("joint_velocity",),
    ("height_right", "height_centre", "height_left"),
)  # fmt: skip
"""Blocks of inputs that are divided by one deviation."""
OUTPUT_GROUPS = (
    ("root_velocity",), ("root_turn",), ("phase_change",), ("contact",),
    ("trajectory_position_x", "trajectory_position_z"), ("trajectory_direction_x", "trajectory_direction_z"),
    ("joint_position",), ("joint_velocity",), ("joint_rotation",),
)  # fmt: skip
"""Blocks of outputs that are divided by one deviation."""
Target = Literal["absolute", "change", "trajectory_change"]
TARGETS: tuple[Target, ...] = get_args(Target)
"""What networks may be asked for; `MotionFeatureParams.target` says what these are."""
JOINT_INPUTS = ("joint_position", "joint_velocity")
"""Blocks of inputs that are made small."""
INPUT_FLOORS = {"cm": 1.0, "cm/frame": 0.1, "": 0.01}
"""Least deviation of a group of inputs, by unit: on flat ground all heights are 0, and a first slope must not become an
input of 1e14."""
TARGET_FLOORS = {"cm": 0.01, "cm/frame": 1e-3, "rad": 1e-3, "rad/frame": 1e-4, "": 1e-4}
"""Least deviation of a group of targets, by unit; what a joint adds to persistence is small."""
_TRAJECTORY = ("trajectory_position_x", "trajectory_position_z", "trajectory_direction_x", "trajectory_direction_z")
_AGO = OFFSETS[NOW] - OFFSETS[NOW - 1]


class _Constants(NamedTuple):
    """The numbers of `MotionFeatures` as tensors, float32."""

    input_mean: Float[Tensor, " input"]
    input_scale: Float[Tensor, " input"]
    target_mean: Float[Tensor, " output"]
    target_deviation: Float[Tensor, " output"]


@dataclass(frozen=True)
class MotionFeatures:
    """How the networks of one motion model see frames. Make one with `fit_motion_features`.

    A network is given (x - input_mean) / input_deviation, its joint columns times `joint_input_weight`, and is asked
    for (t - target_mean) / target_deviation, where t is an output y, or what y adds to `persistence(x)`.
    """

    target: Target
    """Whether a network is asked for the outputs, or for what they (or their trajectory alone) add to persistence."""
    joint_input_weight: float
    """Size of the normalised joint inputs."""
    input_mean: tuple[float, ...]
    """Mean of each input over the training frames, in the unit that `layout.INPUT` gives."""
    input_deviation: tuple[float, ...]
    """Deviation of each input, the mean over its group, floored."""
    target_mean: tuple[float, ...]
    """Mean of each target, in the unit that `layout.OUTPUT` gives."""
    target_deviation: tuple[float, ...]
    """Deviation of each target, the mean over its group, floored."""

    @property
    def params(self) -> MotionFeatureParams:
        """The params that it was made with."""
        return MotionFeatureParams(target=self.target, joint_input_weight=self.joint_input_weight)

    @property
    def history(self) -> int:
        """Number of frames that a network is given: 1, for a frame of motion holds its trajectory."""
        return 1

    @property
    def inputs(self) -> int:
        """Number of inputs of a network."""
        return len(self.input_mean)

    @property
    def outputs(self) -> int:
        """Number of outputs of a network."""
        return len(self.target_mean)

    def encode(self, x: Float[Tensor, "row 342"]) -> Float[Tensor, "row input"]:
        """Return normalised inputs for the inputs of frames.

        Raises:
            ModelError: they do not have the columns of `layout.INPUT`.
        """
        if x.ndim != 2 or x.shape[1] != self.inputs:
            message = f"inputs of frames should have shape (B, {self.inputs}), but have {tuple(x.shape)}"
            raise ModelError(message)
        of = self._beside(x)
        return (x.to(torch.float32) - of.input_mean) * of.input_scale

    def encode_target(self, x: Float[Tensor, "row 342"], y: Float[Tensor, "row 311"]) -> Float[Tensor, "row output"]:
        """Return the normalised targets of frames with inputs `x` and outputs `y`."""
        base = _base(x, self.target)
        target = y if base is None else y - base
        of = self._beside(target)
        return (target - of.target_mean) / of.target_deviation

    def decode(
        self, output: Float[Tensor, "*member row output"], x: Float[Tensor, "row 342"]
    ) -> Float[Tensor, "*member row 311"]:
        """Return the outputs of frames, in their own units, that a network means which was given `x`."""
        of = self._beside(output)
        target = output * of.target_deviation + of.target_mean
        base = _base(x, self.target)
        return target if base is None else target + base

    def retarget(
        self,
        x: Float[Tensor, "*batch input"],
        x_other: Float[Tensor, "*batch input"],
        target: Float[Tensor, "*batch output"],
    ) -> Float[Tensor, "*batch output"]:
        """Return targets that mean the same outputs for normalised inputs `x_other` as `target` does for `x`."""
        of = self._beside(x)
        change = _base(((x_other - x) / of.input_scale).flatten(end_dim=-2), self.target)
        return target if change is None else target - change.view(target.shape) / of.target_deviation

    def samples(self, motion: Motion) -> Samples:
        """Return one sample for each frame of `motion`, in its order; an episode is a clip, a step a frame at 60 Hz."""
        x, y = torch.from_numpy(motion.x), torch.from_numpy(motion.y)
        _, clip = np.unique(motion.clip, return_inverse=True)
        return Samples(
            x=self.encode(x),
            y=self.encode_target(x, y),
            episode=torch.from_numpy(clip.astype(np.int64)),
            step=torch.from_numpy(motion.frame),
        )

    def loss_unit(self, loss: Literal["mse", "mae"]) -> float:  # noqa: ARG002 - the same for both; FeatureSpec's differ
        """Return 1: a network trains on the loss of normalised targets, which no single factor turns into another."""
        return 1.0

    def to_json(self) -> dict[str, Any]:
        """Return the features as JSON-compatible values."""
        return {"kind": "motion", **asdict(self)}

    @staticmethod
    def from_json(value: Any) -> MotionFeatures:
        """Read what `to_json` wrote.

        Raises:
            ModelError: `value` does not have that form.
        """
        try:
            features = MotionFeatures(
                target={name: name for name in TARGETS}[value["target"]],
                joint_input_weight=float(value["joint_input_weight"]),
                input_mean=tuple(map(float, value["input_mean"])),
                input_deviation=tuple(map(float, value["input_deviation"])),
                target_mean=tuple(map(float, value["target_mean"])),
                target_deviation=tuple(map(float, value["target_deviation"])),
            )
            features._check()
        except (KeyError, TypeError, ValueError) as error:
            message = f"the description of a motion model's features is incomplete or malformed ({error})"
            raise ModelError(message) from error
        return features

    def _check(self) -> None:
        for name, expected in {
            "input_mean": INPUT.width, "input_deviation": INPUT.width,
            "target_mean": OUTPUT.width, "target_deviation": OUTPUT.width,
        }.items():  # fmt: skip
            if len(getattr(self, name)) != expected:
                message = f"{name} should have {expected} numbers, but has {len(getattr(self, name))}"
                raise ValueError(message)

    # Made once: converting a thousand numbers costs more than a prediction's products, and a rollout has thousands.
    @cached_property
    def _constants(self) -> _Constants:
        scale = 1.0 / torch.tensor(self.input_deviation)
        for block in JOINT_INPUTS:
            scale[INPUT[block]] *= self.joint_input_weight
        return _Constants(
            torch.tensor(self.input_mean), scale, torch.tensor(self.target_mean), torch.tensor(self.target_deviation)
        )

    def _beside(self, values: Tensor) -> _Constants:
        """Return the numbers that frames are encoded and decoded with, where `values` are."""
        if values.is_cpu:
            return self._constants
        if values.device not in self._elsewhere:
            self._elsewhere[values.device] = _Constants(*(each.to(values.device) for each in self._constants))
        return self._elsewhere[values.device]

    @cached_property
    def _elsewhere(self) -> dict[torch.device, _Constants]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is made again when it is needed: another process may have no GPU."""
        return {each.name: getattr(self, each.name) for each in fields(self)}


def fit_motion_features(train: Motion, params: MotionFeatureParams) -> MotionFeatures:
    """Choose the normalisation from training frames alone.

    Raises:
        MotionError: there are no frames.
    """
    if not len(train):
        message = "there are no training frames to take statistics from: put more clips into the training split"
        raise MotionError(message)
    base = _base(torch.from_numpy(train.x), params.target)
    target = train.y.astype(np.float64) - (0.0 if base is None else base.numpy())
    x = train.x.astype(np.float64)
    return MotionFeatures(
        target=params.target,
        joint_input_weight=params.joint_input_weight,
        input_mean=tuple(x.mean(axis=0).tolist()),
        input_deviation=tuple(_deviations(x, INPUT, INPUT_GROUPS, INPUT_FLOORS).tolist()),
        target_mean=tuple(target.mean(axis=0).tolist()),
        target_deviation=tuple(_deviations(target, OUTPUT, OUTPUT_GROUPS, TARGET_FLOORS).tolist()),
    )


def persistence(x: Float[Tensor, "row 342"]) -> Float[Tensor, "row 311"]:
    """Return the outputs of a character that goes on as it does; 0 where no input says anything of an output.

    Joints keep their velocity, so their positions move by it, less the root's own step, which is taken from the
    trajectory of the last ten frames; the future trajectory, seen from the root, stays as it is.
    """
    y = _same_trajectory(x)
    velocity = x[:, INPUT.joint_velocity]
    step_x = -x[:, INPUT.trajectory_position_x][:, NOW - 1] / _AGO
    step_z = -x[:, INPUT.trajectory_position_z][:, NOW - 1] / _AGO
    step = torch.stack([step_x, torch.zeros_like(step_x), step_z], dim=1)
    y[:, OUTPUT.joint_position] = x[:, INPUT.joint_position] + velocity - step.repeat(1, velocity.shape[1] // 3)
    y[:, OUTPUT.joint_velocity] = velocity
    return y


def _base(x: Float[Tensor, "row 342"], target: Target) -> Float[Tensor, "row 311"] | None:
    """Return what a target is added to; None if that is nothing. It is linear in `x`."""
    match target:
        case "absolute":
            return None
        case "trajectory_change":
            return _same_trajectory(x)
        case "change":
            return persistence(x)


def _same_trajectory(x: Float[Tensor, "row 342"]) -> Float[Tensor, "row 311"]:
    """Return outputs whose future trajectory, seen from the root, is the given one; 0 in all other columns."""
    y = x.new_zeros(x.shape[0], OUTPUT.width)
    for block in _TRAJECTORY:
        y[:, OUTPUT[block]] = x[:, INPUT[block]][:, NOW:]
    return y


def _deviations(
    values: Float64[np.ndarray, "row column"],
    layout: Layout,
    groups: tuple[tuple[str, ...], ...],
    floors: dict[str, float],
) -> Float64[np.ndarray, " column"]:
    """Return each column's deviation: the mean over its group's, floored by the group's unit."""
    own, units = values.std(axis=0), layout.units
    shared = np.zeros(layout.width)
    for group in groups:
        deviation = np.concatenate([own[layout[block]] for block in group]).mean()
        for block in group:
            columns = layout[block]
            shared[columns] = max(deviation, floors[units[columns.start]])
    return shared
