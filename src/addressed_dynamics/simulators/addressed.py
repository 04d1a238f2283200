"""AddressedDynamics: the learned simulator, an ensemble and the network that addresses it (the paper, Section 2)."""

from __future__ import annotations

from pathlib import Path
from typing import overload

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.networks.addressing import addressed_members, addressing_scores
from addressed_dynamics.networks.files import load_network
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.arrays import Plain, Values, answer, as_tensor
from addressed_dynamics.simulators.delivery import Parts, find_parts
from addressed_dynamics.simulators.modes import MODES, Mode


class AddressedDynamics:
    """A learned simulator: from states and actions to next states, in the environment's units."""

    def __init__(
        self,
        features: FeatureSpec,
        ensemble: StackedMLP,
        addressing: StackedMLP | None = None,
        *,
        mode: Mode = "argmax",
    ) -> None:
        """Put a model together.

        Args:
            features: what the networks' inputs and outputs mean.
            ensemble: n networks from inputs to targets.
            addressing: one network with n outputs, or n heads of one output on a trunk that they share; not needed if
                there is only one member.
            mode: how `predict` uses them if it is not told.

        Raises:
            ModelError: the networks do not fit each other or the features, or there is no such mode.
        """
        if (ensemble.widths[0], ensemble.widths[-1]) != (features.inputs, features.outputs):
            message = (
                f"the ensemble maps {ensemble.widths[0]} inputs to {ensemble.widths[-1]} outputs, "
                f"but the features have {features.inputs} and {features.outputs}"
            )
            raise ModelError(message)
        if addressing is None and ensemble.members > 1:
            message = f"an ensemble of {ensemble.members} members needs an addressing network"
            raise ModelError(message)
        if addressing is not None and (addressing.widths[0], addressed_members(addressing)) != (
            features.inputs,
            ensemble.members,
        ):
            message = (
                f"the addressing network should be one network with {features.inputs} inputs and {ensemble.members} "
                f"outputs, or {ensemble.members} heads of one output, "
                f"but is {addressing.members} with {addressing.widths[0]} and {addressing.widths[-1]}"
            )
            raise ModelError(message)
        if mode not in MODES:
            raise _no_mode(mode)
        self.features = features
        self.ensemble = ensemble
        self.addressing = addressing
        self.mode: Mode = mode

    @staticmethod
    def load(
        folder: str | Path, *, candidate: str | None = None, seed: int | None = None, variant: str | None = None
    ) -> AddressedDynamics:
        """Load a trained model: the one that is delivered, if nothing else is asked for.

        Args:
            folder: an experiment's model folder, for instance `data/models/mountaincar`.
            candidate: name of a baseline, for instance `total_parameters`; None for the ensemble.
            seed: which of the trained seeds; None for the one that is delivered, or for a baseline's first.
            variant: which addressing network, `plain` or `cost_sensitive`; None for the one delivered.

        Raises:
            ModelError: a file is missing or damaged, or there is no such candidate, seed or variant.
        """
        return AddressedDynamics.of(find_parts(Path(folder), candidate, seed, variant))

    @staticmethod
    def of(parts: Parts) -> AddressedDynamics:
        """Load the model that is made of `parts`, in the mode in which it is delivered.

        Raises:
            ModelError: a file is missing or damaged, or there is no such mode.
        """
        ensemble = load_network(parts.network, FeatureSpec)
        addressing = None if parts.addressing is None else load_network(parts.addressing, FeatureSpec).stack
        mode = next((each for each in MODES if each == parts.mode), None)
        if parts.mode is not None and mode is None:
            raise _no_mode(parts.mode)
        return AddressedDynamics(ensemble.features, ensemble.stack, addressing, mode=mode or "argmax")

    @overload
    def predict(
        self, observation: Tensor, action: Values, mode: Mode | None = ..., *, generator: torch.Generator | None = ...
    ) -> Tensor: ...
    @overload
    def predict(
        self, observation: Plain, action: Values, mode: Mode | None = ..., *, generator: torch.Generator | None = ...
    ) -> np.ndarray: ...
    @torch.no_grad()
    def predict(
        self, observation: Values, action: Values, mode: Mode | None = None, *, generator: torch.Generator | None = None
    ) -> Tensor | np.ndarray:
        """Return the states after the actions.

        A model with a history of H > 1 frames (`features.history`) is given H states in a row and the action taken in
        each, oldest first; what it returns follows the last.

        Args:
            observation: states, (B, d_obs) or (B, H, d_obs), in the environment's units, or one of them, (d_obs,) or
                (H, d_obs); an array, a list or a tensor.
            action: (B,) or (B, H) integers if the actions are discrete, else (B, d_act) or (B, H, d_act) in the
                environment's units.
            mode: `argmax`: the member with the highest output; `sample`: a member drawn with the outputs' softmax as
                probabilities; `mixture`: the members' outputs weighted by them; `blend`: the output of a network whose
                parameters are weighted by them. None for the model's own.
            generator: source of randomness for `sample`; None for torch's own.

        Returns:
            Next states, (B, d_obs), or (d_obs,) for one, float32; a tensor for a tensor, else an array.

        Raises:
            ModelError: a shape or the mode is wrong, or a discrete action does not exist.
        """
        states, actions, single = self._batch(observation, action)
        predicted = self._predict(states, actions, mode or self.mode, generator)
        return answer(predicted, observation, single=single)

    @overload
    def rollout(
        self, observation: Tensor, actions: Values, mode: Mode | None = ..., *, generator: torch.Generator | None = ...
    ) -> Tensor: ...
    @overload
    def rollout(
        self, observation: Plain, actions: Values, mode: Mode | None = ..., *, generator: torch.Generator | None = ...
    ) -> np.ndarray: ...
    @torch.no_grad()
    def rollout(
        self,
        observation: Values,
        actions: Values,
        mode: Mode | None = None,
        *,
        generator: torch.Generator | None = None,
    ) -> Tensor | np.ndarray:
        """Return the states after each of T actions, every state predicted from those predicted before it.

        Args:
            observation: first states, (B, d_obs), in the environment's units; an array, a list or a tensor. With a
                history of H > 1 frames (B, H, d_obs), oldest first. Or one of them, without B here and in `actions`.
            actions: (B, T) integers if the actions are discrete, else (B, T, d_act) in the environment's units. With a
                history (B, H - 1 + T) or (B, H - 1 + T, d_act): action h is taken in frame h.
            mode: as in `predict`.
            generator: as in `predict`.

        Returns:
            States, (B, T, d_obs), or (T, d_obs) from one, float32; a tensor for a tensor, else an array.

        Raises:
            ModelError: a shape or the mode is wrong, or a discrete action does not exist.
        """
        state, steps, single = self._batch(observation, actions, steps=True)
        state = state.to(torch.float32)
        self.features.check_observation(state)
        history = self.features.history
        if steps.ndim < 2 or len(steps) != len(state) or steps.shape[1] < history - 1:
            length = "T" if history == 1 else f"{history - 1} + T"
            message = f"actions should have shape ({len(state)}, {length}, ...), but have {tuple(steps.shape)}"
            raise ModelError(message)
        states = torch.empty(len(state), steps.shape[1] - history + 1, len(self.features.spaces.observation))
        for t in range(states.shape[1]):
            action = steps[:, t] if history == 1 else steps[:, t : t + history]
            states[:, t] = self._predict(state, action, mode or self.mode, generator)
            state = states[:, t] if history == 1 else torch.cat([state[:, 1:], states[:, t : t + 1]], dim=1)
        return answer(states, observation, single=single)

    @torch.no_grad()
    def member_outputs(self, observation: Values, action: Values) -> Float[Tensor, "member sample output"]:
        """Return the outputs of every member, normalised as `features.encode_target` normalises targets."""
        states, actions, _ = self._batch(observation, action)
        outputs: Tensor = self.ensemble(self.features.encode(states, actions))
        return outputs

    @torch.no_grad()
    def decode(
        self, output: Float[Tensor, "*member sample output"] | np.ndarray, observation: Values
    ) -> Float[Tensor, "*member sample observation"]:
        """Return the next states that outputs mean, in the environment's units, for inputs as those of `predict`."""
        states = as_tensor(observation).to(torch.float32)
        last = states if self.features.history == 1 else states[..., -1, :]
        return self.features.decode(as_tensor(output), last)

    def member_predictions(self, observation: Values, action: Values) -> Float[Tensor, "member sample observation"]:
        """Return what every member predicts, in the environment's units."""
        states, _, _ = self._batch(observation, action)
        return self.decode(self.member_outputs(observation, action), states)

    def address(self, observation: Values, action: Values) -> Int64[Tensor, " sample"]:
        """Return the member that the addressing network picks for each state and action, given as to `predict`."""
        return self.probabilities(observation, action).argmax(dim=1)

    @torch.no_grad()
    def probabilities(self, observation: Values, action: Values) -> Float[Tensor, "sample member"]:
        """Return the softmax of the addressing network's outputs; the member with the highest is selected."""
        states, actions, _ = self._batch(observation, action)
        return self.probabilities_of(self.features.encode(states, actions))

    def __repr__(self) -> str:
        addressing = "no addressing" if self.addressing is None else f"addressing {self.addressing.widths}"
        total = self.ensemble.parameters_total + (self.addressing.parameters_total if self.addressing else 0)
        names = ", ".join(self.features.spaces.observation_names)
        return (
            f"AddressedDynamics({self.mode}; {names}; {self.features.spaces.step_seconds:g} s a step, "
            f"history {self.features.history}, {self.ensemble.members} x {self.ensemble.widths}, {addressing}, "
            f"{total:,} parameters)"
        )

    def _batch(self, observation: Values, action: Values, *, steps: bool = False) -> tuple[Tensor, Tensor, bool]:
        """Return states and actions as tensors of a batch, and whether they were those of one sample.

        Args:
            observation: states.
            action: actions, in a row of them if there is a history, or if they are those of `steps`.
            steps: whether there is an action for each of many steps.

        Raises:
            ModelError: they are no numbers, or lists of different lengths.
        """
        states, actions = as_tensor(observation), as_tensor(action)
        spaces, history = self.features.spaces, self.features.history
        one = (len(spaces.observation),) if history == 1 else (history, len(spaces.observation))
        axes = int(steps or history > 1) + int(not isinstance(spaces.action, DiscreteAction))
        if states.shape == one and actions.ndim == axes:
            return states.unsqueeze(0), actions.unsqueeze(0), True
        return states, actions, False

    def _predict(
        self, observation: Tensor, action: Tensor, mode: Mode, generator: torch.Generator | None
    ) -> Float[Tensor, "sample observation"]:
        x = self.features.encode(observation, action)
        output = self.combined(x, self.probabilities_of(x), mode, generator=generator)
        return self.decode(output, observation)

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
        """Return the output that a mode makes of the members, normalised as `member_outputs` is.

        Args:
            x: inputs, as `features.encode` returns them.
            probabilities: what `probabilities_of` says of them.
            mode: as in `predict`.
            outputs: those of all members, if they are known.
            generator: as in `predict`.

        Raises:
            ModelError: there is no such mode.
        """
        match mode:
            case "argmax":
                return self.ensemble.forward_routed(x, probabilities.argmax(dim=1))
            case "sample":
                member = torch.multinomial(probabilities, 1, generator=generator).squeeze(1)
                return self.ensemble.forward_routed(x, member)
            case "mixture":
                return (probabilities.T.unsqueeze(-1) * (self.ensemble(x) if outputs is None else outputs)).sum(dim=0)
            case "blend":
                return self.ensemble.forward_blended(x, probabilities)
            case _:
                raise _no_mode(mode)

    @torch.no_grad()
    def probabilities_of(self, x: Float[Tensor, "sample input"]) -> Float[Tensor, "sample member"]:
        """Return the same as `probabilities`, for inputs as `features.encode` returns them."""
        if self.addressing is None:
            return torch.ones(len(x), 1)
        return torch.softmax(addressing_scores(self.addressing, x), dim=1)


def _no_mode(mode: str) -> ModelError:
    return ModelError(f"there is no addressing mode '{mode}' (modes: {', '.join(MODES)})")
