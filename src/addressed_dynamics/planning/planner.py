"""What all planners do: keep frames, hold actions, judge plans, and act on the best."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float32

from addressed_dynamics.base.errors import ModelError, PlanningError
from addressed_dynamics.base.torch_runtime import named_generator
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.planning.frames import Past
from addressed_dynamics.planning.judging import Cost, Doubt, Judge, judge
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.arrays import Values


class Plan(NamedTuple):
    """What a planner means to do, and what it expects of that."""

    actions: np.ndarray
    """(T,) integers, or (T, d_act) float32 in the environment's units."""
    states: Float32[np.ndarray, "step observation"]
    """States that the model predicts after each of them, in the environment's units."""
    cost: float
    """What that costs, with the penalty of steps that are not believed."""
    believed: int
    """Steps before the first one whose trust is below the threshold; T if there is none."""


class Planner(ABC):
    """Chooses actions by what their consequences cost in a learned simulator (model predictive control).

    A plan is made of blocks of `hold` steps with one action each. After each block the rest of the plan is where the
    search for the next begins.
    """

    def __init__(
        self,
        model: AddressedDynamics,
        cost: Cost,
        *,
        horizon: int,
        samples: int,
        iterations: int,
        hold: int = 1,
        warm_start: bool = True,
        trust: float | None = None,
        penalty: float | None = None,
        seed: int = 0,
    ) -> None:
        """Set a planner up.

        Args:
            model: the learned simulator; in its own mode.
            cost: what is to be small, (states (B, T, d_obs), actions (B, T[, d_act])) -> (B,) or (B, T), in arrays and
                the environment's units. Row t of the states follows action t. It is summed over the steps.
            horizon: steps that a plan looks ahead, T.
            samples: plans that are tried in each iteration, B.
            iterations: rounds of the search before each block.
            hold: steps for which an action is held. T is a multiple of it.
            warm_start: whether a search begins with the rest of the plan before.
            trust: least trust in a step, in (0, 1], for a model whose trust was calibrated: from a plan's first step
                with less on, it is not believed. One step in a hundred of validation episodes has a trust below 0.01,
                so of many steps one soon has. Without calibration a warning says why, and all is believed. None to
                believe all.
            penalty: what each step costs that is not believed, in the unit of the cost: in place of its own cost, or
                in addition if the cost is (B,). Give one larger than the cost of a bad step. Needed with `trust`.
            seed: of all randomness; the same seed, the same actions.

        Raises:
            PlanningError: a setting is none that a planner can have.
        """
        for name, value in {"horizon": horizon, "samples": samples, "iterations": iterations, "hold": hold}.items():
            check_whole(name, value, least=1)
        check_whole("seed", seed, least=0)
        if horizon % hold:
            message = f"the horizon should be a multiple of hold, {hold} steps, but is {horizon}"
            raise PlanningError(message)
        self.model, self.cost = model, cost
        self.horizon, self.samples, self.iterations, self.hold = horizon, samples, iterations, hold
        self.warm_start = warm_start
        self.plan: Plan | None = None
        """The last plan; None before the first."""
        self._doubt = _checked_doubt(model, trust, penalty)
        self._seed = seed
        self._past = Past(model.features)
        self._held = 0
        self._seeded()

    @property
    def missing(self) -> int:
        """How many frames must still be observed before a model with a history can plan."""
        return self._past.missing

    @property
    def blocks(self) -> int:
        """Number of actions in a plan, each held for `hold` steps."""
        return self.horizon // self.hold

    @property
    def trusts(self) -> bool:
        """Whether plans are believed only as far as the model is trusted."""
        return self._doubt is not None

    def reset(self, seed: int | None = None) -> None:
        """Forget frames and plans: a new episode begins.

        Args:
            seed: of what is drawn from now on; None for the one before, which then repeats.

        Raises:
            PlanningError: the seed is none.
        """
        if seed is not None:
            check_whole("seed", seed, least=0)
            self._seed = seed
        self._past.forget()
        self.plan, self._held = None, 0
        self._forget()
        self._seeded()

    def observe(self, state: Values, action: Values | int, *, exogenous: Values | None = None) -> None:
        """Tell of a step that somebody else chose the action of; what was planned before is dropped.

        A model with a history of H frames needs the H - 1 before the current one. `command` keeps those that it
        chooses an action in.

        Args:
            state: state in which the step began, (d_obs,), in the environment's units.
            action: action taken in it, an integer or (d_act,).
            exogenous: exogenous inputs during it, (d_exo,); None if the model has none.

        Raises:
            PlanningError: one of them has another shape.
            ModelError: a value is not finite.
        """
        self._past.add(state, action, exogenous)
        self.plan, self._held = None, 0
        self._forget()

    def command(
        self, state: Values, actions: Values | None = None, *, exogenous: Values | None = None
    ) -> int | Float32[np.ndarray, " action"]:
        """Return the action to take now.

        While an action is held, it is returned as it is, without a search. `plan` has what is expected.

        Args:
            state: current state, (d_obs,), in the environment's units; or of a model with a history the last H, oldest
                first, (H, d_obs), which take the place of the frames that were kept.
            actions: with H states, those taken in all but the last, (H - 1,) integers or (H - 1, d_act).
            exogenous: of a model with exogenous inputs, those during the steps ahead, (T, d_exo), in their own units;
                with H states those of all these frames, (H - 1 + T, d_exo).

        Returns:
            An integer, or (d_act,) float32 in the environment's units.

        Raises:
            PlanningError: a shape is wrong, frames are missing, or the cost has another shape or is not finite.
            ModelError: a value is not finite.
        """
        now, ahead = self._with_frames(state, actions, exogenous)
        situation = self._past.until(now, ahead, self.horizon)
        if self.plan is None or not self._held:
            judged = partial(
                judge, model=self.model, cost=self.cost, situation=situation, doubt=self._doubt, generator=self._torch
            )
            if self.plan is None or not self.warm_start:
                self._forget()
            self.plan, self._held = self._search(judged), self.hold
        action = self.plan.actions[0]
        self._held -= 1
        self._past.add(situation.states[-1], action, None if ahead is None else ahead[0])
        return int(action) if isinstance(self.model.features.spaces.action, DiscreteAction) else action.copy()

    @abstractmethod
    def _search(self, judge: Judge) -> Plan:
        """Return the best plan that is found, beginning with what `_forget` left or with the rest of the last."""

    @abstractmethod
    def _forget(self) -> None:
        """Begin the next search with nothing known."""

    def _stretched(self, blocks: np.ndarray) -> np.ndarray:
        """Return the actions of plans step by step, (B, T) or (B, T, d_act), as the model takes them."""
        actions = np.repeat(blocks, self.hold, axis=1)
        return actions if actions.dtype == np.int64 else actions.astype(np.float32)

    def _seeded(self) -> None:
        self._generator = np.random.default_rng(self._seed)
        self._torch: torch.Generator = named_generator(self._seed, "planning")

    def _with_frames(
        self, state: Values, actions: Values | None, exogenous: Values | None
    ) -> tuple[Values, Values | None]:
        """Keep the frames that were given, and return the current state and the exogenous inputs ahead of it."""
        if actions is None:
            return state, exogenous
        history = self.model.features.history
        states = self._past.states(state, (history,))
        before = self._past.actions(actions, (history - 1,))
        known = self._past.exogenous(exogenous, (history - 1 + self.horizon,))
        self._past.forget()
        own = known if known.shape[1] else None
        for frame in range(history - 1):
            self._past.add(states[frame], before[frame], None if own is None else own[frame])
        return states[-1], None if own is None else own[history - 1 :]


def check_whole(name: str, value: object, *, least: int) -> None:
    """Check a setting that is a whole number.

    Raises:
        PlanningError: it is none, or is less than the least.
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        message = f"{name} should be a whole number of at least {least}, but is {value!r}"
        raise PlanningError(message)


def _checked_doubt(model: AddressedDynamics, trust: float | None, penalty: float | None) -> Doubt | None:
    """Return where plans are not believed; None, with a warning, if the model cannot say.

    Raises:
        PlanningError: the threshold or the penalty is none.
    """
    if trust is None and penalty is None:
        return None
    if trust is None or not 0.0 < trust <= 1.0:
        message = f"trust should be a share above 0 and at most 1, below which a step is not believed, but is {trust}"
        raise PlanningError(message)
    if penalty is None or not np.isfinite(penalty):
        message = f"penalty should be what a step costs that is not believed, a finite number, but is {penalty}"
        raise PlanningError(message)
    try:
        model.trusted(model.mode)
    except ModelError as error:
        warnings.warn(f"plans are believed to their end: {error}", stacklevel=4)
        return None
    return Doubt(float(trust), float(penalty))
