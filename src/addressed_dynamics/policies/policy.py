"""A policy that was learned: what to do in a state. Its folder holds no pickle: loading it runs no code."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy
from jaxtyping import Float32, Int64
from safetensors import SafetensorError

from addressed_dynamics.base.errors import ModelError, TransitionsError
from addressed_dynamics.base.files import write_json
from addressed_dynamics.base.params.experiments import known_experiments
from addressed_dynamics.episodes.transitions import DiscreteAction, SpaceSpec
from addressed_dynamics.networks.files import read_index
from addressed_dynamics.policies.records import INDEX
from addressed_dynamics.simulators.arrays import Values, as_tensor, finite
from addressed_dynamics.simulators.delivery import known_words

POLICIES = Path("data/policies")
"""Where the pipeline keeps the policies of experiments."""
WEIGHTS = "weights.safetensors"
FORMAT = 1
"""Version of the folder's layout."""


@dataclass(frozen=True)
class Policy:
    """Takes the action of the highest value, as a network sees it; the first of several.

    `policy(state)` answers with the number of the action, `policy(states)` with one for each.
    """

    spaces: SpaceSpec
    """What the numbers mean."""
    hold: int
    """For how many steps an action is to be held before the policy is asked again; so it was when it learned."""
    centre: Float32[np.ndarray, " observation"]
    """What is subtracted from states before the first layer."""
    reach: Float32[np.ndarray, " observation"]
    """What they are then divided by."""
    layers: tuple[tuple[Float32[np.ndarray, "output input"], Float32[np.ndarray, " output"]], ...]
    """Weights and biases in turn, with ReLU between the layers."""

    def __call__(self, observation: Values) -> int | Int64[np.ndarray, " batch"]:
        """Return what to do.

        Args:
            observation: a state (d,), or states (B, d), in the environment's units.

        Returns:
            The number of the action, or one for each state.

        Raises:
            ModelError: it is no state, or not finite.
        """
        states = finite(as_tensor(observation), "states").numpy()
        width = len(self.spaces.observation)
        if states.ndim not in (1, 2) or states.shape[-1] != width:
            names = ", ".join(self.spaces.observation_names)
            message = (
                f"a policy takes states of shape ({width},) or (B, {width}) ({names}), but was given {states.shape}"
            )
            raise ModelError(message)
        chosen = self.values(states.reshape(-1, width)).argmax(axis=1)
        return int(chosen[0]) if states.ndim == 1 else chosen

    def values(self, states: Float32[np.ndarray, "batch observation"]) -> Float32[np.ndarray, "batch action"]:
        """Return the value of each action: the return that follows it, discounted and scaled as the learner had it."""
        hidden = (states - self.centre) / self.reach
        *inner, last = self.layers
        for weight, bias in inner:
            hidden = np.maximum(hidden @ weight.T + bias, 0.0)
        found: Float32[np.ndarray, "batch action"] = hidden @ last[0].T + last[1]
        return found

    @property
    def action_names(self) -> tuple[str, ...]:
        """What the actions are called, by number."""
        assert isinstance(self.spaces.action, DiscreteAction)
        return self.spaces.action.names


def save_policy(folder: Path, policy: Policy | None) -> None:
    """Write a policy into a folder that is there; None if an experiment asks for none."""
    described = None
    if policy is not None:
        described = {
            "kind": "greedy",
            "hold": policy.hold,
            "layers": len(policy.layers),
            "spaces": policy.spaces.to_json(),
        }
        tensors = {"centre": policy.centre, "reach": policy.reach}
        for number, (weight, bias) in enumerate(policy.layers):
            tensors |= {f"layer.{number}.weight": weight, f"layer.{number}.bias": bias}
        # safetensors writes the memory as it lies.
        safetensors.numpy.save_file(
            {name: np.ascontiguousarray(each) for name, each in tensors.items()}, folder / WEIGHTS
        )
    write_json(folder / INDEX, {"format": FORMAT, "policy": described})


def load_policy(folder: str | Path) -> Policy:
    """Load a policy, for instance of `data/policies/mountaincar`.

    Raises:
        ModelError: there is none, a file is missing or damaged, or it is of another version.
    """
    home = Path(folder)
    again = f"'dvc repro train_policy@{home.name}' writes it"
    if not home.is_dir():
        how = f"; {again}" if home.name in known_experiments() else f" ({known_words(POLICIES)})"
        message = f"{home}: there is no such folder of a policy{how}"
        raise ModelError(message)
    index = read_index(home, INDEX)
    if index.get("policy") is None:
        message = f"{home}: the experiment asks for no policy: its section of the params file has no 'policy'"
        raise ModelError(message)
    try:
        tensors = safetensors.numpy.load_file(home / WEIGHTS)
        return _assembled(index["policy"], tensors)
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, TransitionsError) as error:
        message = f"{home}: incomplete or damaged ({error}); {again} anew"
        raise ModelError(message) from error


def _assembled(described: dict[str, Any], tensors: dict[str, np.ndarray]) -> Policy:
    spaces = SpaceSpec.from_json(described["spaces"])
    layers = tuple(
        (tensors[f"layer.{number}.weight"], tensors[f"layer.{number}.bias"])
        for number in range(int(described["layers"]))
    )
    action, width = spaces.action, len(spaces.observation)
    if not isinstance(action, DiscreteAction):
        message = "its actions are not discrete"
        raise ValueError(message)
    ends = (width, *(weight.shape[0] for weight, _ in layers))
    fits = all(
        weight.shape == (after, before) and bias.shape == (after,)
        for (weight, bias), before, after in zip(layers, ends, ends[1:], strict=False)
    )
    scaled = tensors["centre"].shape == tensors["reach"].shape == (width,)
    if not (fits and scaled and layers and ends[-1] == action.count):
        message = "the weights are not of such a network"
        raise ValueError(message)
    return Policy(spaces, int(described["hold"]), tensors["centre"], tensors["reach"], layers)
