"""A model as one torch module from raw numbers to raw numbers, to be traced and served without this package."""

from typing import final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.networks.addressing import addressing_scores
from addressed_dynamics.simulators.addressed import AddressedDynamics


@final
class PortableDynamics(nn.Module):
    """Maps states, actions and exogenous inputs to next states, in the model's own mode of addressing.

    It evaluates every member, and in the mode `argmax` keeps the selected one's output, because a trace must not depend
    on the data; up to rounding, the result is that of `AddressedDynamics.predict`. It checks nothing.
    """

    def __init__(self, model: AddressedDynamics) -> None:
        """Take a model apart.

        Raises:
            ModelError: its mode is `sample`, and what is drawn cannot be traced.
        """
        super().__init__()
        if model.mode == "sample" and model.addressing is not None:
            message = "a model that draws its members cannot be kept as one module; load it in another mode"
            raise ModelError(message)
        self.mode = model.mode
        self.features = model.features
        self.ensemble = model.ensemble
        self.addressing = model.addressing
        spaces = model.features.spaces
        actions = 1 if isinstance(spaces.action, DiscreteAction) else len(spaces.action.dimensions)
        self.columns = [len(spaces.observation), actions, len(spaces.exogenous)]

    def forward(self, inputs: Float[Tensor, "sample input"]) -> Float[Tensor, "sample observation"]:
        """Return the next states, (B, d_obs).

        Args:
            inputs: states in the environment's units beside actions: one column with the action's number if actions
                are discrete, (B, d_obs + 1), else one for each of its components, (B, d_obs + d_act); and beside them
                the exogenous inputs, if there are any. With a history, so many columns for each frame, oldest first.
        """
        frames = inputs.reshape(-1, self.features.history, sum(self.columns))
        observation, action, exogenous = torch.split(frames, self.columns, dim=-1)
        kind = self.features.spaces.action
        if isinstance(kind, DiscreteAction):
            action = (action.round() == torch.arange(kind.count)).to(torch.float32)
        x = torch.cat([observation, action, exogenous], dim=-1)
        x = (x - torch.tensor(self.features.input_mean)) / torch.tensor(self.features.input_deviation)
        x, last = self.features.join(x if self.features.history > 1 else x[:, 0]), observation[:, -1]
        if self.addressing is None:
            return self.features.decode(self.ensemble(x)[0], last)
        weights = torch.softmax(addressing_scores(self.addressing, x), dim=1)
        if self.mode == "blend":
            return self.features.decode(self.ensemble.forward_blended(x, weights), last)
        if self.mode == "argmax":
            weights = nn.functional.one_hot(weights.argmax(dim=1), self.ensemble.members).to(torch.float32)
        return self.features.decode((self.ensemble(x) * weights.T.unsqueeze(-1)).sum(dim=0), last)
