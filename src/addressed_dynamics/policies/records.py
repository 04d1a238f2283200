"""What is known of a policy that was learned in a model, as it is kept beside it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float64
from scipy.stats import binomtest

if TYPE_CHECKING:
    from addressed_dynamics.policies.playing import Played

INDEX, FIGURES, CURVE, ARRAYS = "policy.json", "figures.json", "learning.csv", "arrays.npz"
"""Files of its folder, beside its weights."""
LOW_TRUST = 0.05
"""Trust below which a step is one of the rarest twentieth, if the data are like the validation episodes."""
COVERAGE = 0.95
"""Of all intervals."""
_DRAWS = 2_000


@dataclass(frozen=True)
class Estimate:
    """A number of a few episodes, with an interval for what it is of all."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Score:
    """What some episodes came to."""

    episodes: int
    returns: Estimate
    """Mean return; the interval is of a bootstrap over episodes."""
    steps: float
    """Mean length, in steps."""
    ended: Estimate
    """Share that ended inside the task; the interval is Wilson's."""


@dataclass(frozen=True)
class TrustAlong:
    """How far the model knows where the policy goes in truth."""

    decisions: int
    """Decisions of the true episodes before which the model had seen enough frames; the first step of each counts."""
    low: float
    """Share of them with a trust below `LOW_TRUST`."""
    episodes_low: float
    """Share of the episodes with more than one in ten of them."""


@dataclass(frozen=True)
class PolicyFigures:
    """All that was measured."""

    reward: str
    """Who says reward and end."""
    candidate: str | None
    """The model that was learned in; None for the one that is delivered."""
    environment: str | None
    """The true environment; None, like what is measured there, if there is none."""
    hold: int
    """Steps for which an action is held: a decision."""
    decisions: int
    """Made while it was learned, over all copies."""
    copies: int
    episode_steps: int
    """Longest episode, in steps."""
    least_ended: float | None
    """Share of the true episodes that should end inside the task; None if nothing is asked for."""
    kept_decisions: int
    """Decisions made before the policy was as it is kept."""
    model: Score
    """In the model, from recorded starts that no check has drawn."""
    offline_decisions: int
    """Decisions in the recording, from which the learner without a world learned."""
    offline: Score
    """Of the learner without a world: in truth, or in the model if there is no environment."""
    truth: Score | None = None
    """In the true environment."""
    beside: Score | None = None
    """In the model, from the first states of the true episodes."""
    gap: Estimate | None = None
    """Return in truth less that in the model from the same first state: mean over the pairs."""
    trust: TrustAlong | None = None
    """None without an environment, or if the trust was not calibrated."""
    true_learner: Score | None = None
    """In truth, of the same learner that learned there, with as many steps."""

    def to_json(self) -> dict[str, Any]:
        """Return everything as JSON-compatible values."""
        return asdict(self)

    @property
    def headline(self) -> dict[str, float]:
        """The figures that a table of runs should show."""
        found = {"return/model": self.model.returns.value, "ended/model": self.model.ended.value}
        where = "model" if self.truth is None else "truth"
        found[f"return/{where}_offline"] = self.offline.returns.value
        found[f"ended/{where}_offline"] = self.offline.ended.value
        if self.truth and self.gap:
            found |= {"return/truth": self.truth.returns.value, "ended/truth": self.truth.ended.value}
            found["return/gap"] = self.gap.value
        if self.true_learner:
            found["return/truth_learned_there"] = self.true_learner.returns.value
            found["ended/truth_learned_there"] = self.true_learner.ended.value
        return found | ({"trust/low": self.trust.low} if self.trust else {})


def score_of(played: Played) -> Score:
    """Return what episodes came to, with intervals."""
    number, ended = len(played.returns), int(played.ended.sum())
    interval = binomtest(ended, number).proportion_ci(COVERAGE, method="wilson")
    share = Estimate(ended / number, float(interval.low), float(interval.high))
    return Score(number, mean_of(played.returns), float(played.steps.mean()), share)


def mean_of(values: Float64[np.ndarray, " episode"]) -> Estimate:
    """Return a mean with the interval of a bootstrap over episodes: as many are drawn as there are, with repetition."""
    number = len(values)
    weights = np.random.default_rng(0).multinomial(number, np.full(number, 1.0 / number), size=_DRAWS)
    tail = (1.0 - COVERAGE) / 2.0
    low, high = np.quantile(weights @ values / number, [tail, 1.0 - tail])
    return Estimate(float(values.mean()), float(low), float(high))
