"""Adam on one flat tensor, of which the parameters are views."""

import math
from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.optim.adam import adam

from addressed_dynamics.base.params.sections import OptimiserParams


class FlatAdam:
    """Adam whose learning rate follows its schedule. The parameters become views of one tensor and change in place."""

    def __init__(
        self,
        parameters: Iterable[nn.Parameter],
        optimiser: OptimiserParams,
        total_updates: int,
        *,
        weight_decay: float = 0.0,
        undecayed: Iterable[nn.Parameter] = (),
    ) -> None:
        """Prepare for `total_updates` updates.

        Args:
            parameters: what is trained.
            optimiser: how.
            total_updates: number of updates to come.
            weight_decay: share of the learning rate by which `parameters` shrink in each update (AdamW).
            undecayed: what is trained too, but does not shrink; in `values` and `gradients` they come last.
        """
        own = list(parameters)
        decayed = sum(parameter.numel() for parameter in own)
        own += undecayed
        self._weight_decay = weight_decay
        self._schedule = optimiser
        self._total_updates = total_updates
        self.updates = 0
        self._flat = torch.cat([parameter.detach().flatten() for parameter in own])
        self._decayed = self._flat[:decayed]
        self.gradient = torch.zeros_like(self._flat)
        """All gradients as one tensor."""
        self._first_moment, self._second_moment = torch.zeros_like(self._flat), torch.zeros_like(self._flat)
        # On a GPU what changes from update to update lies there, too: an update may be one graph.
        self._adam_step = torch.zeros((), device=self._flat.device)
        self._rate = None if self._flat.is_cpu else torch.zeros((), device=self._flat.device)
        shapes = [parameter.shape for parameter in own]
        self.values: list[Float[Tensor, ...]] = _views(self._flat, shapes)
        """The parameters, without autograd's bookkeeping."""
        self.gradients: list[Float[Tensor, ...]] = _views(self.gradient, shapes)
        """Where `step` expects their gradients."""
        for parameter, view in zip(own, self.values, strict=True):
            parameter.data = view

    def step(self) -> None:
        """Make an update with the gradients that are there."""
        self.begin()
        self.change()

    def begin(self) -> None:
        """Count the update that `change` is to make, and set its learning rate."""
        if self._rate is not None:
            self._rate.fill_(self.learning_rate)
        self.updates += 1

    @torch.no_grad()
    def change(self) -> None:
        """Change the parameters by the gradients that are there, after `begin`."""
        # On a GPU by the same launches in every update.
        rate = self._rate_after(self.updates - 1) if self._rate is None else self._rate
        if self._weight_decay:
            self._decayed.mul_(1.0 - rate * self._weight_decay)
        # The function that torch.optim.Adam calls: the class around it costs a small network as much as its products.
        adam(
            [self._flat], [self.gradient], [self._first_moment], [self._second_moment], [], [self._adam_step],
            fused=True, amsgrad=False, beta1=self._schedule.betas[0], beta2=self._schedule.betas[1],
            lr=rate, weight_decay=0.0, eps=1e-8, maximize=False,
        )  # fmt: skip

    @property
    def learning_rate(self) -> float:
        """The learning rate of the next update: half a cosine from the peak to the final share of it."""
        return self._rate_after(self.updates)

    def _rate_after(self, updates: int) -> float:
        done = min(updates / max(self._total_updates, 1), 1.0)
        share = self._schedule.final_share + (1.0 - self._schedule.final_share) * 0.5 * (1.0 + math.cos(math.pi * done))
        return self._schedule.learning_rate * share

    def state(self) -> dict[str, Tensor]:
        """Return all that is needed to go on from here, as copies."""
        return {
            "parameters": self._flat.clone(),
            "first_moment": self._first_moment.clone(),
            "second_moment": self._second_moment.clone(),
            "updates": torch.tensor(self.updates),
        }

    def parameters(self) -> Float[Tensor, " parameter"]:
        """Return all parameters as they are, as a copy."""
        return self._flat.clone()

    def replace(self, parameters: Float[Tensor, " parameter"]) -> None:
        """Put others, which `parameters` returned, in their place."""
        self._flat.copy_(parameters)

    def restore(self, state: dict[str, Tensor]) -> None:
        """Go on from what `state` returned."""
        self._flat.copy_(state["parameters"])
        self._first_moment.copy_(state["first_moment"])
        self._second_moment.copy_(state["second_moment"])
        self.updates = int(state["updates"])
        self._adam_step.fill_(self.updates)


def _views(flat: Tensor, shapes: list[torch.Size]) -> list[Tensor]:
    """Return views of consecutive parts of `flat` with the given shapes."""
    parts = torch.split(flat, [shape.numel() for shape in shapes])
    return [part.view(shape) for part, shape in zip(parts, shapes, strict=True)]
