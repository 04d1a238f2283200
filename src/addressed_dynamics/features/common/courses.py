"""How it goes on after a sample, so that a network can be held to what its own predictions lead to."""

from collections.abc import Callable
from typing import Protocol, Self

import torch
from jaxtyping import Float, Int64
from torch import Tensor

Unrolled = tuple[Float[Tensor, "member step sample output"], Float[Tensor, "member step sample output"]]
"""What networks put out in each of several steps in a row, and what would have been right."""


class Courses(Protocol):
    """What follows each sample in its episode."""

    def to(self, device: torch.device) -> Self:
        """Return the same on a device."""
        ...

    def steps(self, samples: Int64[Tensor, "*batch"]) -> Int64[Tensor, "*batch"]:
        """Return how many steps in a row are known from each sample on: its own, and all to the end of its episode."""
        ...

    def unroll(
        self, network: Callable[[Tensor], Tensor], samples: Int64[Tensor, "member sample"], horizon: int
    ) -> Unrolled:
        """Return what networks put out in `horizon` steps in a row, and what would have been right.

        The first step is that of the samples; in the later ones the networks are given the states that they predicted
        themselves, beside the recorded actions and exogenous inputs, and what is right leads from there to the recorded
        next state. Steps beyond those that `steps` counts repeat the last one, and mean nothing. All is differentiable.

        Args:
            network: (member, sample, input) -> (member, sample, output).
            samples: where each member begins.
            horizon: number of steps.
        """
        ...
