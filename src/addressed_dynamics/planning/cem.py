"""The cross-entropy method: draw plans, keep the best of them, draw the next ones like those."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from addressed_dynamics.base.errors import PlanningError
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.planning.bounds import Bounds, action_box
from addressed_dynamics.planning.distributions import Categorical, Distribution, Gaussian, following
from addressed_dynamics.planning.judging import Cost, Judge
from addressed_dynamics.planning.planner import Plan, Planner, check_whole
from addressed_dynamics.simulators.addressed import AddressedDynamics


class Found(NamedTuple):
    """The best of some plans."""

    blocks: np.ndarray
    """Its actions, one a block."""
    plan: Plan
    """What it comes to."""


class CEM(Planner):
    """The cross-entropy method for optimisation, on discrete actions or on continuous ones.

    In each iteration plans are drawn, rolled out in the model, and the distribution moves to the `elites` that cost
    least, with smoothed updating. Discrete actions are drawn from a categorical distribution in each block, continuous
    ones from a normal distribution that is clipped to the bounds.

    Sources: Rubinstein & Kroese, The Cross-Entropy Method (2004); de Boer et al., A Tutorial on the Cross-Entropy
    Method (2005). Where this departs from them: the likeliest plan and the best so far (at first the rest of the plan
    before) are among those tried, and the one that costs least of all is carried out, as in iCEM (Pinneri et al. 2020).
    """

    def __init__(
        self,
        model: AddressedDynamics,
        cost: Cost,
        *,
        horizon: int,
        samples: int = 200,
        elites: int | None = None,
        iterations: int = 4,
        smoothing: float = 0.8,
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
            samples: plans that are tried in each iteration, B.
            elites: how many of them the distribution moves to; None for a tenth, and 2 at least.
            iterations: rounds of the search before each block.
            smoothing: how far it moves, in (0, 1].
            bounds: lowest and highest action, each a number or one for each component, in their units; None for the
                model's. Discrete actions have none.
            hold: steps for which an action is held.
            warm_start: as `Planner` has it.
            trust: as `Planner` has it.
            penalty: as `Planner` has it.
            seed: of all randomness.

        Raises:
            PlanningError: a setting is none that a planner can have, or continuous actions have no bounds.
        """
        super().__init__(
            model, cost, horizon=horizon, samples=samples, iterations=iterations, hold=hold, warm_start=warm_start,
            trust=trust, penalty=penalty, seed=seed,
        )  # fmt: skip
        self.elites = min(samples, max(2, samples // 10)) if elites is None else elites
        self.smoothing = smoothing
        check_whole("elites", self.elites, least=1)
        if self.elites > samples:
            message = f"elites should be at most as many as the samples, {samples}, but are {elites}"
            raise PlanningError(message)
        if not 0.0 < smoothing <= 1.0:
            message = f"smoothing should be above 0 and at most 1, but is {smoothing}"
            raise PlanningError(message)
        action = model.features.spaces.action
        if isinstance(action, DiscreteAction):
            if bounds is not None:
                message = "discrete actions have no bounds; leave bounds= out"
                raise PlanningError(message)
            self._open: Distribution = Categorical.uniform(self.blocks, action.count)
        else:
            self._open = Gaussian.middle(self.blocks, action_box(action, bounds))
        self._forget()

    def _forget(self) -> None:
        self._first = self._open
        self._rest: np.ndarray | None = None

    def _search(self, judge: Judge) -> Plan:
        best, distribution = self._round(judge, self._first, self._rest)
        for _ in range(self.iterations - 1):
            found, distribution = self._round(judge, distribution, best.blocks)
            best = min(best, found, key=lambda each: each.plan.cost)
        self._first, self._rest = distribution.shifted(), following(best.blocks)
        return best.plan

    def _round(self, judge: Judge, distribution: Distribution, best: np.ndarray | None) -> tuple[Found, Distribution]:
        """Return the best of some plans, and the distribution that moved to the elites.

        Args:
            judge: what plans come to.
            distribution: where they are drawn.
            best: the best plan so far, which is tried again; None if there is none.
        """
        tried = distribution.draw(self.samples, self._generator)
        sure = [distribution.likeliest()] if best is None else [best, distribution.likeliest()]
        tried[: len(sure)] = sure[: self.samples]
        actions = self._stretched(tried)
        judged = judge(actions)
        order = np.argsort(judged.costs, kind="stable")
        least = int(order[0])
        plan = Plan(actions[least], judged.states[least], float(judged.costs[least]), int(judged.believed[least]))
        return Found(tried[least], plan), distribution.fitted(tried[order[: self.elites]], self.smoothing)
