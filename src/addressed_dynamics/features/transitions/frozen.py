"""What a FeatureSpec computes, by NumPy, whose calls cost less than PyTorch's: for models that are evaluated."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Float32

from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.features.transitions.spec import FeatureSpec


class FrozenFeatures:
    """The constants of a `FeatureSpec` as arrays."""

    def __init__(self, features: FeatureSpec) -> None:
        """Take them from `features`."""
        self._features = features
        self._of = {name: value.numpy() for name, value in vars(features.constants).items()}
        self._frame_weights = features.constants.frame_weights.numpy()
        self._discrete = isinstance(features.spaces.action, DiscreteAction)
        self._states = slice(0, len(features.spaces.observation))
        self._known = slice(features.frame_inputs - len(features.spaces.exogenous), features.frame_inputs)
        self._acted = slice(self._states.stop, self._known.start)

    def encode(
        self, observation: Float32[np.ndarray, "sample ..."], action: np.ndarray, exogenous: np.ndarray | None
    ) -> Float32[np.ndarray, "sample input"] | None:
        """Return what `FeatureSpec.encode` does; None for what that refuses, which says why."""
        history, of = self._features.history, self._of
        batch = observation.shape[:1] if history == 1 else (*observation.shape[:1], history)
        x = np.empty((*batch, self._known.stop), np.float32)
        states, acted, known = x[..., self._states], x[..., self._acted], x[..., self._known]
        if observation.shape != states.shape or (
            known.shape[-1] if exogenous is None else exogenous.shape != known.shape
        ):
            return None
        np.subtract(observation, of["state_mean"], out=states)
        states /= of["state_deviation"]
        if not self._discrete:
            if action.shape != acted.shape:
                return None
            np.subtract(action, of["action_mean"], out=acted)
            acted /= of["action_deviation"]
        else:
            # What is below 0 would count from the end.
            if action.shape != batch or action.dtype.kind == "f" or (action.size and action.min() < 0):
                return None
            try:
                acted[...] = of["actions"].take(action, axis=0)
            except IndexError:
                return None
        if exogenous is not None and known.shape[-1]:
            np.subtract(exogenous, of["exogenous_mean"], out=known)
            known /= of["exogenous_deviation"]
        if history == 1:
            return x
        x *= self._frame_weights
        return x.reshape(len(x), self._features.inputs)

    def decode(
        self, output: Float[np.ndarray, "*member sample output"], observation: Float32[np.ndarray, "sample observation"]
    ) -> Float[np.ndarray, "*member sample observation"]:
        """Return what `FeatureSpec.decode` does."""
        if self._features.angles:
            return self._features.decode(torch.from_numpy(output), torch.from_numpy(observation)).numpy()
        target: Float[np.ndarray, "*member sample observation"] = np.multiply(output, self._of["unit"], order="C")
        target += self._of["middle"]
        if self._features.target == "change":
            target += observation
        return target
