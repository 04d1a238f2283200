"""Courses of transitions: from a state through states of a network's own, under the recorded actions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import torch
from jaxtyping import Float, Int, Int64
from torch import Tensor

from addressed_dynamics.features.common.courses import Unrolled

if TYPE_CHECKING:
    from addressed_dynamics.features.transitions.spec import FeatureSpec


@final
@dataclass(frozen=True)
class TransitionCourses:
    """What follows each sample of some transitions in its episode; see `Courses`."""

    features: FeatureSpec
    """From outputs to states and back to inputs."""
    frames: Float[Tensor, "row frame"]
    """Normalised frames of all rows."""
    observation: Float[Tensor, "row observation"]
    """States of all rows, in the environment's units."""
    next_observation: Float[Tensor, "row observation"]
    """States after them."""
    first: Int[Tensor, " sample"]
    """The row of each sample."""
    last: Int[Tensor, " sample"]
    """The last row of its episode."""

    def to(self, device: torch.device) -> TransitionCourses:
        """Return the same on a device."""
        tensors = (self.frames, self.observation, self.next_observation, self.first, self.last)
        return TransitionCourses(self.features, *(each.to(device) for each in tensors))

    def steps(self, samples: Int64[Tensor, "*batch"]) -> Int64[Tensor, "*batch"]:
        """Return how many steps in a row are known from each sample on: its own, and all to the end of its episode."""
        return self.last[samples] - self.first[samples] + 1

    def unroll(
        self, network: Callable[[Tensor], Tensor], samples: Int64[Tensor, "member sample"], horizon: int
    ) -> Unrolled:
        """Return what networks put out in `horizon` steps in a row, and what would have been right; see `Courses`."""
        features, last = self.features, self.last[samples].unsqueeze(1)
        device = samples.device
        steps, before = torch.arange(horizon, device=device), torch.arange(1 - features.history, 1, device=device)
        rows = torch.minimum(self.first[samples].unsqueeze(1) + steps.unsqueeze(1), last)
        state = self.observation[rows[:, 0]]
        window = self.frames[rows[:, 0].unsqueeze(-1) + before]
        states, outputs = list[Tensor](), list[Tensor]()
        for step, frames in enumerate(self.frames[rows].unbind(dim=1)):
            if step:
                state = features.decode(outputs[-1], state)
                frame = features.with_states(frames, state).unsqueeze(-2)
                window = frame if features.history == 1 else torch.cat([window[..., 1:, :], frame], dim=-2)
            states.append(state)
            outputs.append(network(features.join(window if features.history > 1 else window.squeeze(-2))))
        return torch.stack(outputs, dim=1), features.encode_target(
            torch.stack(states, dim=1), self.next_observation[rows]
        )
