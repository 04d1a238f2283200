"""A model as one torch module from raw numbers to raw numbers: to be exported, traced, served, or differentiated."""

from typing import final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.networks.addressing import addressing_scores
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.modes import MODES


@final
class StepModule(nn.Module):
    """Maps states, actions and exogenous inputs to next states, in the model's own mode of addressing.

    It evaluates every member, and in the mode `argmax` keeps the selected one's output, because a graph must not depend
    on the data; up to rounding, the result is that of `AddressedDynamics.predict`. It has a gradient with respect to
    states, continuous actions and exogenous inputs, that of the selected member, and to its weights if they ask for
    one.
    """

    def __init__(self, model: AddressedDynamics) -> None:
        """Take a model apart.

        Raises:
            ModelError: its mode is `sample`, and what is drawn is no function.
        """
        super().__init__()
        check_function(model.mode, model.addressing)
        self.mode = model.mode
        self.features = model.features
        _ = self.features.constants  # made here, for a tracer would make some that are of no use to anybody else
        self.ensemble = model.ensemble
        self.addressing = model.addressing

    def forward(
        self,
        observation: Float[Tensor, "sample ..."],
        action: Tensor,
        exogenous: Tensor | None = None,
    ) -> Float[Tensor, "sample observation"]:
        """Return the next states, (B, d_obs), float32.

        Args:
            observation: states, (B, d_obs) or, with a history of H > 1 frames, (B, H, d_obs), in the environment's
                units.
            action: (B,) or (B, H) integers if the actions are discrete, else (B, d_act) or (B, H, d_act).
            exogenous: (B, d_exo) or (B, H, d_exo); None if, and only if, the model has none.

        Raises:
            ModelError: a shape is wrong, or a discrete action does not exist.
        """
        x = self.features.encode(observation, action, exogenous)
        last = observation if self.features.history == 1 else observation[:, -1]
        return self.features.decode(combined_output(self.ensemble, self.addressing, self.mode, x), last)


def check_function(mode: str, addressing: StackedMLP | None) -> None:
    """Check that what a model says is a function of its inputs.

    Raises:
        ModelError: it draws its members.
    """
    if mode == "sample" and addressing is not None:
        others = ", ".join(each for each in MODES if each != mode)
        message = f"mode '{mode}' draws the members at random, so its step is no function; take another mode ({others})"
        raise ModelError(message)


def combined_output(
    ensemble: StackedMLP, addressing: StackedMLP | None, mode: str, x: Float[Tensor, "sample input"]
) -> Float[Tensor, "sample output"]:
    """Return what the members say together, of all of them: without a branch that depends on the data."""
    if addressing is None:
        return ensemble.forward_all(x).squeeze(0)
    weights = torch.softmax(addressing_scores(addressing, x), dim=1)
    if mode == "blend":
        return ensemble.forward_blended(x, weights)
    outputs = ensemble.forward_all(x)
    if mode == "argmax":
        selected = weights.argmax(dim=1).reshape(1, -1, 1).expand(1, -1, outputs.shape[2])
        return outputs.gather(0, selected).squeeze(0)
    return (outputs * weights.T.unsqueeze(-1)).sum(dim=0)
