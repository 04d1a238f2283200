"""AddressedDynamics: the learned simulator, an ensemble and the network that addresses it (the paper, Section 2)."""

from __future__ import annotations

from operator import attrgetter
from pathlib import Path
from typing import Literal, NamedTuple, cast, overload

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.features.transitions.frozen import FrozenFeatures
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.networks.addressing import addressed_members
from addressed_dynamics.networks.files import load_network, read_index
from addressed_dynamics.networks.frozen import FrozenMLP
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.arrays import Plain, Values, answer, as_tensor, finite, shown_names
from addressed_dynamics.simulators.delivery import Origin, Parts, find_parts
from addressed_dynamics.simulators.modes import MODES, Mode, check_choice, no_mode
from addressed_dynamics.simulators.trust import SIGNALS, Expectation, Followed, Scales, Trust, TrustedRollout
from addressed_dynamics.simulators.trusted import TrustFile, find_trust, is_calibrated

_VERSION = attrgetter("_version")
"""How often a parameter has been changed in place."""


class AddressedDynamics:
    """A learned simulator: from states and actions to next states, in the environment's units.

    Exogenous inputs, such as a wind, are known and not predicted. A model that has some (`features.spaces.exogenous`)
    must be given them beside the actions, and no other model may be.

    Every method takes tensors, arrays or lists, of a batch or of one sample, and answers one sample without the axis of
    the batch; with a tensor if the first argument is one, else with an array.
    """

    def __init__(
        self,
        features: FeatureSpec,
        ensemble: StackedMLP,
        addressing: StackedMLP | None = None,
        *,
        mode: Mode = "argmax",
        origin: Origin | None = None,
        trust: Trust | TrustFile | None = None,
    ) -> None:
        """Put a model together.

        Args:
            features: what the networks' inputs and outputs mean.
            ensemble: n networks from inputs to targets.
            addressing: one network with n outputs, or n heads of one output on a trunk that they share; not needed if
                there is only one member.
            mode: how `predict` uses them if it is not told.
            origin: which of an experiment's models it is, for `repr`; None if it is none of them.
            trust: how far it is to be trusted, or where that is written; None if nobody knows.

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
            raise no_mode(mode, MODES)
        self.features = features
        self.ensemble = ensemble
        self.addressing = addressing
        self.mode: Mode = mode
        self.origin = origin
        self._trust = trust
        self._features = FrozenFeatures(features)
        self._parameters = tuple(each for network in (ensemble, addressing) if network for each in network.parameters())
        self._seen_as: tuple[FeatureSpec, bool] = (features, True)
        self._frozen: tuple[tuple[int, ...], FrozenMLP, FrozenMLP | None] | None = None

    @staticmethod
    def load(
        folder: str | Path,
        *,
        candidate: str | None = None,
        seed: int | None = None,
        variant: str | None = None,
        mode: Mode | None = None,
    ) -> AddressedDynamics:
        """Load a trained model: the one that is delivered, if nothing else is asked for.

        Args:
            folder: an experiment's model folder, for instance `data/models/mountaincar`; or the folder of one of its
                baselines, which leaves no candidate, seed or variant to choose.
            candidate: name of a baseline, for instance `total_parameters`, `ensemble`, or `recommended` for the best on
                validation episodes; None for what is delivered.
            seed: which of the trained seeds; None for the one that is delivered, or for a baseline's first.
            variant: which addressing network, `plain` or `cost_sensitive`; None for the one delivered.
            mode: how `predict` uses the members if it is not told, as there; None for how the model is delivered, or
                for `argmax` if it is not the one delivered. A single network has no modes.

        Raises:
            ModelError: a file is missing or damaged, or there is no such candidate, seed, variant or mode.
        """
        parts = find_parts(Path(folder), candidate, seed, variant)
        model = AddressedDynamics.of(parts, mode=mode)
        model._trust = TrustFile(Path(folder), parts.origin, model.mode)
        return model

    @staticmethod
    def of(parts: Parts, *, mode: Mode | None = None) -> AddressedDynamics:
        """Load the model that is made of `parts`, in a mode, or else in the mode in which it is delivered.

        Raises:
            ModelError: a file is missing or damaged, or the model has no such mode.
        """
        asked = parts.mode or "argmax" if mode is None else mode
        used = next((each for each in MODES if each == asked), None)
        if used is None:
            raise no_mode(asked, MODES)
        _check_version(parts.network)
        ensemble = load_network(parts.network, FeatureSpec)
        if mode is not None:
            check_choice(mode, ensemble.stack.members)
        addressing = None if parts.addressing is None else load_network(parts.addressing, FeatureSpec).stack
        return AddressedDynamics(ensemble.features, ensemble.stack, addressing, mode=used, origin=parts.origin)

    @overload
    def predict(
        self,
        observation: Tensor,
        action: Values,
        mode: Mode | None = ...,
        *,
        exogenous: Values | None = ...,
        generator: torch.Generator | None = ...,
    ) -> Tensor: ...
    @overload
    def predict(
        self,
        observation: Plain,
        action: Values,
        mode: Mode | None = ...,
        *,
        exogenous: Values | None = ...,
        generator: torch.Generator | None = ...,
    ) -> np.ndarray: ...
    def predict(
        self,
        observation: Values,
        action: Values,
        mode: Mode | None = None,
        *,
        exogenous: Values | None = None,
        generator: torch.Generator | None = None,
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
            exogenous: the exogenous inputs during the steps, (B, d_exo) or (B, H, d_exo), in their own units; None if,
                and only if, the model has none.
            generator: source of randomness for `sample`; None for torch's own.

        Returns:
            Next states, (B, d_obs), or (d_obs,) for one, float32; a tensor for a tensor, else an array.

        Raises:
            ModelError: a shape or the mode is wrong, a value is not finite, a discrete action does not exist, or
                exogenous inputs are missing or not asked for.
        """
        given, single = self._batch(observation, action, exogenous)
        predicted = self._next(_Step.of(*given), self._mode(mode), generator)
        return answer(predicted, observation, single=single)

    @overload
    def rollout(
        self,
        observation: Tensor,
        actions: Values,
        mode: Mode | None = ...,
        *,
        exogenous: Values | None = ...,
        generator: torch.Generator | None = ...,
        with_trust: Literal[False] = ...,
        coverage: float = ...,
    ) -> Tensor: ...
    @overload
    def rollout(
        self,
        observation: Plain,
        actions: Values,
        mode: Mode | None = ...,
        *,
        exogenous: Values | None = ...,
        generator: torch.Generator | None = ...,
        with_trust: Literal[False] = ...,
        coverage: float = ...,
    ) -> np.ndarray: ...
    @overload
    def rollout(
        self,
        observation: Values,
        actions: Values,
        mode: Mode | None = ...,
        *,
        exogenous: Values | None = ...,
        generator: torch.Generator | None = ...,
        with_trust: Literal[True],
        coverage: float = ...,
    ) -> TrustedRollout: ...
    @torch.no_grad()
    def rollout(
        self,
        observation: Values,
        actions: Values,
        mode: Mode | None = None,
        *,
        exogenous: Values | None = None,
        generator: torch.Generator | None = None,
        with_trust: bool = False,
        coverage: float = 0.9,
    ) -> Tensor | np.ndarray | TrustedRollout:
        """Return the states after each of T actions, every state predicted from those predicted before it.

        Args:
            observation: first states, (B, d_obs), in the environment's units; an array, a list or a tensor. With a
                history of H > 1 frames (B, H, d_obs), oldest first. Or one of them, without B here and in `actions`.
            actions: (B, T) integers if the actions are discrete, else (B, T, d_act) in the environment's units. With a
                history (B, H - 1 + T) or (B, H - 1 + T, d_act): action h is taken in frame h.
            mode: as in `predict`.
            exogenous: the exogenous inputs during each step, (B, T, d_exo) or (B, H - 1 + T, d_exo), in their own
                units: row t stands beside action t. None if, and only if, the model has none.
            generator: as in `predict`.
            with_trust: whether to return the interval of every state, as in `interval`, and the trust in every step.
            coverage: of these intervals.

        Returns:
            States, (B, T, d_obs), or (T, d_obs) from one, float32; a tensor for a tensor, else an array. With trust a
            tuple of the states, the ends of their intervals and the trust, (B, T) or (T,).

        Raises:
            ModelError: as in `predict`, or, with trust, as in `interval`.
        """
        (state, steps, known), single = self._batch(observation, actions, exogenous, steps=True)
        mode = self._mode(mode)
        self.features.check_observation(state)
        history = self.features.history
        if steps.ndim < 2 or len(steps) != len(state) or steps.shape[1] < history - 1:
            length = "T" if history == 1 else f"{history - 1} + T"
            message = f"actions should have shape ({len(state)}, {length}, ...), but have {tuple(steps.shape)}"
            raise ModelError(message)
        replayed = self.features.encode_exogenous(known, tuple(steps.shape[:2]))
        if with_trust:
            trust = self.trusted(mode)
            trust.check_coverage(coverage)
            followed = self.follow(state, steps, replayed, trust.scales, mode, generator)
            low, high = trust.ends(followed.states, followed.scale, coverage)
            each_step = torch.from_numpy(trust.trust(followed.signals))
            parts = (followed.states, low, high, each_step)
            return TrustedRollout(*(answer(each, observation, single=single) for each in parts))
        first, acted, beside = state.numpy(), steps.numpy(), replayed.numpy()
        # The states that were given, and after them those that follow.
        states = np.empty((len(first), steps.shape[1] + 1, first.shape[-1]), np.float32)
        states[:, :history] = first.reshape(len(first), history, first.shape[-1])
        for t in range(steps.shape[1] - history + 1):
            rows = t if history == 1 else slice(t, t + history)
            given = _Step(states[:, rows], acted[:, rows], beside[:, rows])
            states[:, t + history] = self._next(given, mode, generator)
        return answer(states[:, history:].copy(), observation, single=single)

    @torch.no_grad()
    def follow(
        self,
        state: Tensor,
        actions: Tensor,
        exogenous: Tensor,
        scales: Expectation,
        mode: Mode,
        generator: torch.Generator | None = None,
    ) -> Followed:
        """Return a rollout with what is expected of its errors.

        Args:
            state: first states, as in `rollout`, as float32.
            actions: (B, H - 1 + T, ...), as in `rollout`.
            exogenous: exogenous inputs beside the actions, as `features.encode_exogenous` returns them.
            scales: what is expected of the errors of one step.
            mode: as in `predict`.
            generator: as in `predict`.
        """
        history = self.features.history
        shape = (len(state), actions.shape[1] - history + 1, len(self.features.spaces.observation))
        states, sums = torch.empty(shape), torch.empty(shape)
        signals, total = [], torch.zeros(shape[0], shape[2])
        for t in range(shape[1]):
            rows = t if history == 1 else slice(t, t + history)
            given = (state, actions[:, rows], exogenous[:, rows])
            # What is no number any more has no input; its trust is 0, and what it predicts is no number either.
            x = self.encoded(*given)
            states[:, t] = self.step(*given, mode=mode, generator=generator, x=x)
            found = scales(self, *given, states[:, t], x)
            total = total + found.error
            sums[:, t] = total
            signals.append(found.signals)
            state = states[:, t] if history == 1 else torch.cat([state[:, 1:], states[:, t : t + 1]], dim=1)
        each = np.stack(signals, axis=-1) if signals else np.empty((len(SIGNALS), shape[0], 0))
        return Followed(states, sums, each)

    @overload
    def interval(
        self, observation: Tensor, action: Values, coverage: float = ..., *, exogenous: Values | None = ...
    ) -> tuple[Tensor, Tensor]: ...
    @overload
    def interval(
        self, observation: Plain, action: Values, coverage: float = ..., *, exogenous: Values | None = ...
    ) -> tuple[np.ndarray, np.ndarray]: ...
    @torch.no_grad()
    def interval(
        self, observation: Values, action: Values, coverage: float = 0.9, *, exogenous: Values | None = None
    ) -> tuple[Tensor, Tensor] | tuple[np.ndarray, np.ndarray]:
        """Return intervals in which the next states lie: each dimension of its own in such a share of cases.

        They were calibrated on validation episodes of the experiment, and hold for states that are like those.

        Args:
            observation: states, as in `predict`.
            action: actions, as in `predict`.
            coverage: share of cases, between 0 and 1.
            exogenous: as in `predict`.

        Returns:
            Lower and upper ends, (B, d_obs), or (d_obs,) for one, in the environment's units.

        Raises:
            ModelError: as in `predict`; there is no such coverage, or nobody calibrated the model.
        """
        given, single = self._batch(observation, action, exogenous)
        trust = self.trusted(self.mode)
        trust.check_coverage(coverage)
        predicted, found = self._expected(trust, *given)
        ends = trust.ends(predicted.unsqueeze(1), found.error.unsqueeze(1), coverage)
        low, high = (answer(each[:, 0], observation, single=single) for each in ends)
        return cast("tuple[Tensor, Tensor] | tuple[np.ndarray, np.ndarray]", (low, high))

    @overload
    def trust(self, observation: Tensor, action: Values, *, exogenous: Values | None = ...) -> Tensor: ...
    @overload
    def trust(self, observation: Plain, action: Values, *, exogenous: Values | None = ...) -> np.ndarray: ...
    @torch.no_grad()
    def trust(self, observation: Values, action: Values, *, exogenous: Values | None = None) -> Tensor | np.ndarray:
        """Return how far the predictions are to be trusted: the share of validation points that were less usual.

        How usual a point is follows from its distance to the training data and from how far a second model predicts
        otherwise. On data like the validation episodes trust is spread evenly over [0, 1]; it is 0 beyond all of them,
        and of a state that is not finite.

        Args:
            observation: states, as in `predict`; they may be not finite.
            action: actions, as in `predict`.
            exogenous: as in `predict`.

        Returns:
            (B,), or () for one sample; float64.

        Raises:
            ModelError: as in `predict`, or nobody calibrated the model.
        """
        states = as_tensor(observation).to(torch.float32)
        finite = np.isfinite(states.numpy())
        known = finite.all()
        asked = states if known else states.nan_to_num(nan=0.0, posinf=0.0, neginf=0.0)
        given, single = self._batch(asked, action, exogenous)
        trust = self.trusted(self.mode)
        _, found = self._expected(trust, *given)
        share = trust.trust(found.signals)
        if not known:
            share = np.where(finite.reshape(len(given[0]), -1).all(axis=1), share, 0.0)
        return answer(share, observation, single=single)

    @overload
    def surprise(
        self, observation: Tensor, action: Values, next_observation: Values, *, exogenous: Values | None = ...
    ) -> Tensor: ...
    @overload
    def surprise(
        self, observation: Plain, action: Values, next_observation: Values, *, exogenous: Values | None = ...
    ) -> np.ndarray: ...
    @torch.no_grad()
    def surprise(
        self, observation: Values, action: Values, next_observation: Values, *, exogenous: Values | None = None
    ) -> Tensor | np.ndarray:
        """Return how surprising what happened is: minus the logarithm of the share of validation steps more so.

        It is 1 on average on data like the validation episodes, so its mean over some steps tells whether what is
        modelled has changed, even where no state looks unusual. A next state that is not finite is infinitely so.

        Args:
            observation: states, as in `predict`.
            action: actions, as in `predict`.
            next_observation: the states that followed, (B, d_obs).
            exogenous: as in `predict`.

        Returns:
            (B,), or () for one sample; float64.

        Raises:
            ModelError: as in `predict`; the next states have another shape, or nobody calibrated the model.
        """
        given, single = self._batch(observation, action, exogenous)
        after = as_tensor(next_observation).to(torch.float32)
        after = after.unsqueeze(0) if single and after.ndim == 1 else after
        expected = (len(given[0]), len(self.features.spaces.observation))
        if after.shape != expected:
            message = f"next states should have shape {expected}, but have {tuple(after.shape)}"
            raise ModelError(message)
        trust = self.trusted(self.mode)
        predicted, found = self._expected(trust, *given)
        surprises = torch.from_numpy(trust.surprises(after - predicted, found.error))
        return answer(surprises, observation, single=single)

    def trusted(self, mode: Mode) -> Trust:
        """Return what was calibrated of the model in a mode.

        Raises:
            ModelError: nothing was, or a file is missing or damaged.
        """
        if mode != self.mode:
            message = f"trust was calibrated in the model's own mode, '{self.mode}', not in '{mode}'; load it in that"
            raise ModelError(message)
        if isinstance(self._trust, TrustFile):
            self._trust = find_trust(self._trust, self)
        if self._trust is None:
            message = (
                "nobody calibrated how far this model is to be trusted; evaluation does that for the models that are "
                "delivered and recommended: load one of them from the folder of the experiment's models"
            )
            raise ModelError(message)
        return self._trust

    def trusted_if_calibrated(self) -> Trust | None:
        """Return what was calibrated of the model in its own mode; None if nothing was.

        Raises:
            ModelError: a file is missing or damaged.
        """
        if isinstance(self._trust, TrustFile) and not is_calibrated(self._trust):
            return None
        return None if self._trust is None else self.trusted(self.mode)

    def _expected(
        self, trust: Trust, observation: Tensor, action: Tensor, exogenous: Tensor | None
    ) -> tuple[Tensor, Scales]:
        x = self.encoded(observation, action, exogenous)
        predicted = self.step(observation, action, exogenous, x=x)
        return predicted, trust.scales(self, observation, action, exogenous, predicted, x)

    @overload
    def member_outputs(self, observation: Tensor, action: Values, *, exogenous: Values | None = ...) -> Tensor: ...
    @overload
    def member_outputs(self, observation: Plain, action: Values, *, exogenous: Values | None = ...) -> np.ndarray: ...
    @torch.no_grad()
    def member_outputs(
        self, observation: Values, action: Values, *, exogenous: Values | None = None
    ) -> Tensor | np.ndarray:
        """Return the outputs of every member, (n, B, d_out), or (n, d_out) for one sample.

        They are normalised as `features.encode_target` normalises targets.

        Raises:
            ModelError: as in `predict`.
        """
        given, single = self._batch(observation, action, exogenous)
        return answer(self.ensemble(self.features.encode(*given)), observation, single=single, axis=1)

    @overload
    def decode(self, output: Tensor, observation: Values) -> Tensor: ...
    @overload
    def decode(self, output: Plain, observation: Values) -> np.ndarray: ...
    @torch.no_grad()
    def decode(self, output: Values, observation: Values) -> Tensor | np.ndarray:
        """Return the next states that outputs mean, in the environment's units.

        Args:
            output: as `member_outputs` returns them, (n, B, d_out), or those of one member, (B, d_out); without B if
                `observation` is one sample.
            observation: as in `predict`.

        Raises:
            ModelError: a shape is wrong, or a state is not finite.
        """
        states, single = self._states(observation)
        self.features.check_observation(states)
        outputs = as_tensor(output).to(torch.float32)
        batch = outputs.unsqueeze(-2) if single and outputs.ndim else outputs
        expected = (len(states), self.features.outputs)
        if batch.ndim not in (2, 3) or batch.shape[-2:] != expected:
            shape = str(expected[1:] if single else expected)
            message = (
                f"outputs should have shape {shape}, or that for each member, for these observations, "
                f"but have {tuple(outputs.shape)}"
            )
            raise ModelError(message)
        return answer(self._decoded(batch.numpy(), states.numpy()), output, single=single, axis=-2)

    @overload
    def member_predictions(self, observation: Tensor, action: Values, *, exogenous: Values | None = ...) -> Tensor: ...
    @overload
    def member_predictions(
        self, observation: Plain, action: Values, *, exogenous: Values | None = ...
    ) -> np.ndarray: ...
    @torch.no_grad()
    def member_predictions(
        self, observation: Values, action: Values, *, exogenous: Values | None = None
    ) -> Tensor | np.ndarray:
        """Return what every member predicts, (n, B, d_obs), or (n, d_obs) for one sample, in the environment's units.

        Raises:
            ModelError: as in `predict`.
        """
        given, single = self._batch(observation, action, exogenous)
        predicted = self._decoded(self.ensemble(self.features.encode(*given)).numpy(), given[0].numpy())
        return answer(predicted, observation, single=single, axis=1)

    @overload
    def address(self, observation: Tensor, action: Values, *, exogenous: Values | None = ...) -> Tensor: ...
    @overload
    def address(self, observation: Plain, action: Values, *, exogenous: Values | None = ...) -> np.ndarray: ...
    @torch.no_grad()
    def address(self, observation: Values, action: Values, *, exogenous: Values | None = None) -> Tensor | np.ndarray:
        """Return the member that the addressing network picks, (B,) int64, or () for one sample.

        Raises:
            ModelError: as in `predict`.
        """
        given, single = self._batch(observation, action, exogenous)
        picked = self.probabilities_of(self.features.encode(*given)).argmax(dim=1)
        return answer(picked, observation, single=single)

    @overload
    def probabilities(self, observation: Tensor, action: Values, *, exogenous: Values | None = ...) -> Tensor: ...
    @overload
    def probabilities(self, observation: Plain, action: Values, *, exogenous: Values | None = ...) -> np.ndarray: ...
    @torch.no_grad()
    def probabilities(
        self, observation: Values, action: Values, *, exogenous: Values | None = None
    ) -> Tensor | np.ndarray:
        """Return the softmax of the addressing network's outputs, (B, n), or (n,) for one sample.

        The member with the highest is selected.

        Raises:
            ModelError: as in `predict`.
        """
        given, single = self._batch(observation, action, exogenous)
        return answer(self.probabilities_of(self.features.encode(*given)), observation, single=single)

    def __repr__(self) -> str:
        spaces, addressing = self.features.spaces, self.addressing
        networks = f"{self.ensemble.members} x {self.ensemble.widths}"
        total = self.ensemble.parameters_total + (addressing.parameters_total if addressing else 0)
        action = spaces.action
        names = action.names if isinstance(action, DiscreteAction) else [each.name for each in action.dimensions]
        parts = (
            *(() if self.origin is None else (str(self.origin),)),
            f"mode {self.mode}" if addressing else "single network",
            f"states {shown_names(spaces.observation_names)}",
            f"actions {shown_names(names)}",
            *((f"exogenous {shown_names([each.name for each in spaces.exogenous])}",) if spaces.exogenous else ()),
            f"{spaces.step_seconds:g} s a step",
            f"history {self.features.history}",
            f"{networks}, addressing {addressing.widths}" if addressing else networks,
            f"{total:,} parameters",
        )
        return f"AddressedDynamics({'; '.join(parts)})"

    def _mode(self, mode: Mode | None) -> Mode:
        """Return the mode that is meant.

        Raises:
            ModelError: there is no such mode.
        """
        if mode is not None and mode not in MODES:
            raise no_mode(mode, MODES)
        return self.mode if mode is None else mode

    def _batch(
        self, observation: Values, action: Values, exogenous: Values | None, *, steps: bool = False
    ) -> tuple[tuple[Tensor, Tensor, Tensor | None], bool]:
        """Return states, actions and exogenous inputs as tensors of a batch, and whether they were of one sample.

        Args:
            observation: states.
            action: actions, in a row of them if there is a history, or if they are those of `steps`.
            exogenous: exogenous inputs, as the actions; None for none.
            steps: whether there is an action for each of many steps.

        Raises:
            ModelError: they are no finite numbers, or lists of different lengths.
        """
        (states, one), actions = self._states(observation), as_tensor(action)
        discrete = isinstance(self.features.spaces.action, DiscreteAction)
        if not discrete:
            actions = finite(actions, "actions")
        known = None if exogenous is None else finite(as_tensor(exogenous), "exogenous inputs")
        in_a_row = int(steps or self.features.history > 1)
        if one and actions.ndim == in_a_row + int(not discrete):
            alone = known is not None and known.ndim == in_a_row + 1
            return (states, actions.unsqueeze(0), known.unsqueeze(0) if known is not None and alone else known), True
        return (states[0] if one else states, actions, known), False

    def _states(self, observation: Values) -> tuple[Float[Tensor, "sample ..."], bool]:
        """Return states as a batch, and whether they were those of one sample."""
        states = finite(as_tensor(observation), "observations")
        history, width = self.features.history, len(self.features.spaces.observation)
        one = states.shape == ((width,) if history == 1 else (history, width))
        return states.unsqueeze(0) if one else states, one

    def _decoded(
        self, output: Float[np.ndarray, "*member sample output"], observation: Float[np.ndarray, "sample ..."]
    ) -> Float[np.ndarray, "*member sample observation"]:
        with np.errstate(over="ignore", invalid="ignore"):
            return self._features.decode(output, self._last(observation))

    def _last(self, observation: Float[np.ndarray, "sample ..."]) -> Float[np.ndarray, "sample observation"]:
        """Return the states before a step: of a history, the last."""
        return observation if self.features.history == 1 else observation[:, -1]

    def step(
        self,
        observation: Tensor,
        action: Tensor,
        exogenous: Tensor | None,
        *,
        mode: Mode | None = None,
        generator: torch.Generator | None = None,
        x: Float[Tensor, "sample input"] | None = None,
    ) -> Float[Tensor, "sample observation"]:
        """Return the same as `predict`, for tensors of a batch that were looked at before.

        Args:
            observation: states, float32.
            action: actions.
            exogenous: exogenous inputs, float32.
            mode: as in `predict`.
            generator: as in `predict`.
            x: what `features.encode` makes of them, if that is known.

        Raises:
            ModelError: a shape is wrong.
        """
        given = _Step.of(observation, action, exogenous, x)
        return torch.from_numpy(self._next(given, self.mode if mode is None else mode, generator))

    def step_and_probabilities(
        self,
        observation: Tensor,
        action: Tensor,
        exogenous: Tensor | None,
        *,
        mode: Mode | None = None,
        generator: torch.Generator | None = None,
        x: Float[Tensor, "sample input"] | None = None,
    ) -> tuple[Float[Tensor, "sample observation"], Float[Tensor, "sample member"]]:
        """Return the same as `step` and as `probabilities`, at the cost of the former.

        Raises:
            ModelError: a shape is wrong.
        """
        given = _Step.of(observation, action, exogenous, x)
        after, probabilities = self._weighted(given, self.mode if mode is None else mode, generator)
        return torch.from_numpy(after), probabilities

    def step_and_member(
        self,
        observation: Tensor,
        action: Tensor,
        exogenous: Tensor | None,
        *,
        x: Float[Tensor, "sample input"] | None = None,
    ) -> tuple[Float[Tensor, "sample observation"], Int64[Tensor, " sample"]]:
        """Return the same as `step`, and the member that each state is from, or that is weighted most.

        Raises:
            ModelError: a shape is wrong.
        """
        given = _Step.of(observation, action, exogenous, x)
        if self.mode == "argmax":
            after, member = self._routed(given)
            return torch.from_numpy(after), torch.from_numpy(member)
        after, probabilities = self._weighted(given, self.mode, None)
        return torch.from_numpy(after), probabilities.argmax(dim=1)

    def _next(
        self, step: _Step, mode: Mode, generator: torch.Generator | None
    ) -> Float[np.ndarray, "sample observation"]:
        """Return the next states."""
        if mode == "argmax":
            return self._routed(step)[0]
        return self._weighted(step, mode, generator)[0]

    def _routed(self, step: _Step) -> tuple[Float[np.ndarray, "sample observation"], Int64[np.ndarray, " sample"]]:
        """Return the next states in the mode `argmax`, and the member that each is from."""
        ensemble, addressing = self._networks()
        # A rollout that has left all bounds goes on with what is no number.
        with np.errstate(over="ignore", invalid="ignore"):
            x = self._encoded(step)
            member = np.zeros(len(x), np.int64) if addressing is None else addressing.scores(x).argmax(axis=1)
            output = ensemble.forward_routed(x, member)
            return self._features.decode(output, self._last(step.observation)), member

    @torch.no_grad()
    def _weighted(
        self, step: _Step, mode: Mode, generator: torch.Generator | None
    ) -> tuple[Float[np.ndarray, "sample observation"], Float[Tensor, "sample member"]]:
        """Return the next states in any mode, and the members' probabilities."""
        ensemble, addressing = self._networks()
        x = torch.from_numpy(self._encoded(step))
        probabilities = _probabilities(addressing, x)
        output = _combined(ensemble, x, probabilities, mode, generator)
        return self._decoded(output.numpy(), step.observation), probabilities

    def sees_as(self, other: AddressedDynamics) -> bool:
        """Return whether another model is given the same inputs."""
        # Features have a hundred numbers to compare; a model and its partner are asked at every step.
        if self._seen_as[0] is not other.features:
            self._seen_as = other.features, other.features == self.features
        return self._seen_as[1]

    def encoded(self, observation: Tensor, action: Tensor, exogenous: Tensor | None) -> Float[Tensor, "sample input"]:
        """Return the same as `features.encode`, sooner.

        Raises:
            ModelError: a shape is wrong, or a discrete action does not exist.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            return torch.from_numpy(self._encoded(_Step.of(observation, action, exogenous)))

    def _encoded(self, step: _Step) -> Float[np.ndarray, "sample input"]:
        """Return the inputs of a step.

        Raises:
            ModelError: a shape is wrong, or a discrete action does not exist.
        """
        if step.x is not None:
            return step.x
        x = self._features.encode(*step[:3])
        if x is None:
            # Says what is wrong.
            known = None if step.exogenous is None else torch.from_numpy(step.exogenous)
            x = self.features.encode(torch.from_numpy(step.observation), torch.from_numpy(step.action), known).numpy()
        return x

    def _networks(self) -> tuple[FrozenMLP, FrozenMLP | None]:
        """Return the networks as they are evaluated, made anew if weights have changed."""
        versions = tuple(map(_VERSION, self._parameters))
        if self._frozen is None or self._frozen[0] != versions:
            addressing = None if self.addressing is None else FrozenMLP(self.addressing)
            self._frozen = versions, FrozenMLP(self.ensemble), addressing
        return self._frozen[1:]

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
        return _combined(self._networks()[0], x, probabilities, mode, generator, outputs)

    @torch.no_grad()
    def probabilities_of(self, x: Float[Tensor, "sample input"]) -> Float[Tensor, "sample member"]:
        """Return the same as `probabilities`, for inputs as `features.encode` returns them."""
        return _probabilities(self._networks()[1], x)


class _Step(NamedTuple):
    """What a step of a batch begins with, as arrays that were looked at before."""

    observation: Float[np.ndarray, "sample ..."]
    action: np.ndarray
    exogenous: np.ndarray | None
    x: Float[np.ndarray, "sample input"] | None = None
    """What `features.encode` makes of them, if that is known."""

    @staticmethod
    def of(observation: Tensor, action: Tensor, exogenous: Tensor | None, x: Tensor | None = None) -> _Step:
        """Return the same of tensors, which have no gradients."""
        known = None if exogenous is None else exogenous.numpy()
        return _Step(observation.numpy(), action.numpy(), known, None if x is None else x.numpy())


def _probabilities(addressing: FrozenMLP | None, x: Float[Tensor, "sample input"]) -> Float[Tensor, "sample member"]:
    if addressing is None:
        return torch.ones(len(x), 1)
    with np.errstate(over="ignore", invalid="ignore"):
        return torch.softmax(torch.from_numpy(addressing.scores(x.numpy())), dim=1)


def _combined(
    ensemble: FrozenMLP,
    x: Float[Tensor, "sample input"],
    probabilities: Float[Tensor, "sample member"],
    mode: Mode,
    generator: torch.Generator | None,
    outputs: Float[Tensor, "member sample output"] | None = None,
) -> Float[Tensor, "sample output"]:
    match mode:
        case "argmax":
            return _routed(ensemble, x, probabilities.argmax(dim=1))
        case "sample":
            # A rollout that has left all bounds has no probabilities; which member says NaN is all the same.
            drawn = torch.multinomial(probabilities.nan_to_num(nan=1.0), 1, generator=generator)
            return _routed(ensemble, x, drawn.squeeze(1))
        case "mixture":
            every = ensemble.forward_all(x) if outputs is None else outputs
            return (probabilities.T.unsqueeze(-1) * every).sum(dim=0)
        case "blend":
            return ensemble.forward_blended(x, probabilities)
        case _:
            raise no_mode(mode, MODES)


def _routed(
    ensemble: FrozenMLP, x: Float[Tensor, "sample input"], member: Int64[Tensor, " sample"]
) -> Float[Tensor, "sample output"]:
    with np.errstate(over="ignore", invalid="ignore"):
        return torch.from_numpy(ensemble.forward_routed(x.numpy(), member.numpy()))


def _check_version(folder: Path) -> None:
    """Check that a network is not of the first version, whose features lack what today's have.

    Raises:
        ModelError: it is; or its config.json is missing or damaged.
    """
    features = read_index(folder, "config.json").get("features")
    if isinstance(features, dict) and "kind" not in features and "history" not in features:
        message = (
            f"{folder}: the first version of this package trained this model, which knew no history; train it again: "
            "'dvc repro'"
        )
        raise ModelError(message)
