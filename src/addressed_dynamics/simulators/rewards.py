"""Reward and end of a step as they were learned from the logs, and who says them of an experiment's models."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch
from jaxtyping import Bool, Float, Float32, Float64
from safetensors import SafetensorError
from torch import Tensor

from addressed_dynamics.base.errors import ModelError, TransitionsError
from addressed_dynamics.base.files import atomic_path, write_json
from addressed_dynamics.base.params.training import Activation
from addressed_dynamics.episodes.transitions import DiscreteAction, SpaceSpec
from addressed_dynamics.networks.files import read_index
from addressed_dynamics.networks.stacked import StackedMLP

FOLDER = "reward"
"""Name of the folder in a folder of models; the evaluation writes it."""
INDEX = "reward.json"
WEIGHTS = "reward.safetensors"
FORMAT = 1
LEARNED = "learned"
"""Who says reward and end if networks do."""
NOBODY = "none"
"""Who says reward and end if nobody does: the reward is 0, and no episode ends inside the task."""


@dataclass(frozen=True)
class Fitted:
    """A network with the units of its inputs."""

    network: StackedMLP
    mean: Float[Tensor, " input"]
    deviation: Float[Tensor, " input"]

    @torch.no_grad()
    def __call__(self, x: Float[Tensor, "row input"]) -> Float[Tensor, "row output"]:
        """Return what the network says of inputs as `task_inputs` makes them."""
        output: Tensor = self.network((x.to(self.mean.dtype) - self.mean) / self.deviation)[0]
        return output

    def double(self) -> Fitted:
        """Return the same in double precision."""
        return Fitted(copy.deepcopy(self.network).double(), self.mean.double(), self.deviation.double())


@dataclass(frozen=True)
class LearnedTask:
    """Reward and end of steps, learned from logs. Only the last frame counts, and what followed it."""

    spaces: SpaceSpec
    """What the numbers mean."""
    reward: Fitted | None
    """Its network, which says rewards in units of their deviation; None if all were the same."""
    reward_mean: float
    """Mean of the rewards in training, in the units of the log."""
    reward_deviation: float
    """Their standard deviation, in the same units."""
    end: Fitted | None
    """The network of ends, which is told the reward, too; its two outputs are scores that a step goes on, and that it
    ends the episode. None if no recorded episode terminated: then none ever does."""
    threshold: float
    """Difference of these scores above which a step ends the episode."""

    @property
    def sources(self) -> tuple[str, str]:
        """Who says reward and end."""
        # A reward that is 0 everywhere is what logs without one have.
        says = self.reward is not None or self.reward_mean != 0.0
        return (LEARNED if says else NOBODY, LEARNED if self.end is not None else NOBODY)

    def __call__(
        self,
        state: Float32[np.ndarray, "copy observation"],
        action: np.ndarray,
        next_state: Float32[np.ndarray, "copy observation"],
        exogenous: Float32[np.ndarray, "copy exogenous"],
    ) -> tuple[Float64[np.ndarray, " copy"], Bool[np.ndarray, " copy"]]:
        """Return rewards, in the units of the log, and which steps end an episode inside the task."""
        x = task_inputs(self.spaces, state, action, next_state, exogenous)
        reward = np.full(len(x), self.reward_mean)
        if self.reward is not None:
            # Rounded, so that in double precision it does not depend on the size of the batch.
            said = self.reward(x).to(torch.float32)
            reward += self.reward_deviation * said[:, 0].numpy().astype(np.float64)
        if self.end is None:
            return reward, np.zeros(len(x), bool)
        return reward, np.asarray(end_scores(self.end, x, self.reward) > self.threshold)

    def double(self) -> LearnedTask:
        """Return the same with networks in double precision."""
        reward, end = (None if each is None else each.double() for each in (self.reward, self.end))
        return replace(self, reward=reward, end=end)


@dataclass(frozen=True)
class KeptTask:
    """Who says reward and end of an experiment's models, as it is kept beside them."""

    function: str | None
    """The function that the experiment names, as `module:function`; None if it names none."""
    learned: LearnedTask | None
    """What was learned from the logs; None if models of this kind of data learn none."""


def task_inputs(
    spaces: SpaceSpec, state: np.ndarray, action: np.ndarray, next_state: np.ndarray, exogenous: np.ndarray
) -> Float32[Tensor, "row input"]:
    """Return what the networks are given of steps: the state after it, what changed, the action and what acted.

    The change stands in place of the state before: a network that is given both states in units of their ranges can
    hardly tell them apart where steps are short. Discrete actions are one-hot.
    """
    kind = spaces.action
    acted = np.eye(kind.count, dtype=np.float32)[action] if isinstance(kind, DiscreteAction) else action
    parts = (next_state, next_state - state, acted, exogenous)
    return torch.from_numpy(np.concatenate([np.asarray(each, np.float32) for each in parts], axis=1))


def end_inputs(x: Float[Tensor, "row input"], reward: Fitted | None) -> Float32[Tensor, "row input"]:
    """Return what the network of ends is given: the same, and what the network of rewards says, if there is one."""
    return x if reward is None else torch.cat([x, reward(x).to(torch.float32)], dim=1)


def end_scores(end: Fitted, x: Float[Tensor, "row input"], reward: Fitted | None) -> Float64[np.ndarray, " row"]:
    """Return by how much the score that a step ends the episode is above the score that it goes on."""
    scores = end(end_inputs(x, reward)).to(torch.float32).numpy().astype(np.float64)
    return np.asarray(scores[:, 1] - scores[:, 0])


def write_task(models: Path, kept: KeptTask | None) -> None:
    """Write who says reward and end into an experiment's folder of models; None if this kind of data has no such."""
    with atomic_path(models / FOLDER) as folder:
        folder.mkdir(parents=True)
        learned = None if kept is None else kept.learned
        tensors = dict[str, Tensor]()
        index: dict[str, Any] = {"format": FORMAT, "function": None if kept is None else kept.function, "learned": None}
        if learned is not None:
            networks = {name: each for name in ("reward", "end") if (each := getattr(learned, name)) is not None}
            for name, fitted in networks.items():
                own = {"mean": fitted.mean, "deviation": fitted.deviation, **fitted.network.state_dict()}
                tensors |= {f"{name}/{key}": value.detach().contiguous().clone() for key, value in own.items()}
            index["learned"] = {
                "spaces": learned.spaces.to_json(),
                "reward_mean": learned.reward_mean,
                "reward_deviation": learned.reward_deviation,
                "threshold": learned.threshold,
                "networks": {
                    name: {"widths": list(fitted.network.widths), "activation": fitted.network.activation}
                    for name, fitted in networks.items()
                },
            }
        safetensors.torch.save_file(tensors, folder / WEIGHTS)
        write_json(folder / INDEX, index)


def read_task(models: Path) -> KeptTask | None:
    """Read what `write_task` wrote into a folder of models; None if it is of a version that kept none.

    Raises:
        ModelError: a file is missing or damaged.
    """
    folder = models / FOLDER
    if not folder.is_dir():
        return None
    index = read_index(folder, INDEX)
    try:
        tensors = safetensors.torch.load_file(folder / WEIGHTS)
        function, said = index["function"], index["learned"]
        return KeptTask(None if function is None else str(function), None if said is None else _learned(said, tensors))
    except (
        KeyError, IndexError, TypeError, ValueError, OSError, RuntimeError, SafetensorError, TransitionsError,
    ) as error:  # fmt: skip
        reason = str(error).split("\n", maxsplit=1)[0]
        message = f"{folder}: incomplete or malformed ({reason}); 'dvc repro evaluate@{models.name}' writes it anew"
        raise ModelError(message) from error


def _learned(said: dict[str, Any], tensors: dict[str, Tensor]) -> LearnedTask:
    found = dict[str, Fitted]()
    for name, form in said["networks"].items():
        activation: Activation = form["activation"]
        stack = StackedMLP(1, tuple(int(width) for width in form["widths"]), activation)
        own = {key.partition("/")[2]: value for key, value in tensors.items() if key.startswith(f"{name}/")}
        mean, deviation = own.pop("mean"), own.pop("deviation")
        stack.load_state_dict(own)
        found[name] = Fitted(stack.requires_grad_(False), mean, deviation)
    return LearnedTask(
        SpaceSpec.from_json(said["spaces"]),
        found.get("reward"),
        float(said["reward_mean"]),
        float(said["reward_deviation"]),
        found.get("end"),
        float(said["threshold"]),
    )
