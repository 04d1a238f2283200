"""The FeatureSpec: from states and actions to a network's inputs and targets, and from its outputs to the next state.

It is saved with every model, so that a model folder alone can predict from raw observations.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from addressed_dynamics.errors import ModelError, TransitionsError
from addressed_dynamics.features.samples import Samples
from addressed_dynamics.transitions import DiscreteAction, SpaceSpec, Transitions

DEVIATION_FLOOR = 1e-6
"""Least standard deviation an input is divided by, as a share of the range of its dimension (or of 1): a constant
column must not become a division by nearly nothing."""


@dataclass(frozen=True)
class FeatureSpec:
    """How the networks of one model see the environment. Make one with `fit_features`.

    A target t (the next state, or its change) becomes y = (t / scale - target_mean) / target_deviation with a single
    deviation for all dimensions, so that the loss a network trains on is, up to that constant, the paper's: the error
    of states scaled to [0, 1].
    """

    spaces: SpaceSpec
    """What the raw numbers mean."""
    target: Literal["absolute", "change"]
    """Whether a network is asked for the next state or for its change."""
    input_mean: tuple[float, ...]
    """Mean of each input over the training samples, in the environment's units (one-hot actions: their share)."""
    input_deviation: tuple[float, ...]
    """Standard deviation of each input over the training samples, floored."""
    scale: tuple[float, ...]
    """Range of each dimension of the state, in its unit: errors divided by it are errors of states in [0, 1]."""
    target_mean: tuple[float, ...]
    """Mean of each target, in multiples of `scale`."""
    target_deviation: float
    """Root mean square deviation of the targets, in multiples of `scale`."""

    @property
    def inputs(self) -> int:
        """Number of inputs of a network."""
        return len(self.input_mean)

    @property
    def outputs(self) -> int:
        """Number of outputs of a network."""
        return len(self.target_mean)

    def encode(self, observation: Float[Tensor, "sample observation"], action: Tensor) -> Float[Tensor, "sample input"]:
        """Return normalised inputs for states (in the environment's units) and actions.

        Args:
            observation: states, (B, d_obs).
            action: (B,) integers if the actions are discrete, else (B, d_act).

        Raises:
            ModelError: a shape is wrong, or a discrete action does not exist.
        """
        width = len(self.spaces.observation)
        if observation.ndim != 2 or observation.shape[1] != width:
            message = f"observations should have shape (B, {width}), but have {tuple(observation.shape)}"
            raise ModelError(message)
        raw = torch.cat([observation.to(torch.float32), self._encode_action(action, len(observation))], dim=1)
        return (raw - torch.tensor(self.input_mean)) / torch.tensor(self.input_deviation)

    def encode_target(
        self, observation: Float[Tensor, "sample observation"], next_observation: Float[Tensor, "sample observation"]
    ) -> Float[Tensor, "sample output"]:
        """Return the normalised targets for states and the states that follow them."""
        target = next_observation - observation if self.target == "change" else next_observation
        return (target / torch.tensor(self.scale) - torch.tensor(self.target_mean)) / self.target_deviation

    def decode(
        self, output: Float[Tensor, "*member sample output"], observation: Float[Tensor, "sample observation"]
    ) -> Float[Tensor, "*member sample observation"]:
        """Return the next states that outputs of a network mean, in the environment's units, unbounded."""
        target = (output * self.target_deviation + torch.tensor(self.target_mean)) * torch.tensor(self.scale)
        return target + observation if self.target == "change" else target

    def samples(self, transitions: Transitions) -> Samples:
        """Return the samples of `transitions`, in their order.

        Raises:
            ModelError: the transitions are of other spaces.
        """
        if transitions.spec != self.spaces:
            message = "the transitions' spaces are not those the features were made for"
            raise ModelError(message)
        observation = torch.from_numpy(transitions.observation)
        return Samples(
            x=self.encode(observation, torch.from_numpy(transitions.action)),
            y=self.encode_target(observation, torch.from_numpy(transitions.next_observation)),
            episode=torch.from_numpy(transitions.episode),
            step=torch.from_numpy(transitions.step.astype(np.int64)),
        )

    def loss_unit(self, loss: Literal["mse", "mae"]) -> float:
        """Return what one unit of a network's training loss is as a loss of states scaled to [0, 1]."""
        return self.target_deviation**2 if loss == "mse" else self.target_deviation

    def to_json(self) -> dict[str, Any]:
        """Return the spec as JSON-compatible values."""
        return {**asdict(self), "spaces": self.spaces.to_json()}

    @staticmethod
    def from_json(value: Any) -> FeatureSpec:
        """Read what `to_json` wrote.

        Raises:
            ModelError: `value` does not have that form.
        """
        try:
            spec = FeatureSpec(
                spaces=SpaceSpec.from_json(value["spaces"]),
                target={"absolute": "absolute", "change": "change"}[value["target"]],  # type: ignore[arg-type] # checked by the lookup
                input_mean=tuple(map(float, value["input_mean"])),
                input_deviation=tuple(map(float, value["input_deviation"])),
                scale=tuple(map(float, value["scale"])),
                target_mean=tuple(map(float, value["target_mean"])),
                target_deviation=float(value["target_deviation"]),
            )
            spec._check_lengths()
        except (KeyError, TypeError, ValueError, TransitionsError) as error:
            message = f"the description of a model's features is incomplete or malformed ({error})"
            raise ModelError(message) from error
        return spec

    def _check_lengths(self) -> None:
        action = self.spaces.action
        states = len(self.spaces.observation)
        inputs = states + (action.count if isinstance(action, DiscreteAction) else len(action.dimensions))
        for name, expected in {
            "input_mean": inputs, "input_deviation": inputs, "scale": states, "target_mean": states
        }.items():  # fmt: skip
            if len(getattr(self, name)) != expected:
                message = f"{name} should have {expected} numbers, but has {len(getattr(self, name))}"
                raise ValueError(message)

    def _encode_action(self, action: Tensor, samples: int) -> Float[Tensor, "sample action"]:
        kind = self.spaces.action
        if isinstance(kind, DiscreteAction):
            if action.shape != (samples,) or action.is_floating_point():
                message = (
                    f"discrete actions should be integers of shape ({samples},), "
                    f"but are {action.dtype} of shape {tuple(action.shape)}"
                )
                raise ModelError(message)
            if samples and not (int(action.min()) >= 0 and int(action.max()) < kind.count):
                message = f"actions should lie in 0..{kind.count - 1}, but some do not"
                raise ModelError(message)
            return torch.nn.functional.one_hot(action.long(), kind.count).to(torch.float32)
        if action.shape != (samples, len(kind.dimensions)):
            expected = (samples, len(kind.dimensions))
            message = f"continuous actions should have shape {expected}, but have {tuple(action.shape)}"
            raise ModelError(message)
        return action.to(torch.float32)


def fit_features(train: Transitions, target: Literal["absolute", "change"]) -> FeatureSpec:
    """Choose the normalisation from training transitions alone.

    The scale of a dimension is its range by the environment's bounds; where these are infinite, the range of the data.

    Raises:
        TransitionsError: there are no transitions.
    """
    if not len(train):
        message = "there are no training transitions to take statistics from: record more episodes"
        raise TransitionsError(message)
    observation, next_observation = train.observation.astype(np.float64), train.next_observation.astype(np.float64)
    bounds = np.array([(dimension.low, dimension.high) for dimension in train.spec.observation])
    spread = np.where(np.isfinite(bounds).all(axis=1), bounds[:, 1] - bounds[:, 0], np.ptp(observation, axis=0))
    scale = np.where(spread > 0, spread, 1.0)
    action, action_scale = _action_columns(train)
    inputs = np.concatenate([observation, action], axis=1)
    floor = DEVIATION_FLOOR * np.concatenate([scale, action_scale])
    targets = (next_observation - observation if target == "change" else next_observation) / scale
    return FeatureSpec(
        spaces=train.spec,
        target=target,
        input_mean=tuple(map(float, inputs.mean(axis=0))),
        input_deviation=tuple(map(float, np.maximum(inputs.std(axis=0), floor))),
        scale=tuple(map(float, scale)),
        target_mean=tuple(map(float, targets.mean(axis=0))),
        target_deviation=float(max(np.sqrt(targets.var(axis=0).mean()), DEVIATION_FLOOR)),
    )


def _action_columns(
    train: Transitions,
) -> tuple[Float[np.ndarray, "sample action"], Float[np.ndarray, " action"]]:
    """Return actions as inputs (one-hot if discrete) and the range of each."""
    kind = train.spec.action
    if isinstance(kind, DiscreteAction):
        return np.eye(kind.count)[train.action], np.ones(kind.count)
    action = train.action.astype(np.float64)
    spread = np.ptp(action, axis=0)
    return action, np.where(spread > 0, spread, 1.0)
