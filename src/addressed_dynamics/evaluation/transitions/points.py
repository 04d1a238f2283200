"""Points: transitions as a model sees them, each with the frames before it, and what models say of them."""

from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float, Float32, Int32, Int64
from torch import Tensor

from addressed_dynamics.base.torch_runtime import CPU
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.common.spool import IN_MEMORY, Scratch
from addressed_dynamics.features.transitions.sampling import bytes_per_row
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.features.transitions.windows import episode_lengths, window_rows, windows
from addressed_dynamics.networks.stacked import BLOCKS_HELD, CHUNK_ROWS, in_blocks
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.modes import Mode
from addressed_dynamics.simulators.on_device import ModelOnDevice


@dataclass(frozen=True)
class Points:
    """The transitions of which a model with these features can predict the end.

    What a model says of them is computed when it is first asked for, and kept: measures share the passes of a network.
    Whatever has a number for each point lies in `scratch`, and is computed in the same blocks wherever that is.
    """

    features: FeatureSpec
    """How the model sees them."""
    transitions: Transitions
    """All transitions, those without enough frames before them included."""
    rows: Int64[np.ndarray, " point"]
    """Rows of the transitions that are points."""
    device: torch.device = CPU
    """Where networks are evaluated; what they say is kept on the CPU."""
    scratch: Scratch = IN_MEMORY
    """Where what belongs to each point lies."""
    _kept: dict[Hashable, Tensor] = field(default_factory=dict, repr=False, compare=False)
    """What was computed, by what it was computed of and with."""
    _there: dict[AddressedDynamics, ModelOnDevice] = field(default_factory=dict, repr=False, compare=False)
    """Models that were sent to the device."""

    @staticmethod
    def of(
        transitions: Transitions, features: FeatureSpec, device: torch.device = CPU, scratch: Scratch = IN_MEMORY
    ) -> "Points":
        """Return the points of `transitions`: those with `features.history` - 1 transitions of their episode before."""
        rows = window_rows(transitions, features.history, scratch)
        return Points(features, transitions, rows, device, scratch)

    def __len__(self) -> int:
        return len(self.rows)

    def inputs(self, point: Int64[Tensor, " chosen"]) -> tuple[Tensor, Tensor]:
        """Return states and actions of the points with these numbers, as `AddressedDynamics.predict` takes them."""
        rows, history = torch.from_numpy(self.rows)[point], self.features.history
        return (
            windows(torch.from_numpy(self.transitions.observation), rows, history),
            windows(torch.from_numpy(self.transitions.action), rows, history),
        )

    def exogenous_inputs(self, point: Int64[Tensor, " chosen"]) -> Float[Tensor, "chosen ..."]:
        """Return what stands beside the actions of `inputs`, as `AddressedDynamics.predict` takes it."""
        rows = torch.from_numpy(self.rows)[point]
        return windows(torch.from_numpy(self.transitions.exogenous), rows, self.features.history)

    @property
    def observation(self) -> Float32[np.ndarray, "point observation"]:
        """States before the step, in the environment's units."""
        observation: Float32[np.ndarray, "point observation"] = self._column("observation")
        return observation

    @property
    def next_observation(self) -> Float32[np.ndarray, "point observation"]:
        """States after the step, in the environment's units."""
        next_observation: Float32[np.ndarray, "point observation"] = self._column("next_observation")
        return next_observation

    @property
    def action(self) -> Int64[np.ndarray, " point"] | Float32[np.ndarray, "point action"]:
        """Actions taken in the step."""
        action: Int64[np.ndarray, " point"] | Float32[np.ndarray, "point action"] = self._column("action")
        return action

    @property
    def exogenous(self) -> Float32[np.ndarray, "point exogenous"]:
        """Exogenous inputs during the step, in their own units."""
        exogenous: Float32[np.ndarray, "point exogenous"] = self._column("exogenous")
        return exogenous

    @property
    def episode(self) -> Int64[np.ndarray, " point"]:
        """Episodes that the points come from."""
        episode: Int64[np.ndarray, " point"] = self._column("episode")
        return episode

    @property
    def step(self) -> Int32[np.ndarray, " point"]:
        """Numbers of the steps in their episodes."""
        step: Int32[np.ndarray, " point"] = self._column("step")
        return step

    def _column(self, name: str) -> Any:
        column = getattr(self.transitions, name)
        if len(self) == len(column):
            return column
        if name not in self._kept:
            found = self.scratch.filled(len(self), lambda rows: column[self.rows[rows]])
            self._kept[name] = torch.from_numpy(found)
        return self._kept[name].numpy()

    @cached_property
    def lengths(self) -> Int64[np.ndarray, " episode"]:
        """Transitions of every episode, in their order, those without enough frames before them included."""
        return episode_lengths([self.transitions])

    @cached_property
    def begins(self) -> Int64[np.ndarray, " bound"]:
        """Numbers of the points that episodes begin with, of those that have points, and the number of all points."""
        counts = np.maximum(self.lengths - (self.features.history - 1), 0)
        return np.append(0, np.cumsum(counts[counts > 0]))

    def run(self, rows: slice) -> Int64[np.ndarray, " chosen"]:
        """Return which of the episodes in `begins` each of some consecutive points is from."""
        return np.searchsorted(self.begins, np.arange(rows.start, rows.stop), side="right") - 1

    def last_rows(self, rows: Int64[np.ndarray, " chosen"]) -> Int64[np.ndarray, " chosen"]:
        """Return for each of some rows of the transitions the last row of its episode."""
        ends = np.cumsum(self.lengths)
        last: Int64[np.ndarray, " chosen"] = ends[np.searchsorted(ends, rows, side="right")] - 1
        return last

    def each(self, function: Callable[[slice], Tensor], sample_dim: int = 0) -> Float[Tensor, "..."]:
        """Return `function` of all points, which is given the numbers of `CHUNK_ROWS` consecutive ones at a time."""

        def block(rows: slice) -> Tensor:
            if not rows.start // CHUNK_ROWS % BLOCKS_HELD:
                self.scratch.release()
            return function(rows)

        found = in_blocks(block, range(len(self)), sample_dim=sample_dim, make=self.scratch)
        self.scratch.release()
        return found

    def x(self, features: FeatureSpec) -> Float[Tensor, "point input"]:
        """Return the inputs of networks with such features, which ask for as many frames as the points have."""

        def encode(point: Tensor) -> Tensor:
            return features.encode(*self.inputs(point), self.exogenous_inputs(point))

        return self._once(("x", features), encode, sample_dim=0)

    def outputs(self, model: AddressedDynamics) -> Float[Tensor, "member point output"]:
        """Return the outputs of every member, normalised as targets are."""
        x = self.x(model.features)

        def outputs(point: Tensor) -> Tensor:
            if self.device == CPU:
                return model.ensemble(x[point])  # type: ignore[no-any-return] # a module's call is not typed
            return self._on_device(model).outputs(x[point].to(self.device)).cpu()

        return self._once(("outputs", model.features, model.ensemble), outputs, 1)

    def probabilities(self, model: AddressedDynamics) -> Float[Tensor, "point member"]:
        """Return the softmax of the addressing network's outputs."""
        x, key = self.x(model.features), ("probabilities", model.features, model.addressing or model.ensemble)

        def probabilities(point: Tensor) -> Tensor:
            if self.device == CPU:
                return model.probabilities_of(x[point])
            return self._on_device(model).probabilities_of(x[point].to(self.device)).cpu()

        return self._once(key, probabilities, 0)

    def combined(
        self, model: AddressedDynamics, point: Int64[Tensor, " chosen"], mode: Mode, generator: torch.Generator | None
    ) -> Float[Tensor, "chosen output"]:
        """Return what a mode makes of the members' outputs for some points, normalised as targets are."""
        x, probabilities = self.x(model.features)[point], self.probabilities(model)[point]
        outputs = self.outputs(model)[:, point] if mode == "mixture" else None
        if self.device == CPU or outputs is not None:
            return model.combined(x, probabilities, mode, outputs=outputs, generator=generator)
        sent = x.to(self.device), probabilities.to(self.device)
        return self._on_device(model).combined(*sent, mode, generator=generator).cpu()

    def losses(self, model: AddressedDynamics, loss: str) -> Float[Tensor, "member point"]:
        """Return the loss (`mse` or `mae`) of every point under every member.

        They are of states scaled to [0, 1], of what the networks say: before angles are put back on the unit circle.
        """
        kind: Literal["mse", "mae"] = "mse" if loss == "mse" else "mae"
        outputs, unit = self.outputs(model), model.features.loss_unit(kind)

        def losses(rows: slice) -> Tensor:
            error = (outputs[:, rows] - self.targets(model, rows)).double()
            each = error.square() if loss == "mse" else error.abs()
            return each.mean(dim=-1) * unit

        key = ("losses", model.features, model.ensemble, loss)
        if key not in self._kept:
            self._kept[key] = self.each(losses, sample_dim=1)
        return self._kept[key]

    def targets(self, model: AddressedDynamics, rows: slice) -> Float[Tensor, "chosen output"]:
        """Return what a model's outputs should be for some consecutive points, normalised."""
        observation, after = (torch.from_numpy(each[rows]) for each in (self.observation, self.next_observation))
        return model.features.encode_target(observation, after)

    def chosen(self, model: AddressedDynamics) -> Int64[Tensor, " point"]:
        """Return the member that the addressing network selects for every point."""
        probabilities = self.probabilities(model)
        key = ("chosen", model.features, model.addressing or model.ensemble)
        if key not in self._kept:
            self._kept[key] = self.each(lambda rows: probabilities[rows].argmax(dim=1))
        return self._kept[key]

    def _on_device(self, model: AddressedDynamics) -> ModelOnDevice:
        if model not in self._there:
            self._there[model] = ModelOnDevice(model, self.device)
        return self._there[model]

    def _once(self, key: Hashable, function: Callable[[Tensor], Tensor], sample_dim: int) -> Tensor:
        """Return `function` of the numbers of all points, in blocks; computed at the first call with this key."""
        if key not in self._kept:
            self._kept[key] = self.each(lambda rows: function(torch.arange(rows.start, rows.stop)), sample_dim)
        return self._kept[key]


def bytes_per_point(features: FeatureSpec, models: Iterable[AddressedDynamics]) -> int:
    """Return about how many bytes are kept of each point: its transition, and what models say of it."""
    ensembles = {id(each.ensemble): each.ensemble for each in models}
    said = sum(each.members * (4 * each.widths[-1] + 4 + 8) for each in ensembles.values())
    return 2 * bytes_per_row(features.spaces, courses=True) + 4 * features.inputs + said
