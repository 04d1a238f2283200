"""What the evaluation of transitions finds: evaluation.json, as it is written and read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import model_validator

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.base.params.training import AddressingTraining, EnsembleParams
from addressed_dynamics.evaluation.common.bootstrap import FEWEST_ROLLOUTS
from addressed_dynamics.evaluation.common.records import BaselineLosses, Dropped, Record, Specialisations
from addressed_dynamics.evaluation.transitions.reward_records import TaskRecord
from addressed_dynamics.evaluation.transitions.trust_records import TrustRecord
from addressed_dynamics.simulators.delivery import Why
from addressed_dynamics.sources.transitions.params import FeatureParams


class Summary(Record):
    """Spread of losses over samples."""

    mean: float
    median: float
    p99: float
    max: float


class Misclassified(Summary):
    """Losses of the samples for which a member is selected although another is better."""

    per_thousand: float


class MemberResult(Record):
    """A row of Table 1."""

    share: float
    selected: float | None
    not_selected: float | None
    misclassified: Misclassified


class AddressingResult(Record):
    """Table 1 of one ensemble with one addressing network."""

    samples: int
    members: tuple[MemberResult, ...]
    agreement: float
    misclassified_per_thousand: float
    regret: Summary
    confusion: tuple[tuple[int, ...], ...]


class DimensionResult(Record):
    """One-step errors of one dimension of the state, in its own unit."""

    name: str
    unit: str
    squared: Summary
    absolute: Summary


class OneStepResult(Record):
    """One-step errors of one candidate."""

    scaled: Summary
    dimensions: tuple[DimensionResult, ...]
    """Those of the state, then its angles if it holds any."""
    percent: float | None = None
    """Root mean square over the dimensions of the state, in % of the range; None in results of earlier versions."""

    def named(self, names: Sequence[str]) -> list[DimensionResult]:
        """Return the dimensions and angles of these names.

        Raises:
            ReportError: one of them was not measured.
        """
        found = {each.name: each for each in self.dimensions}
        for name in names:
            if name not in found:
                message = f"evaluation.json: there is no one-step error of '{name}'; run evaluate again"
                raise ReportError(message)
        return [found[name] for name in names]


class EpisodeSpread(Record):
    """Spread of an error over rollouts."""

    median: float
    mean: float
    p10: float | None = None
    """None, like the next, of fewer rollouts than percentiles take."""
    p90: float | None = None
    max: float


class LostTime(Record):
    """Time until an angle is off by more than the limit, in seconds, over episodes."""

    p10: float | None
    """None, like the next two, if it lies beyond the end of the rollouts; this and `p90` also of too few rollouts."""
    median: float | None
    p90: float | None
    never_share: float
    """Share of the episodes in which it never is."""


class PhysicsResult(Record):
    """Rollouts of Acrobot by their angles and energy."""

    lost_seconds: LostTime
    energy_error: EpisodeSpread
    """Mean difference from the true energy over a rollout, in J."""
    energy_drift: EpisodeSpread
    """Difference from the energy of the first state at the end of a rollout, in J."""


class RolloutGroup(Record):
    """Errors over some of the rollouts."""

    episodes: int
    """Held-out episodes that they begin in; beside an environment each is one of its own."""
    rollouts: int | None = None
    """None in results of earlier versions, in which `episodes` counts them."""
    mse: dict[str, EpisodeSpread | None]
    physics: PhysicsResult | None = None
    """None if it was not asked for, or if there are no episodes."""

    @property
    def number(self) -> int:
        """How many rollouts there are."""
        return self.episodes if self.rollouts is None else self.rollouts

    @property
    def tells(self) -> bool:
        """Whether they are enough for percentiles, and for saying that one model is better than another."""
        return self.number >= FEWEST_ROLLOUTS


class Horizon(Record):
    """How long the median rollout of a candidate keeps its error below 10 % of the range."""

    seconds: float
    """Until it is lost; the length of the rollouts, if it is not."""
    lost: bool


class RolloutResult(Record):
    """Rollout errors of one candidate."""

    left_bounds_share: float | None
    """None if the state has no bounds."""
    flown_off_share: float | None = None
    """Share of the rollouts that fly off: far outside of all that was trained on, or no numbers; None if that was not
    counted, as of true simulations and in results of earlier versions."""
    groups: dict[str, RolloutGroup]
    """Over `all` episodes first, then over those of each group that is told apart."""
    horizon: Horizon | None = None
    """None for a simulation, as in results of earlier versions."""

    @model_validator(mode="after")
    def _has_all(self) -> RolloutResult:
        if "all" not in self.groups:
            message = "there is no group 'all'"
            raise ValueError(message)
        return self

    @property
    def all(self) -> RolloutGroup:
        """Over all episodes."""
        return self.groups["all"]


class SimulationResult(RolloutResult):
    """What the true equations of motion make of the rollouts."""

    label: str


class RolloutPhysics(Record):
    """How rollouts are judged by their angles and energy."""

    step_seconds: float
    angle_limit: float
    """An angle that is off by more has lost the truth, in rad."""
    apart: float
    """How far two true simulations are apart at the start, in rad."""
    simulations: dict[str, SimulationResult]
    """What stands beside the models, by their names in horizon.csv."""


class RatioResult(Record):
    """An error in multiples of the addressed ensemble's on the same episodes, with its 95 % interval over episodes."""

    value: float
    low: float
    high: float


class ErrorAfter(Record):
    """The errors of a candidate after so many steps of its own predictions, over the rollouts on held-out episodes."""

    name: str = ""
    """What the table of measures calls it."""
    steps: int
    """The last of which is judged alone."""
    rollouts: int
    """Rollouts that last as long."""
    percent: float
    """Root mean square over rollouts and dimensions, in % of the range."""
    median_percent: float
    """The same over dimensions, of the median rollout."""
    dimensions: dict[str, float]
    """Root mean square over rollouts, of each dimension in its own unit."""
    interval: dict[str, float] | None = None
    """Half of the width of the 90 % interval of each dimension, of the median rollout; None of what has none."""


class BesideEnsemble(Record):
    """The errors of a candidate in multiples of the addressed ensemble's.

    None where there are too few episodes, where nothing is to divide by, or of rollouts where there are none.
    """

    one_step: RatioResult | None
    """Of the mean losses of states scaled to [0, 1]."""
    rollouts: RatioResult | None
    """Of the medians over rollouts of the mean squared error, in ranges, over all dimensions."""
    dimensions: dict[str, RatioResult | None]
    """The same of each dimension of the state."""


class CandidateResult(Record):
    """All that was measured of one candidate."""

    label: str
    parameters: int
    multiply_adds: int | None = None
    """Of one prediction, addressing included; None if unknown, as in results of earlier versions."""
    one_step: OneStepResult
    rollouts: RolloutResult | None = None
    errors_after: tuple[ErrorAfter, ...] = ()
    """After a step, 1 s and 10 s (10 and 100 steps where a step has no duration), as far as rollouts last."""
    beside_ensemble: BesideEnsemble | None = None
    """None of the oracle, and in results of earlier versions."""


class Recipe(Record):
    """How an ensemble and the network that addresses it are trained."""

    features: FeatureParams
    ensemble: EnsembleParams
    addressing: AddressingTraining


class OtherRecipe(Record):
    """The ensemble with the recipe that was not chosen, which is one of the baselines."""

    name: Literal["paper_recipe", "default_recipe"]
    """Name of the baseline."""
    recipe: Recipe
    specialisation: Specialisations
    """By its own loss, which may be another than that of the delivered model."""


class Addressed(Record):
    """Which of the addressed ensembles stands for all of them."""

    seed: int
    variant: str


class Choice(Record):
    """Which model is delivered."""

    candidate: str
    """A key of `candidates`."""
    why: Why


class HeldOut(Record):
    """What was held out."""

    transitions: int
    episodes: int
    dropped: Dropped = Dropped()
    """Episodes shorter than the history of a model, which are not among these."""


class RolloutSource(Record):
    """What the rollouts are held against."""

    kind: Literal["environment", "recorded"]
    steps: int
    steps_wanted: int
    """As many as the params file asks for; more than `steps` if no held-out episode is as long."""
    too_short: dict[str, int]
    """Segments of the recording that have no held-out episode as long, each with the steps of its longest."""
    dropped: Dropped = Dropped()
    """Held-out episodes that are shorter than a rollout with its history."""
    overlapping: bool = False
    """Whether they overlap, as they do where fewer than 20 that do not are in the held-out episodes."""
    physics: RolloutPhysics | None
    """None if it was not asked for."""
    exogenous: tuple[str, ...] = ()
    """Names of the exogenous inputs, whose recorded values are replayed."""


ADDRESSED = "ensemble/argmax"
"""The ensemble that stands for all, with the paper's addressing."""
NOTHING = "persistence"
"""The reference by which nothing changes."""
REFERENCES = (NOTHING, "last_change", "linear", "linear_frame")
"""What any model has to beat."""
_OTHER_BASELINES = (
    *REFERENCES, "total_parameters", "same_size", "unequal_bins", "random_bins", "paper_recipe", "default_recipe",
)  # fmt: skip


class ScoreRecord(Record):
    """What a candidate reaches on validation episodes; errors are root mean squares in % of the range."""

    one_step_percent: float
    rollout_percent: float
    horizon_seconds: float


class Recommendation(Record):
    """Which model is the best on validation episodes."""

    candidate: str
    """A key of `candidates`."""
    label: str
    best: str | None = None
    """The candidate that holds longest, if the simplest of those that are about as good is another."""
    beats_references: bool
    """Whether it was trained; so it is no worse than nothing and than least squares in rollouts, nor than nothing one
    step ahead."""
    rollouts: int
    """Rollouts on validation episodes that it was chosen by."""
    scores: dict[str, ScoreRecord]
    """Of every candidate that can be loaded."""


class NoiseFloor(Record):
    """What differs between steps that begin alike, by the gamma test: nearest neighbours of test transitions."""

    neighbours: int
    """Neighbours of each."""
    transitions: int
    """Test transitions that were judged."""
    among: int
    """Training transitions among which neighbours were looked for."""
    scaled: float
    """Mean loss of states scaled to [0, 1], of the dimensions that a network predicts."""
    percent: float
    """Root mean square of all dimensions, in % of the range."""
    absolute: dict[str, float]
    """Mean absolute value of the noise in each dimension, in its own unit."""


class Repeats(Record):
    """How many test transitions stand in the training data too, and what the delivered model makes of the others."""

    rows: int
    """Test transitions that were looked for."""
    among: int
    """Training transitions that they were looked for among."""
    exact: int
    """Those with exactly the state, the action and the exogenous inputs of one of the training."""
    alike: int
    """Those and others that differ from one of the training by the rounding of float32."""
    percent: float
    """Root mean square error one step ahead, in % of the range."""
    percent_without: float | None
    """The same without those that are alike; None if all are."""


class FallingPart(Record):
    """Some steps in a row of the delivered model's rollouts; errors are medians, in % of the range."""

    first_step: int
    last_step: int
    percent: float
    held_share: float
    """Share of the true states that stand still or are at a bound."""
    held_percent: float | None
    """Error there; None if there are none."""
    free_percent: float | None
    """Error in all others."""


class Falling(Record):
    """Why the errors of long rollouts fall."""

    highest: FallingPart
    """Where they are largest."""
    end: FallingPart


class Evaluation(Record):
    """evaluation.json."""

    loss: str
    test: HeldOut
    rollouts: RolloutSource
    delivered: Addressed
    """The addressed ensemble that the report is about."""
    seeds: dict[str, dict[str, AddressingResult]]
    candidates: dict[str, CandidateResult]
    specialisation: Specialisations
    baseline_losses: BaselineLosses
    other_recipe: OtherRecipe | None
    """From its first seed; None if it was not trained."""
    recommendation: Recommendation | None = None
    """None if there are no validation episodes to choose by."""
    trust: TrustRecord | None = None
    """None if it was not measured, as in results of earlier versions."""
    noise_floor: NoiseFloor | None = None
    """None if there are too few training transitions, as in results of earlier versions."""
    reward: TaskRecord | None = None
    """Who says reward and end of a learned environment; None in results of earlier versions."""
    repeats: Repeats | None = None
    """None in results of earlier versions."""
    falling: Falling | None = None
    """None if the delivered model's errors do not fall again in long rollouts, and in results of earlier versions."""
    choice: Choice = Choice(candidate=ADDRESSED, why="asked")
    """Earlier versions delivered nothing but the addressed ensemble."""

    @model_validator(mode="after")
    def _has_the_other_recipe(self) -> Evaluation:
        if self.other_recipe and not self.baseline(self.other_recipe.name):
            message = f"'{self.other_recipe.name}' is the other recipe, so there should be a candidate of it"
            raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _has_what_is_delivered(self) -> Evaluation:
        if self.choice.candidate not in self.candidates:
            message = f"'{self.choice.candidate}' is delivered, but was not measured"
            raise ValueError(message)
        return self

    @property
    def table(self) -> AddressingResult:
        """Table 1 of the addressed ensemble."""
        return self.seeds[str(self.delivered.seed)][self.delivered.variant]

    @property
    def own(self) -> CandidateResult:
        """The addressed ensemble with the paper's addressing."""
        return self.candidates[ADDRESSED]

    @property
    def chosen(self) -> CandidateResult:
        """The delivered model."""
        return self.candidates[self.choice.candidate]

    @property
    def own_seeds(self) -> list[CandidateResult]:
        """The addressed ensemble and those of the other seeds."""
        return [self.own, *self._named("ensemble/argmax/seed-")]

    def baseline(self, name: str) -> list[CandidateResult]:
        """Return a baseline from all its seeds; empty if it was not trained."""
        return self._named(f"{name}/seed-")

    def seeds_of(self, name: str) -> list[str]:
        """Return the seeds of a baseline, in the order of `baseline`."""
        prefix = f"{name}/seed-"
        return [each.removeprefix(prefix) for each in self.candidates if each.startswith(prefix)]

    @property
    def single_networks(self) -> list[str]:
        """Names of the single networks of sizes of their own, in the order of evaluation."""
        names = [name.partition("/seed-")[0] for name in self.candidates if not name.startswith("ensemble/")]
        return [name for name in dict.fromkeys(names) if name not in _OTHER_BASELINES]

    def _named(self, prefix: str) -> list[CandidateResult]:
        return [candidate for name, candidate in self.candidates.items() if name.startswith(prefix)]
