"""What plans cost in the learned simulator, and how much of them is believed."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, Int64
from torch import Tensor

from addressed_dynamics.base.errors import PlanningError
from addressed_dynamics.planning.frames import Situation
from addressed_dynamics.simulators.addressed import AddressedDynamics

Cost: TypeAlias = "Callable[[np.ndarray, np.ndarray], np.ndarray]"
"""(states (B, T, d_obs), actions (B, T) or (B, T, d_act)) -> the cost of each plan, (B,), or of each step, (B, T).

Arrays, in the environment's units; row t of the states follows action t. What is forbidden has a large cost, not an
infinite one."""


class Doubt(NamedTuple):
    """Where a plan is no longer believed."""

    trust: float
    """Least trust in a step, in [0, 1], as `AddressedDynamics.trust` has it."""
    penalty: float
    """Cost of that step and of every one after it: in place of the steps' own costs, or beside the cost of a plan."""


class Judged(NamedTuple):
    """What plans come to."""

    costs: Float64[np.ndarray, " plan"]
    """Cost of each; infinite if its states are no finite numbers."""
    states: Float32[np.ndarray, "plan step observation"]
    """States that were predicted, in the environment's units."""
    believed: Int64[np.ndarray, " plan"]
    """Steps before the first that is not trusted; all of them if trust was not asked for."""


Judge: TypeAlias = "Callable[[np.ndarray], Judged]"
"""Actions of plans, (B, T) or (B, T, d_act) -> what they come to."""


def judge(
    actions: np.ndarray,
    model: AddressedDynamics,
    cost: Cost,
    situation: Situation,
    doubt: Doubt | None,
    generator: torch.Generator,
) -> Judged:
    """Roll plans out and return what they come to.

    Args:
        actions: of each plan, (B, T) integers or (B, T, d_act) in the environment's units.
        model: where they are carried out.
        cost: the user's.
        situation: from where they begin.
        doubt: where they are no longer believed; None to believe all.
        generator: for a model whose members are drawn.

    Raises:
        PlanningError: the cost has another shape or is not finite, or no plan has states that are finite.
    """
    states, trusted = _rolled_out(actions, model, situation, doubt, generator)
    finite = np.isfinite(states).all(axis=(1, 2))
    if not finite.any():
        message = (
            f"under none of {len(actions)} plans the model's states stay finite over {states.shape[1]} steps; "
            "shorten the horizon, or take a model that holds longer"
        )
        raise PlanningError(message)
    found = _checked_cost(cost(states[finite], actions[finite].copy()), int(finite.sum()), states.shape[1])
    costs = np.full(len(actions), np.inf)
    costs[finite] = _with_doubt(found, trusted[finite], doubt)
    return Judged(costs, states, trusted.sum(axis=1))


def _rolled_out(
    actions: np.ndarray,
    model: AddressedDynamics,
    situation: Situation,
    doubt: Doubt | None,
    generator: torch.Generator,
) -> tuple[Float32[np.ndarray, "plan step observation"], Bool[np.ndarray, "plan step"]]:
    """Return the states, and which steps come before the first one that is not trusted."""
    number = len(actions)
    start = situation.states if model.features.history > 1 else situation.states[0]
    given = _repeated(start, number)
    ahead = torch.from_numpy(actions)
    taken = ahead if situation.actions is None else torch.cat([_repeated(situation.actions, number), ahead], dim=1)
    exogenous = _repeated(situation.exogenous, number) if situation.exogenous.shape[1] else None
    if doubt is None:
        states = model.rollout(given, taken, exogenous=exogenous, generator=generator).numpy()
        return states, np.ones(states.shape[:2], np.bool_)
    # Intervals are not asked for, but come with trust; any coverage that was calibrated will do.
    coverage = model.trusted(model.mode).coverages[0]
    known = model.rollout(given, taken, exogenous=exogenous, generator=generator, with_trust=True, coverage=coverage)
    return known.states.numpy(), np.logical_and.accumulate(known.trust.numpy() >= doubt.trust, axis=1)


def _repeated(values: np.ndarray, number: int) -> Tensor:
    return torch.from_numpy(values).expand(number, *values.shape)


def _with_doubt(
    costs: Float64[np.ndarray, " ..."], trusted: Bool[np.ndarray, "plan step"], doubt: Doubt | None
) -> Float64[np.ndarray, " plan"]:
    """Return the costs of plans, with the penalty of what is not believed."""
    penalties = np.zeros(trusted.shape) if doubt is None else np.where(trusted, 0.0, doubt.penalty)
    own = np.where(trusted, costs, 0.0).sum(axis=1) if costs.ndim == 2 else costs
    total: Float64[np.ndarray, " plan"] = own + penalties.sum(axis=1)
    return total


def _checked_cost(costs: object, plans: int, steps: int) -> Float64[np.ndarray, " ..."]:
    """Return what the user's cost says as float64.

    Raises:
        PlanningError: it is of another shape, or not finite.
    """
    try:
        found = np.asarray(costs, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        message = f"the cost should return an array of numbers, but returned {type(costs).__name__} ({error})"
        raise PlanningError(message) from error
    if found.shape not in ((plans,), (plans, steps)):
        message = (
            f"the cost should return shape ({plans},), one number a plan, or ({plans}, {steps}), one a step, "
            f"but returned {found.shape}"
        )
        raise PlanningError(message)
    if not (good := np.isfinite(found)).all():
        place = tuple(np.argwhere(~good)[0].tolist())
        message = (
            f"the cost should be finite, but {found[place]:g} was returned at [{', '.join(map(str, place))}]; "
            "the states it was given are finite; give what is forbidden a large cost"
        )
        raise PlanningError(message)
    return found
