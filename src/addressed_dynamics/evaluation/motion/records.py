"""What evaluation.json holds of an experiment of motion, as far as a report shows it."""

from __future__ import annotations

from typing import Self

from pydantic import model_validator

from addressed_dynamics.evaluation.common.records import Record, Specialisation, Specialisations
from addressed_dynamics.evaluation.motion.closed_loop.measures import GaitReference

ENSEMBLE = "ensemble"
"""First part of the group of our own candidates, followed by the mode: `ensemble/argmax`."""
UNCALIBRATED = "trust is calibrated for states and actions, and not for motion"
"""Why no model of motion says how far it is to be trusted."""


class BlockError(Record):
    """Mean absolute error of a block of outputs."""

    block: str
    unit: str
    columns: int
    raw: float
    """In the block's unit."""
    normalised: float
    """In units of each column's deviation."""


class JointError(Record):
    """Mean distance of a joint from where it was, and of its velocity from what it was."""

    joint: str
    position: float
    """In cm."""
    velocity: float
    """In cm/frame."""


class UnitError(Record):
    """Mean error of one or two blocks of outputs, as one would measure it: a distance, a speed or an angle."""

    name: str
    unit: str
    value: float


class OneStep(Record):
    """Errors of one candidate one step ahead, on the frames of one split."""

    rows: int
    raw: float
    """Mean absolute error over all outputs, whatever their units: the paper's figure."""
    normalised: float
    blocks: tuple[BlockError, ...]
    joints: tuple[JointError, ...]
    units: tuple[UnitError, ...] = ()
    """Block by block, in cm, cm/s, degrees and so on; empty in results of earlier versions."""


class KindResult(Record):
    """How a run did while one kind of thing was asked for; speeds in cm/s, angles in degrees, None without frames."""

    kind: str
    frames: int
    lost: int
    commanded_speed: float | None
    speed: float | None
    speed_error: float | None
    """Mean difference from the commanded speed, either way."""
    facing_error: float | None
    limb_speed: float | None
    frozen_share: float | None
    skate_speed: float | None
    contact_share: float | None
    slowest_foot_speed: float | None
    bone_drift: float | None


class RunResult(Record):
    """How a run did."""

    seconds: float
    lived_seconds: float
    alive: bool
    largest_bone_drift: float | None
    kinds: tuple[KindResult, ...]
    """Everything, all that moves, and each kind of command."""

    @model_validator(mode="after")
    def _has_all_and_moving(self) -> Self:
        if not {"all", "moving"} <= {each.kind for each in self.kinds}:
            message = "there is no judgement of 'all', or none of 'moving'"
            raise ValueError(message)
        return self

    def of(self, kind: str) -> KindResult | None:
        """Return the judgement of one kind of command; None if it does not occur."""
        return next((each for each in self.kinds if each.kind == kind), None)

    @property
    def all(self) -> KindResult:
        """Over the whole script."""
        return next(each for each in self.kinds if each.kind == "all")

    @property
    def moving(self) -> KindResult:
        """While it should move."""
        return next(each for each in self.kinds if each.kind == "moving")


class ClosedLoop(Record):
    """How a candidate did in the closed loop."""

    score: float
    """Under the test script."""
    validation_score: float | None
    """Under the scripts by which seed and mode are chosen; None if there is no seed to choose."""
    run: RunResult


class Candidate(Record):
    """All that was measured of one candidate."""

    group: str
    """What it is, whatever its seed."""
    seed: int | None
    label: str
    parameters: int
    multiply_adds: int | None = None
    """Of one prediction, addressing included; None if unknown, as in results of earlier versions."""
    one_step: dict[str, OneStep]
    """By split."""
    closed_loop: ClosedLoop

    @model_validator(mode="after")
    def _has_held_out_clips(self) -> Self:
        if "test" not in self.one_step:
            message = "there are no errors on held-out clips (test)"
            raise ValueError(message)
        return self

    @property
    def test(self) -> OneStep:
        """Errors on clips that were held out whole."""
        return self.one_step["test"]


class Reference(Record):
    """The same measures on the frames that were trained on."""

    gaits: tuple[GaitReference, ...]
    """All frames first, then the gaits that occur."""

    @model_validator(mode="after")
    def _has_all(self) -> Self:
        if "all" not in {each.gait for each in self.gaits}:
            message = "there is no gait 'all'"
            raise ValueError(message)
        return self

    def of(self, gait: str) -> GaitReference:
        """Return a gait; all frames if it does not occur."""
        found = {each.gait: each for each in self.gaits}
        return found.get(gait, found["all"])


class PhaseUse(Record):
    """What the choice of a network tells of the phase, in one gait or over all gaits."""

    gait: str
    rows: int
    counts: tuple[tuple[int, ...], ...]
    """(member, bin): how often each network is selected in each interval of the phase."""
    choice_bits: float
    information_share: float
    """Information on the phase as a share of the choice's entropy."""
    chance_share: float
    """What chance gives."""
    chance_share_p95: float


class SplitAddressing(Record):
    """How the networks share the frames of one split."""

    specialisation: Specialisation
    phase_use: tuple[PhaseUse, ...]

    @model_validator(mode="after")
    def _has_all(self) -> Self:
        if "all" not in {each.gait for each in self.phase_use}:
            message = "there is no phase use over all gaits"
            raise ValueError(message)
        return self

    @property
    def all(self) -> PhaseUse:
        """Over all gaits."""
        return next(each for each in self.phase_use if each.gait == "all")

    @property
    def gaits(self) -> tuple[PhaseUse, ...]:
        """Each gait that occurs."""
        return tuple(each for each in self.phase_use if each.gait != "all")


class Addressing(Record):
    """The same for the frames that were trained on, and for held-out clips."""

    train: SplitAddressing
    test: SplitAddressing

    @property
    def specialisations(self) -> Specialisations:
        """How the networks share the frames."""
        return Specialisations(train=self.train.specialisation, test=self.test.specialisation)

    @property
    def members(self) -> int:
        """Networks of the ensemble."""
        return len(self.train.specialisation.addressed)


class Delivered(Record):
    """Which ensemble is the one that is delivered."""

    seed: int
    mode: str


class ScoreRecord(Record):
    """What a candidate reaches on validation data."""

    closed_loop: float
    mae_normalised: float


class Recommendation(Record):
    """Which model is the best on validation data."""

    candidate: str
    """A key of `candidates`."""
    label: str
    scores: dict[str, ScoreRecord]
    """Of every candidate that can be loaded."""


class MotionEvaluation(Record):
    """evaluation.json."""

    candidates: dict[str, Candidate]
    delivered: Delivered
    splits: dict[str, int]
    """Frames of each split."""
    reference: Reference
    addressing: Addressing
    recommendation: Recommendation | None = None
    """None in results of earlier versions."""

    @model_validator(mode="after")
    def _has_the_delivered(self) -> Self:
        if self.own_name not in self.candidates:
            message = f"'{self.own_name}' is delivered, but was not measured"
            raise ValueError(message)
        return self

    @property
    def own_group(self) -> str:
        """The delivered kind of model, whatever its seed."""
        return f"{ENSEMBLE}/{self.delivered.mode}"

    @property
    def own_name(self) -> str:
        """Name of the delivered model."""
        return f"{self.own_group}/seed-{self.delivered.seed}"

    @property
    def own(self) -> Candidate:
        """The delivered model."""
        return self.candidates[self.own_name]

    @property
    def groups(self) -> dict[str, list[Candidate]]:
        """All candidates by what they are, from every seed, in the order of evaluation."""
        found: dict[str, list[Candidate]] = {}
        for candidate in self.candidates.values():
            found.setdefault(candidate.group, []).append(candidate)
        return found

    @property
    def models(self) -> dict[str, list[Candidate]]:
        """The same with only the delivered mode of the ensemble, which comes first."""
        groups = self.groups
        others = {name: each for name, each in groups.items() if not name.startswith(f"{ENSEMBLE}/")}
        return {self.own_group: groups[self.own_group], **others}

    @property
    def modes(self) -> dict[str, list[Candidate]]:
        """The ensemble in each mode, by the mode."""
        prefix = f"{ENSEMBLE}/"
        return {name.removeprefix(prefix): each for name, each in self.groups.items() if name.startswith(prefix)}

    @property
    def held_out(self) -> tuple[str, ...]:
        """Splits that errors were measured on, in their order."""
        return tuple(self.own.one_step)
