"""A model on a GPU: what `AddressedDynamics` computes on the CPU, of many samples at once and all on the device."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.torch_runtime import checked_device
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.networks.addressing import addressing_scores
from addressed_dynamics.simulators.arrays import Values, as_tensor, finite
from addressed_dynamics.simulators.modes import MODES, Mode, no_mode
from addressed_dynamics.training.graphs import Repeated

if TYPE_CHECKING:
    from addressed_dynamics.simulators.addressed import AddressedDynamics

SORTING_COST = 2_000_000_000
"""Multiply-adds up to which all members are evaluated for all samples: to sort samples by member, the processor has to
wait for the device. An estimate for cards of tens of teraflops; nobody has measured it yet."""


class ModelOnDevice:
    """A model whose networks are on a device. The weights are those that it had when this was made."""

    def __init__(self, model: AddressedDynamics, device: torch.device | str) -> None:
        """Send the networks of `model` to a device, for instance `cuda`.

        Raises:
            ParamsError: there is no device of this name.
            DeviceError: it is not there.
        """
        self.device = checked_device(device)
        self.features = model.features
        self.mode: Mode = model.mode
        self._ensemble = model.ensemble.on(self.device)
        self._addressing = None if model.addressing is None else model.addressing.on(self.device)
        self._every_member = Repeated(self._step_of_every_member)

    @torch.no_grad()
    def rollout(
        self,
        observation: Values,
        actions: Values,
        mode: Mode | None = None,
        *,
        exogenous: Values | None = None,
        generator: torch.Generator | None = None,
    ) -> Float[Tensor, "sample step observation"]:
        """Return what `AddressedDynamics.rollout` does, of a batch, on the device, up to rounding.

        Args:
            observation: first states, (B, d_obs) or (B, H, d_obs); arrays, lists or tensors of the CPU are looked at
                and sent, tensors of the device are taken as they are.
            actions: actions, as there.
            mode: as there.
            exogenous: exogenous inputs, as there.
            generator: as there, one of the CPU.

        Raises:
            ModelError: as there, but for what the values of tensors of the device are.
        """
        mode = self.mode if mode is None else mode
        if mode not in MODES:
            raise no_mode(mode, MODES)
        discrete, history = isinstance(self.features.spaces.action, DiscreteAction), self.features.history
        state, acted = self._sent(observation, "observations"), self._sent(actions, None if discrete else "actions")
        self.features.check_observation(state)
        if acted.ndim < 2 or len(acted) != len(state) or acted.shape[1] < history - 1:
            length = "T" if history == 1 else f"{history - 1} + T"
            message = f"actions should have shape ({len(state)}, {length}, ...), but have {tuple(acted.shape)}"
            raise ModelError(message)
        given = None if exogenous is None else self._sent(exogenous, "exogenous inputs")
        known = self.features.encode_exogenous(given, tuple(acted.shape[:2])).to(self.device)
        states = state.new_empty(len(state), acted.shape[1] - history + 1, state.shape[-1])
        for step in range(states.shape[1]):
            rows = slice(step, step + history)
            frames = (acted[:, step], known[:, step]) if history == 1 else (acted[:, rows], known[:, rows])
            after = self.step(state, *frames, mode=mode, generator=generator)[0]
            states[:, step] = after
            state = after if history == 1 else torch.cat([state[:, 1:], after.unsqueeze(1)], dim=1)
        return states

    @torch.no_grad()
    def step(
        self,
        observation: Float[Tensor, "sample ..."],
        action: Tensor,
        exogenous: Tensor,
        *,
        mode: Mode | None = None,
        generator: torch.Generator | None = None,
    ) -> tuple[Float[Tensor, "sample observation"], Int64[Tensor, " sample"]]:
        """Return next states of tensors of the device, and the member that each is from, or that is weighted most.

        Args:
            observation: states, as in `AddressedDynamics.step`.
            action: actions, as there.
            exogenous: exogenous inputs, as `features.encode_exogenous` returns them.
            mode: as there.
            generator: as there, one of the CPU.
        """
        mode = self.mode if mode is None else mode
        if mode == "argmax" and not self._many(len(observation)) and not observation.is_cpu:
            both = self._every_member(observation, action, exogenous)
            return both[:, :-1], both[:, -1].long()
        x = self.features.encode(observation, action, exogenous)
        probabilities = self.probabilities_of(x)
        output = self.combined(x, probabilities, mode, generator=generator)
        return self.features.decode(output, self._last(observation)), probabilities.argmax(dim=1)

    @torch.no_grad()
    def outputs(self, x: Float[Tensor, "sample input"]) -> Float[Tensor, "member sample output"]:
        """Return the outputs of every member for inputs, as `features.encode` returns them."""
        return self._ensemble.forward_all(x)

    @torch.no_grad()
    def probabilities_of(self, x: Float[Tensor, "sample input"]) -> Float[Tensor, "sample member"]:
        """Return what `AddressedDynamics.probabilities_of` does."""
        if self._addressing is None:
            return x.new_ones(len(x), 1)
        return torch.softmax(addressing_scores(self._addressing, x), dim=1)

    @torch.no_grad()
    def combined(
        self,
        x: Float[Tensor, "sample input"],
        probabilities: Float[Tensor, "sample member"],
        mode: Mode,
        *,
        outputs: Float[Tensor, "member sample output"] | None = None,
        generator: torch.Generator | None = None,
    ) -> Float[Tensor, "sample output"]:
        """Return what `AddressedDynamics.combined` does; the generator is one of the CPU."""
        match mode:
            case "argmax":
                return self.routed(x, probabilities.argmax(dim=1))
            case "sample":
                drawn = torch.multinomial(probabilities.nan_to_num(nan=1.0).cpu(), 1, generator=generator).squeeze(1)
                return self.routed(x, drawn.to(x.device))
            case "mixture":
                every = self._ensemble.forward_all(x) if outputs is None else outputs
                return (probabilities.T.unsqueeze(-1) * every).sum(dim=0)
            case "blend":
                return self._ensemble.forward_blended(x, probabilities)
            case _:
                raise no_mode(mode, MODES)

    @torch.no_grad()
    def routed(
        self, x: Float[Tensor, "sample input"], member: Int64[Tensor, " sample"]
    ) -> Float[Tensor, "sample output"]:
        """Return each sample's output from its own member, all on the device."""
        members = self._ensemble.members
        if members == 1:
            return self._ensemble.forward_all(x)[0]
        if not self._many(len(x)):
            picked = member.view(1, -1, 1).expand(1, -1, self._ensemble.widths[-1])
            return self._ensemble.forward_all(x).gather(0, picked)[0]
        # Sorted by member, the samples of each lie together.
        order, layers = member.argsort(stable=True), self._ensemble.layers
        counts = torch.bincount(member, minlength=members).cpu().tolist()
        sorted_x = x.index_select(0, order)
        hidden = layers.after_shared(sorted_x)
        parts = zip(torch.split(hidden, counts), torch.split(sorted_x, counts), strict=True)
        outputs = [layers.of_member(index).forward(*part) for index, part in enumerate(parts) if counts[index]]
        return x.new_empty(len(x), self._ensemble.widths[-1]).index_copy_(0, order, torch.cat(outputs))

    def _step_of_every_member(self, observation: Tensor, action: Tensor, exogenous: Tensor) -> Tensor:
        """Return next states in the mode `argmax` with the member's number as a last column: one tensor, one launch."""
        x = self.features.encode(observation, action, exogenous)
        member = self.probabilities_of(x).argmax(dim=1)
        after = self.features.decode(self.routed(x, member), self._last(observation))
        return torch.cat([after, member.unsqueeze(1).to(after.dtype)], dim=1)

    def _many(self, samples: int) -> bool:
        """Whether it is less work to sort so many samples than to evaluate members that are not asked for."""
        return (self._ensemble.members - 1) * samples * self._ensemble.multiply_adds(members=1) > SORTING_COST

    def _last(self, observation: Float[Tensor, "sample ..."]) -> Float[Tensor, "sample observation"]:
        return observation if self.features.history == 1 else observation[:, -1]

    def _sent(self, values: Values, what: str | None) -> Tensor:
        """Return values on the device: float32 and finite, or numbers of discrete actions, which there are."""
        if isinstance(values, Tensor) and not values.is_cpu:
            return values if what is None else values.to(torch.float32)
        if what is not None:
            return finite(as_tensor(values), what).to(self.device)
        action, numbers = self.features.spaces.action, as_tensor(values)
        assert isinstance(action, DiscreteAction)
        if numbers.is_floating_point() or bool(((numbers < 0) | (numbers >= action.count)).any()):
            # What is beyond the table a GPU does not refuse: it ends the process's work on it.
            message = f"actions should be integers in 0..{action.count - 1}, but some are not"
            raise ModelError(message)
        return numbers.to(self.device)


def rolled_out(
    model: AddressedDynamics,
    device: torch.device,
    observation: np.ndarray,
    actions: np.ndarray,
    mode: Mode,
    *,
    exogenous: np.ndarray | None,
    generator: torch.Generator,
) -> np.ndarray:
    """Return what `model.rollout` does of arrays, computed on a device."""
    if device.type == "cpu":
        return model.rollout(observation, actions, mode, exogenous=exogenous, generator=generator)
    there = ModelOnDevice(model, device)
    states: np.ndarray = (
        there.rollout(observation, actions, mode, exogenous=exogenous, generator=generator).cpu().numpy()
    )
    return states
