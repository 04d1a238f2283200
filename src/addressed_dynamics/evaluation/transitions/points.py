"""Points: transitions as a model sees them, each with the frames before it."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32, Int32, Int64
from torch import Tensor

from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.features.transitions.windows import window_rows, windows


@dataclass(frozen=True)
class Points:
    """The transitions of which a model with these features can predict the end."""

    features: FeatureSpec
    """How the model sees them."""
    transitions: Transitions
    """All transitions, those without enough frames before them included."""
    rows: Int64[np.ndarray, " point"]
    """Rows of the transitions that are points."""

    @staticmethod
    def of(transitions: Transitions, features: FeatureSpec) -> "Points":
        """Return the points of `transitions`: those with `features.history` - 1 transitions of their episode before."""
        return Points(features, transitions, window_rows(transitions, features.history))

    def __len__(self) -> int:
        return len(self.rows)

    def inputs(self, point: Int64[Tensor, " chosen"]) -> tuple[Tensor, Tensor]:
        """Return states and actions of the points with these numbers, as `AddressedDynamics.predict` takes them."""
        rows, history = torch.from_numpy(self.rows)[point], self.features.history
        return (
            windows(torch.from_numpy(self.transitions.observation), rows, history),
            windows(torch.from_numpy(self.transitions.action), rows, history),
        )

    @property
    def observation(self) -> Float32[np.ndarray, "point observation"]:
        """States before the step, in the environment's units."""
        observation: Float32[np.ndarray, "point observation"] = self.transitions.observation[self.rows]
        return observation

    @property
    def next_observation(self) -> Float32[np.ndarray, "point observation"]:
        """States after the step, in the environment's units."""
        next_observation: Float32[np.ndarray, "point observation"] = self.transitions.next_observation[self.rows]
        return next_observation

    @property
    def action(self) -> Int64[np.ndarray, " point"] | Float32[np.ndarray, "point action"]:
        """Actions taken in the step."""
        action: Int64[np.ndarray, " point"] | Float32[np.ndarray, "point action"] = self.transitions.action[self.rows]
        return action

    @property
    def episode(self) -> Int64[np.ndarray, " point"]:
        """Episodes that the points come from."""
        episode: Int64[np.ndarray, " point"] = self.transitions.episode[self.rows]
        return episode

    @property
    def step(self) -> Int32[np.ndarray, " point"]:
        """Numbers of the steps in their episodes."""
        step: Int32[np.ndarray, " point"] = self.transitions.step[self.rows]
        return step
