"""Model predictive path integral control: the mean of noisy plans, weighted by how little they cost."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.base.errors import PlanningError
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.planning.bounds import Bounds, action_box
from addressed_dynamics.planning.distributions import following
from addressed_dynamics.planning.judging import Cost, Judge
from addressed_dynamics.planning.planner import Plan, Planner
from addressed_dynamics.simulators.addressed import AddressedDynamics


class MPPI(Planner):
    """Model predictive path integral control, for continuous actions.

    Noise is added to the plan of before, each noisy plan is rolled out in the model, and the new plan is their mean,
    weighted by exp(-cost / temperature).

    Source: Williams et al., Information Theoretic MPC for Model-Based Reinforcement Learning (2017). Where this departs
    from it: that may be repeated before each action, noisy plans are clipped to the bounds before they are tried, one
    of them has no noise, and no cost of control is added to the user's cost, which sees the actions.
    """

    def __init__(
        self,
        model: AddressedDynamics,
        cost: Cost,
        *,
        horizon: int,
        temperature: float,
        samples: int = 200,
        iterations: int = 1,
        noise: float = 0.25,
        bounds: Bounds | None = None,
        hold: int = 1,
        warm_start: bool = True,
        trust: float | None = None,
        penalty: float | None = None,
        seed: int = 0,
    ) -> None:
        """Set a planner up.

        Args:
            model: the learned simulator; in its own mode.
            cost: as `Planner` has it.
            horizon: steps that a plan looks ahead, T.
            temperature: in the unit of a plan's cost: a plan that costs so much more than the best has 1/e of its
                weight. As large as differences between good plans are.
            samples: plans that are tried in each iteration, B.
            iterations: rounds of the search before each block.
            noise: standard deviation of the noise, as a share of the range of each component.
            bounds: lowest and highest action, each a number or one for each component, in their units; None for the
                model's.
            hold: steps for which an action is held.
            warm_start: as `Planner` has it.
            trust: as `Planner` has it.
            penalty: as `Planner` has it.
            seed: of all randomness.

        Raises:
            PlanningError: a setting is none that a planner can have, actions are discrete, or have no bounds.
        """
        super().__init__(
            model, cost, horizon=horizon, samples=samples, iterations=iterations, hold=hold, warm_start=warm_start,
            trust=trust, penalty=penalty, seed=seed,
        )  # fmt: skip
        action = model.features.spaces.action
        if isinstance(action, DiscreteAction):
            message = f"MPPI is for continuous actions, but the model has {action.count} discrete ones; use CEM"
            raise PlanningError(message)
        for name, value in {"temperature": temperature, "noise": noise}.items():
            if not 0.0 < value < np.inf:
                message = f"{name} should be a finite number above 0, but is {value}"
                raise PlanningError(message)
        self.temperature = temperature
        self._box = action_box(action, bounds)
        self._deviation = noise * (self._box.high - self._box.low)
        self._forget()

    def _forget(self) -> None:
        self._mean = np.tile((self._box.low + self._box.high) / 2, (self.blocks, 1))

    def _search(self, judge: Judge) -> Plan:
        for _ in range(self.iterations):
            noise = self._generator.standard_normal((self.samples, *self._mean.shape)) * self._deviation
            noise[0] = 0.0
            tried = np.clip(self._mean + noise, *self._box)
            self._mean = np.tensordot(
                path_weights(judge(self._stretched(tried)).costs, self.temperature), tried, axes=1
            )
        actions = self._stretched(self._mean[None])
        judged = judge(actions)
        self._mean = following(self._mean)
        return Plan(actions[0], judged.states[0], float(judged.costs[0]), int(judged.believed[0]))


def path_weights(costs: Float64[np.ndarray, " plan"], temperature: float) -> Float64[np.ndarray, " plan"]:
    """Return the weights of plans, which sum to 1 (Williams et al. 2017).

    Args:
        costs: of the plans; one at least is finite.
        temperature: in their unit.
    """
    weights = np.exp(-(costs - costs.min()) / temperature)
    total: Float64[np.ndarray, " plan"] = weights / weights.sum()
    return total
