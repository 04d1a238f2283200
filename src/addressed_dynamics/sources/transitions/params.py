"""The sections of a params file that an experiment with transitions has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, model_validator

from addressed_dynamics.base.params.recording import DqnBehaviour, EnvironmentParams, RecordParams, Unlearned
from addressed_dynamics.base.params.sections import Count, CountOrAuto, Positive, Section, Seed, Share, by_name
from addressed_dynamics.base.params.source import SourceParams
from addressed_dynamics.base.params.training import AddressingParams, BaselinesParams, EnsembleSection, RecipeChanges


class ConvertParams(Section):
    """From logs to tables."""

    split: Literal["episodes", "blocks"] = "episodes"
    """What belongs to one split as a whole: `episodes`, or `blocks` in time of those that are long enough, for one long
    recording without episodes."""
    blocks: Annotated[int, Field(ge=3)] = 20
    """With `split: blocks`, number of blocks of an episode; fewer if these would be shorter than 20 steps or four gaps.
    An episode that is too short for three stays whole."""
    gap_steps: Annotated[int, Field(ge=0)] = 20
    """With `split: blocks`, steps that are dropped between blocks of different splits, because they are near copies of
    those beyond the border. Which number is right depends on how fast the states change and on how often they are
    recorded; it should not be below `features.history`."""
    validation_share: Share = 0.1
    """Share of the episodes, or of the blocks of each, kept for choosing recipes."""
    test_share: Share = 0.15
    """Share of the episodes, or of the blocks of each, kept for the evaluation."""
    split_seed: Seed = 0
    """Seed of the hash that gives each episode or block its split."""
    row_group_rows: Count = 131_072
    """Rows in a Parquet row group."""
    predictions: bool = False
    """Whether logs are taken that were recorded in a learned model: what it predicted, and nothing that happened."""

    @model_validator(mode="after")
    def _leaves_training_data(self) -> ConvertParams:
        if self.validation_share + self.test_share >= 1.0:
            message = "validation_share + test_share must be below 1, or nothing is left to train on"
            raise ValueError(message)
        return self


class AngleParams(Section):
    """An angle that the observation gives by its cosine and its sine."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
    cosine: str
    """Name of the dimension with its cosine."""
    sine: str
    """Name of the dimension with its sine."""
    velocity: str | None = None
    """Name of the dimension with its velocity, in rad/s, if there is one."""


HISTORIES = (1, 2, 4, 6)
"""Numbers of frames that are tried where validation is to say how many."""


class FeatureSection(Section):
    """What a network is given and what it is asked for; of how many frames, validation may say."""

    target: Literal["absolute", "change"] = "change"
    """`absolute`: the next state, as in the paper; `change`: the next state minus the state."""
    history: CountOrAuto = 1
    """Number of consecutive frames (states with their actions) that a network is given; `auto`: of 1, 2, 4 and 6 the
    smallest from which validation transitions are predicted about as well as from the best."""
    history_weight: Positive = 1.0
    """Size of the inputs of older frames beside those of the last, which is the state itself; 1 makes no difference
    between them, as in the paper."""
    angles: Annotated[tuple[AngleParams, ...], BeforeValidator(by_name)] = ()
    """Each under its name: angles given by cosine and sine; predicted cosines and sines are put back on the circle."""
    angle_from: Literal["weighted", "atan2"] = "atan2"
    """How an angle comes from a predicted cosine and sine: the paper's weighted mean (Section 3.3), or atan2."""
    velocity: Literal["difference", "predicted"] = "predicted"
    """Where the angles' velocities come from: differences of successive angles, as in the paper, or the network."""

    def with_history(self, history: int) -> FeatureParams:
        """Return what a network is given, so many frames of it, and asked for."""
        return FeatureParams.model_validate(self.model_dump() | {"history": history})


class FeatureParams(FeatureSection):
    """What a network is given and what it is asked for."""

    history: Count = 1


class EnvironmentRollouts(Section):
    """Free-running rollouts beside an environment that acts under a behaviour no model has seen."""

    kind: Literal["environment"]
    environment: EnvironmentParams
    episodes: Count = 200
    steps: Count = 1000
    seed: Seed = 0
    swing_share: Share = 0.8
    """Largest share of stretches in which the behaviour pushes in the direction of motion, which drives a car to both
    walls; in the others it holds a random action."""
    mean_hold_steps: Annotated[float, Field(ge=1.0)] = 2.0
    """Mean length of a stretch, in steps (geometric)."""


class RecordedRollouts(Section):
    """Free-running rollouts beside stretches of held-out episodes, under the actions recorded there."""

    kind: Literal["recorded"]
    episodes: Count = 40
    """Stretches to replay; fewer if the held-out episodes have no more. Where fewer than 20 lie apart, more begin in
    the same episodes, equally spaced."""
    steps: Annotated[int, Field(ge=2)] = 100
    """Steps in a stretch; if no held-out episode is as long, as many as the longest allows."""
    seed: Seed = 0
    """Which stretches are taken, if there are more than asked for."""
    physics: Literal["acrobot"] | None = None
    """`acrobot`: judge angles and energy too, beside simulations by the true equations of motion."""
    apart: Positive = 1e-6
    """How far the first angles of two true simulations are apart at the start, in rad, to show what is possible."""


class ShiftParams(Section):
    """Transitions that are not like those of the training: made for the evaluation, to see whether a model says so."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9_]+$")]
    kind: Literal["starts", "behaviour", "mechanics"]
    """What is not as in the training: the first states, the actions, or the equations of motion."""
    environment: EnvironmentParams
    """Of the same spaces and step as the experiment's; what is not as there lies in `kwargs` or in who acts."""
    behaviour: Unlearned
    episodes: Count = 40
    steps: Count = 100
    """Steps in an episode, if the environment does not end it earlier."""
    seed: Seed = 0
    """Episode i is reset with this seed plus i."""


class EvaluationParams(Section):
    """What is measured on held-out episodes."""

    rollouts: Annotated[EnvironmentRollouts | RecordedRollouts, Field(discriminator="kind")] = RecordedRollouts(
        kind="recorded"
    )
    shifts: Annotated[tuple[ShiftParams, ...], BeforeValidator(by_name)] = ()
    """Each under its name: other starts, behaviours or mechanics, on which a model should trust itself less."""

    @model_validator(mode="after")
    def _shifts_have_different_names(self) -> EvaluationParams:
        names = [shift.name for shift in self.shifts]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            message = f"two shifts are called '{twice[0]}'"
            raise ValueError(message)
        return self

    reward: Annotated[str, Field(pattern=r"^\w+(\.\w+)*:\w+$")] | None = None
    """A function that says reward and end of steps, as `module:function`, if one is known: an environment of the model
    asks it, where it would else ask what is learned from the logs. The form is that of
    `addressed_dynamics.envs:mountain_car_reward`."""

    deliver: Literal["best", "addressed"] = "best"
    """Which model is delivered: the `best` on validation episodes, of all that were trained or are references, or the
    `addressed` ensemble, which is the default where there is a `paper`."""


class PolicyParams(Section):
    """A policy that is learned inside the delivered model, and scored there and in truth."""

    reward: str | None = None
    """Who says reward and end of a step: a function, as `module:function`; null: who says them in the
    model's environment, a function or what was learned from the logs."""
    environment: EnvironmentParams | None = None
    """The true environment, in which the policy is scored once it is chosen; null: there is none at hand."""
    candidate: str | None = None
    """Which model to learn in, by its name in the report; null: the one that is delivered."""
    begin: Literal["beginnings", "anywhere"] = "beginnings"
    """Where episodes start: where recorded training episodes began, or anywhere in them."""
    episode_steps: Count = 200
    """Steps after which an episode is cut off, in the model and in truth."""
    copies: Count = 64
    """Copies of the model that the learner acts in side by side."""
    decisions: Count = 25_600
    """Decisions that it makes, over all copies; each lasts for `learner.frame_skip` steps."""
    checks: Count = 8
    """How often its policy is scored meanwhile, in the model alone; the best is kept."""
    check_episodes: Count = 24
    """Episodes of such a score."""
    episodes: Count = 100
    """Episodes of the scores that are reported."""
    least_ended: Share | None = None
    """Share of the true episodes that should end inside the task, for the report; null: nothing is asked for."""
    seed: Seed = 0
    learner: DqnBehaviour = DqnBehaviour(kind="dqn")

    @model_validator(mode="after")
    def _decides_as_often_as_it_steps(self) -> PolicyParams:
        if self.episode_steps % self.learner.frame_skip:
            message = (
                f"episode_steps is {self.episode_steps}, no multiple of learner.frame_skip, {self.learner.frame_skip}"
            )
            raise ValueError(message)
        if self.decisions < self.copies * self.checks:
            message = (
                f"decisions is {self.decisions}, but {self.copies} copies make {self.copies * self.checks} at least "
                f"between {self.checks} checks; raise it"
            )
            raise ValueError(message)
        if self.least_ended is not None and self.environment is None:
            message = "least_ended asks for something of true episodes, but there is no environment; leave it out"
            raise ValueError(message)
        return self


class TransitionsRecipe(RecipeChanges):
    """In what the paper's recipe differs, also of angles (Section 3.3)."""

    PAPER: ClassVar[Mapping[str, Any]] = {
        **RecipeChanges.PAPER,
        "features": {"target": "absolute", "history_weight": 1.0, "angle_from": "weighted", "velocity": "difference"},
    }


class ExperimentParams(Section):
    """All sections of one experiment; its transitions are recorded, imported, or logs that are there already."""

    title: str
    recipe: Literal["default", "paper"] = "default"
    """Whether the sections below hold as they are, or with what `paper_recipe` changes."""
    paper_recipe: TransitionsRecipe = TransitionsRecipe()
    """What the paper does otherwise; its addressing holds for `baselines.addressing` too."""
    paper: Literal["mountaincar", "acrobot"] | None = None
    """The paper's experiment whose figures the report compares with; null: none."""
    record: RecordParams | None = None
    """What to record; absent if there is a `source`, or if the raw data are logs of transitions."""
    source: SourceParams | None = None
    """Which logs or tables to import; absent if there is a `record`, or if the raw data are logs of transitions."""
    convert: ConvertParams = ConvertParams()
    features: FeatureSection = FeatureSection()
    ensemble: EnsembleSection = EnsembleSection()
    addressing: AddressingParams = AddressingParams()
    baselines: BaselinesParams = BaselinesParams()
    evaluation: EvaluationParams = EvaluationParams()
    policy: PolicyParams | None = None
    """A policy to learn inside the delivered model; null: none."""

    @model_validator(mode="before")
    @classmethod
    def _delivers_what_the_paper_is_about(cls, section: Any) -> Any:
        if not isinstance(section, dict) or section.get("paper") is None:
            return section
        evaluation = section.get("evaluation", {})
        return section | (
            {"evaluation": {"deliver": "addressed", **evaluation}} if isinstance(evaluation, dict) else {}
        )

    @model_validator(mode="after")
    def _has_one_origin(self) -> ExperimentParams:
        if self.record is not None and self.source is not None:
            message = "an experiment has either 'record' or 'source', but this one has both"
            raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _knows_exogenous_inputs_in_rollouts(self) -> ExperimentParams:
        if self.source and self.source.exogenous and isinstance(self.evaluation.rollouts, EnvironmentRollouts):
            message = (
                "source.exogenous names inputs that no environment tells; set evaluation.rollouts to 'kind: recorded', "
                "which replays them"
            )
            raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _shifts_are_as_long_as_a_history(self) -> ExperimentParams:
        history = self.features.history
        frames = max(HISTORIES) if history == "auto" else history
        for shift in self.evaluation.shifts:
            if shift.steps < frames:
                message = (
                    f"evaluation.shifts.{shift.name}.steps is {shift.steps}, but features.history asks for "
                    f"{'up to ' if history == 'auto' else ''}{frames} frames; raise it"
                )
                raise ValueError(message)
        return self


FORM = ExperimentParams
"""What the params file says of an experiment of this kind."""
