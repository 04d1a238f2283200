"""What the JSON files of the earlier stages hold, as far as a report shows it."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field


class Record(BaseModel):
    """Base of what is read from JSON: frozen; keys that a report does not show are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


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


class EpisodeSpread(Record):
    """Spread of a rollout error over episodes."""

    median: float
    mean: float
    p10: float
    p90: float
    max: float


class RolloutGroup(Record):
    """Rollout errors over some of the episodes."""

    episodes: int
    mse: dict[str, EpisodeSpread | None]


class RolloutResult(Record):
    """Rollout errors of one candidate."""

    left_bounds_share: float | None
    """None if the state has no bounds."""
    all: RolloutGroup
    no_wall: RolloutGroup | None = None
    """None, like the next, where nothing says that a bound is a wall."""
    wall: RolloutGroup | None = None

    @property
    def groups(self) -> dict[str, RolloutGroup]:
        """The groups that were told apart, by their titles."""
        named = {"all": self.all, "no wall": self.no_wall, "wall": self.wall}
        return {title: group for title, group in named.items() if group is not None}


class CandidateResult(Record):
    """All that was measured of one candidate."""

    label: str
    parameters: int
    one_step: OneStepResult
    rollouts: RolloutResult | None = None


class Delivered(Record):
    """Which model is the one that is delivered."""

    seed: int
    variant: str


class HeldOut(Record):
    """What was held out."""

    transitions: int
    episodes: int


class RolloutSource(Record):
    """What the rollouts are held against."""

    kind: Literal["environment", "recorded"]
    steps: int
    steps_wanted: int
    """As many as the params file asks for; more than `steps` if no held-out episode is as long."""


class Evaluation(Record):
    """evaluation.json."""

    loss: str
    test: HeldOut
    rollouts: RolloutSource
    delivered: Delivered
    seeds: dict[str, dict[str, AddressingResult]]
    candidates: dict[str, CandidateResult]

    @property
    def table(self) -> AddressingResult:
        """Table 1 of the delivered model."""
        return self.seeds[str(self.delivered.seed)][self.delivered.variant]

    @property
    def own(self) -> CandidateResult:
        """The delivered model with the paper's addressing."""
        return self.candidates["ensemble/argmax"]

    @property
    def own_seeds(self) -> list[CandidateResult]:
        """The delivered model and those of the other seeds."""
        return [self.own, *self._named("ensemble/argmax/seed-")]

    def baseline(self, name: str) -> list[CandidateResult]:
        """Return a baseline from all its seeds; empty if it was not trained."""
        return self._named(f"{name}/seed-")

    def _named(self, prefix: str) -> list[CandidateResult]:
        return [candidate for name, candidate in self.candidates.items() if name.startswith(prefix)]


class SegmentResult(Record):
    """What was recorded in one segment."""

    behaviour: str
    count: int
    transitions: int
    goal_share_last_100: float | None


class SplitResult(Record):
    """Size of a split."""

    episodes: int
    transitions: int


class Coverage(Record):
    """How much of the state space the data has seen."""

    cells_per_dimension: int
    per_dimension: dict[str, float]
    plane: float | None


class Duplicates(Record):
    """Rows that repeat an earlier one."""

    rows: int
    share: float


class PlaceResult(Record):
    """Where something was found."""

    log: str
    episode: int | None
    step: int | None
    value: float | None


class FindingResult(Record):
    """One thing that is wrong with the data."""

    meaning: str
    dimension: str
    count: int
    of: int | None
    first: PlaceResult | None
    blocking: bool


class ImportResult(Record):
    """What the import of foreign logs counted."""

    files: dict[str, dict[str, int]]
    totals: dict[str, int]


class DataResult(Record):
    """data.json."""

    transitions: int
    splits: dict[str, SplitResult]
    segments: dict[str, SegmentResult]
    coverage: Coverage
    duplicates: Duplicates
    quality: tuple[FindingResult, ...]
    imported: ImportResult | None = Field(default=None, alias="import")
    """None if the data was recorded by this project."""


class AddressingTrainings(Record):
    """addressing.json: validation metrics of each addressing network, by `seed-0/plain` and so on."""

    delivered: dict[str, str]
    validation: dict[str, dict[str, Any]]
