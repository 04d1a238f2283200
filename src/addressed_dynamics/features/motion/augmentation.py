"""Inputs of motion made worse on purpose, so that a model recovers from its own errors in a closed loop."""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from addressed_dynamics.base.torch_runtime import sent
from addressed_dynamics.episodes.layout import INPUT, INPUT_GAITS
from addressed_dynamics.features.motion.features import MotionFeatures
from addressed_dynamics.sources.motion.params import AugmentationParams

JOINTS = INPUT.span("joint_position", "joint_velocity")


@dataclass(frozen=True)
class MotionAugmentation:
    """An `Augment`: mixes poses, shrinks them, adds noise to them, and swaps gaits; what is asked for stays the same.

    Predicted poses that are off are what a closed loop feeds back. Where data have a pose for every input a network may
    copy what it is given; asked for the true pose from one that is off, it learns to return to the motion.
    """

    features: MotionFeatures
    """How inputs and targets are normalised."""
    frames: Float[Tensor, "frame input"]
    """Normalised inputs to take poses and gaits from: those of the training frames."""
    params: AugmentationParams
    """How much of each."""

    def __call__(
        self, x: Float[Tensor, "*batch input"], y: Float[Tensor, "*batch output"], generator: torch.Generator
    ) -> tuple[Float[Tensor, "*batch input"], Float[Tensor, "*batch output"]]:
        """Return inputs that are off, and the targets that lead from them to the frames' outputs.

        What is random is drawn on the CPU, wherever `x` and `y` are.
        """
        batch, device = x.shape[:-1], x.device
        x_off = x.clone()
        if self.params.gait_swap:
            swapped = sent(torch.rand((*batch, 1), generator=generator) < self.params.gait_swap, device)
            gaits = self._others(batch, generator, device)[..., INPUT_GAITS]
            x_off[..., INPUT_GAITS] = torch.where(swapped, gaits, x[..., INPUT_GAITS])
        if self.params.pose_mix:
            share = sent(self.params.pose_mix * torch.rand((*batch, 1), generator=generator), device)
            others = self._others(batch, generator, device)
            x_off[..., JOINTS] = torch.lerp(x[..., JOINTS], others[..., JOINTS], share)
        if self.params.pose_shrink:
            left = 1.0 - self.params.pose_shrink * torch.rand((*batch, 1), generator=generator)
            x_off[..., JOINTS] *= sent(left, device)
        if self.params.pose_noise:
            size = self.params.pose_noise * self.features.joint_input_weight
            noise = torch.randn(x[..., JOINTS].shape, generator=generator)
            x_off[..., JOINTS] += sent(size * noise, device)
        return x_off, self.features.retarget(x, x_off, y)

    def _others(
        self, batch: torch.Size, generator: torch.Generator, device: torch.device
    ) -> Float[Tensor, "*batch input"]:
        drawn = sent(torch.randint(0, len(self.frames), batch, generator=generator), device)
        if device not in self._elsewhere:
            self._elsewhere[device] = self.frames.to(device)
        return self._elsewhere[device][drawn]

    @cached_property
    def _elsewhere(self) -> dict[torch.device, Tensor]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is on a GPU: another process may have none."""
        return {each.name: getattr(self, each.name) for each in fields(self)}
