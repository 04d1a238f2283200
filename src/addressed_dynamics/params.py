"""The params file as frozen, checked models: an unknown key, a missing key or a wrong type is a one-line error."""

from __future__ import annotations

import json
import reprlib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationError, model_validator
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from addressed_dynamics.errors import ParamsError
from addressed_dynamics.params_base import Count, Dropout, Positive, Section, Seed, Share
from addressed_dynamics.params_base import OptimiserParams as OptimiserParams  # sections of two modules have it
from addressed_dynamics.params_source import SourceParams

Action = int | tuple[float, ...]


class EnvironmentParams(Section):
    """Which environment to make, and how."""

    id: str
    """Gymnasium identifier, for instance `MountainCar-v0`."""
    kwargs: dict[str, Any]
    """Keyword arguments for `gymnasium.make`."""


class DqnBehaviour(Section):
    """A DQN (stable-baselines3) that learns while it is recorded."""

    kind: Literal["dqn"]
    frame_skip: Count
    """Simulated steps in a decision, for which its action is held; each of them is recorded. The intervals below
    count decisions."""
    reward_scale: Positive
    """What the rewards, summed over a decision, are multiplied by for the learner alone. It learns fast if returns are
    some tens at most: the value network starts at zero, and beyond an error of 1 its loss pulls no harder."""
    learning_rate: Positive
    batch_size: Count
    """Decisions per gradient step."""
    buffer_size: Count
    """Decisions kept for replay."""
    learning_starts: Annotated[int, Field(ge=0)]
    """Decisions, over all copies, before the first gradient step."""
    discount: Share
    """Of the return that follows a decision."""
    return_steps: Count
    """Decisions whose rewards a target sums before it asks the value network for the rest (n-step returns)."""
    target_update_interval: Count
    """Decisions, over all copies, between two copies of the value network to the target network."""
    train_every: Count
    """Decisions of each environment between two rounds of training."""
    gradient_steps: Count
    """Gradient steps in a round of training."""
    exploration_share: Share
    """Share of the segment over which epsilon falls from 1 to its final value."""
    exploration_final: Share
    """Final epsilon."""
    exploration_hold_steps: Annotated[float, Field(ge=1.0)]
    """Mean number of decisions for which a random action is held (geometric)."""
    hidden: tuple[Count, ...]
    """Widths of the value network's hidden layers."""


class RandomBehaviour(Section):
    """Actions drawn uniformly, each held for a random number of steps."""

    kind: Literal["random"]
    mean_hold_steps: Annotated[float, Field(ge=1.0)]
    """Mean number of steps for which an action is held (geometric); 1 draws a new one every step."""


class ConstantBehaviour(Section):
    """The same action at every step."""

    kind: Literal["constant"]
    action: Action
    """The action: its number if discrete, else its components in the environment's units."""


class GreedyBehaviour(Section):
    """The policy that an earlier `dqn` segment ended with, with its frame skip and a share of random actions."""

    kind: Literal["greedy"]
    segment: str
    """Name of the earlier segment."""
    epsilon: Share
    """Share of decisions drawn uniformly."""


Behaviour = Annotated[DqnBehaviour | RandomBehaviour | ConstantBehaviour | GreedyBehaviour, Field(discriminator="kind")]


class SegmentParams(Section):
    """One part of a recording plan: who acts, where, for how long."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9_]+$")]
    behaviour: Behaviour
    environment: EnvironmentParams
    environments: Count
    """Copies of the environment that run side by side."""
    transitions: Count
    """Transitions to record, over all copies; a multiple of their number."""
    seed: Seed
    """Copy i is first reset with this seed plus i."""

    @model_validator(mode="after")
    def _copies_share_equally(self) -> SegmentParams:
        if self.transitions % self.environments:
            message = f"{self.transitions} transitions cannot be shared equally by {self.environments} environments"
            raise ValueError(message)
        return self


class RecordParams(Section):
    """The recording plan."""

    shard_transitions: Count
    """A log file is closed at the end of the episode in which it reaches this many transitions."""
    segments: Annotated[tuple[SegmentParams, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _segments_fit(self) -> RecordParams:
        learners: set[str] = set()
        names: set[str] = set()
        for segment in self.segments:
            if segment.name in names:
                message = f"two segments are called '{segment.name}'"
                raise ValueError(message)
            behaviour = segment.behaviour
            if isinstance(behaviour, GreedyBehaviour) and behaviour.segment not in learners:
                message = f"segment '{segment.name}' follows '{behaviour.segment}', which is no earlier dqn segment"
                raise ValueError(message)
            names.add(segment.name)
            if isinstance(behaviour, DqnBehaviour):
                learners.add(segment.name)
        return self


class ConvertParams(Section):
    """From logs to tables."""

    validation_share: Share
    """Share of the episodes kept for choosing recipes."""
    test_share: Share
    """Share of the episodes kept for the evaluation."""
    split_seed: Seed
    """Seed of the hash that gives each episode its split."""
    row_group_rows: Count
    """Rows in a Parquet row group."""

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


class FeatureParams(Section):
    """What a network is given and what it is asked for."""

    target: Literal["absolute", "change"]
    """`absolute`: the next state, as in the paper; `change`: the next state minus the state."""
    history: Count = 1
    """Number of consecutive frames (states with their actions) that a network is given."""
    history_weight: Positive = 1.0
    """Size of the inputs of older frames beside those of the last, which is the state itself; 1 makes no difference
    between them, as in the paper."""
    angles: tuple[AngleParams, ...] = ()
    """Angles given by cosine and sine; predicted cosines and sines are put back on the unit circle."""
    angle_from: Literal["weighted", "atan2"] = "atan2"
    """How an angle comes from a predicted cosine and sine: the paper's weighted mean (Section 3.3), or atan2."""
    velocity: Literal["difference", "predicted"] = "predicted"
    """Where the angles' velocities come from: differences of successive angles, as in the paper, or the network."""


class EnsembleParams(Section):
    """Phase 1: Algorithm 1 and the subnetworks."""

    seeds: Annotated[tuple[Seed, ...], Field(min_length=1)]
    """One ensemble is trained from each seed; the first is the one that is delivered."""
    members: Count
    """Number of subnetworks, n in the paper."""
    hidden: tuple[Count, ...]
    """Widths of the hidden layers."""
    activation: Literal["relu", "tanh", "elu"]
    loss: Literal["mse", "mae", "mae+mse"]
    optimiser: OptimiserParams
    batch_size: Count
    """Samples per member and update."""
    dropout: Dropout = 0.0
    """Share of every layer's inputs that are set to 0 in an update."""
    epochs: Count
    cluster_epochs: Count
    """Bins are made anew in the first so many epochs and kept after that; as many as `epochs` is the paper's way."""
    restart: bool = False
    """Whether the networks start again, untrained, when the bins are kept: they then see nothing but their own bins."""
    processes: Count
    """Seeds that are trained at the same time, each in a process with one thread."""

    @model_validator(mode="after")
    def _restarts_before_the_end(self) -> EnsembleParams:
        if self.restart and self.cluster_epochs >= self.epochs:
            message = (
                f"with restart, cluster_epochs should be below epochs, or nothing is trained after it, but they are "
                f"{self.cluster_epochs} and {self.epochs}"
            )
            raise ValueError(message)
        return self


class AddressingTraining(Section):
    """How an addressing network is made and trained."""

    hidden: tuple[Count, ...]
    """Widths of the hidden layers; of the trunk's layers, if there are `heads`."""
    heads: tuple[Count, ...]
    """Widths of the hidden layers of one head for each member; empty: one output layer for all."""
    activation: Literal["relu", "tanh", "elu"]
    optimiser: OptimiserParams
    batch_size: Count
    dropout: Dropout = 0.0
    """Share of every layer's inputs that are set to 0 in an update."""
    epochs: Count
    tie_share: Share
    """Share of the weight that `cost_sensitive` spreads evenly, so that near ties are decided too; 1 makes it plain."""


class AddressingParams(AddressingTraining):
    """Phase 2: the addressing network."""

    variants: Annotated[tuple[Literal["plain", "cost_sensitive"], ...], Field(min_length=1)]
    """Which ones to train: `plain` is the paper's; `cost_sensitive` weighs a sample by what a wrong choice costs."""
    deliver: Literal["best", "plain", "cost_sensitive"]
    """Which one becomes part of the model: a variant, or the one with the lowest regret on validation episodes."""
    processes: Count
    """Networks that are trained at the same time, each in a process with one thread."""

    @model_validator(mode="after")
    def _delivers_what_is_trained(self) -> AddressingParams:
        if self.deliver != "best" and self.deliver not in self.variants:
            message = f"deliver is '{self.deliver}', which is not among the variants"
            raise ValueError(message)
        return self


class SingleNetwork(Section):
    """One plain network; what is not here is as for the ensemble."""

    hidden: tuple[Count, ...]
    """Widths of the hidden layers."""
    activation: Literal["relu", "tanh", "elu"]
    batch_size: Count
    """Samples per update."""


def _is_free(name: str) -> str:
    if name in {"total_parameters", "unequal_bins", "random_bins", "pair", "ensemble"}:
        message = f"'{name}' has a meaning already; give the network another name"
        raise ValueError(message)
    return name


BaselineName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$"), AfterValidator(_is_free)]
"""Name of a single network: it becomes a folder, and a title in figures."""


class BaselinesParams(Section):
    """What the ensemble is compared with; same data, same number of updates."""

    train: tuple[Literal["total_parameters", "unequal_bins", "random_bins", "other_recipe"], ...]
    """`total_parameters`: one network with as many parameters as the ensemble; `unequal_bins`: each sample to its best
    member; `random_bins`: fixed random bins; `other_recipe`: the ensemble with the paper's recipe, or, if that is the
    one chosen, with the default."""
    single_networks: dict[BaselineName, SingleNetwork]
    """More single networks, under names of their own; all of them are trained."""
    pair_epochs: Annotated[int, Field(ge=0)]
    """Epochs of an ensemble of two that is trained for a figure alone (the paper's Fig. 2), from the first seed; 0: no
    such ensemble."""
    seeds: Annotated[tuple[Seed, ...], Field(min_length=1)]
    """One of each is trained from each seed."""
    addressing: AddressingTraining
    """The addressing networks of `unequal_bins`, `random_bins` and `other_recipe`, trained on plain argmin targets."""
    processes: Count
    """Networks that are trained at the same time, each in a process with one thread."""


class EnvironmentRollouts(Section):
    """Free-running rollouts beside an environment that acts under a behaviour no model has seen."""

    kind: Literal["environment"]
    environment: EnvironmentParams
    episodes: Count
    steps: Count
    seed: Seed
    swing_share: Share
    """Largest share of stretches in which the behaviour pushes in the direction of motion, which drives a car to both
    walls; in the others it holds a random action."""
    mean_hold_steps: Annotated[float, Field(ge=1.0)]
    """Mean length of a stretch, in steps (geometric)."""


class RecordedRollouts(Section):
    """Free-running rollouts beside stretches of held-out episodes, under the actions recorded there."""

    kind: Literal["recorded"]
    episodes: Count
    """Stretches to replay; fewer if the held-out episodes have no more."""
    steps: Annotated[int, Field(ge=2)]
    """Steps in a stretch; if no held-out episode is as long, as many as the longest allows."""
    seed: Seed
    """Which stretches are taken, if there are more than asked for."""
    physics: Literal["acrobot"] | None = None
    """`acrobot`: judge angles and energy too, beside simulations by the true equations of motion."""
    apart: Positive = 1e-6
    """How far the first angles of two true simulations are apart at the start, in rad, to show what is possible."""


class EvaluationParams(Section):
    """What is measured on held-out episodes."""

    rollouts: Annotated[EnvironmentRollouts | RecordedRollouts, Field(discriminator="kind")]


class RecipeChanges(Section):
    """What another recipe changes: some keys of some sections, which it takes the place of."""

    features: dict[str, Any] = Field(default_factory=dict)
    ensemble: dict[str, Any] = Field(default_factory=dict)
    addressing: dict[str, Any] = Field(default_factory=dict)


class ExperimentParams(Section):
    """All sections of one experiment; its transitions are either recorded or imported."""

    title: str
    recipe: Literal["default", "paper"] = "default"
    """Whether the sections below hold as they are, or with what `paper_recipe` changes."""
    paper_recipe: RecipeChanges = Field(default_factory=RecipeChanges)
    """What the paper does otherwise; its addressing holds for `baselines.addressing` too."""
    record: RecordParams | None = None
    """What to record; absent if there is a `source`."""
    source: SourceParams | None = None
    """Which logs or tables to import; absent if there is a `record`."""
    convert: ConvertParams
    features: FeatureParams
    ensemble: EnsembleParams
    addressing: AddressingParams
    baselines: BaselinesParams
    evaluation: EvaluationParams

    @model_validator(mode="after")
    def _has_one_origin(self) -> ExperimentParams:
        if (self.record is None) == (self.source is None):
            found = "neither" if self.record is None else "both"
            message = f"an experiment has either 'record' or 'source', but this one has {found}"
            raise ValueError(message)
        return self


_FORMS = {"int", "tuple[float, ...]"}
"""What pydantic adds to a key's path where a value may be of several types."""
_CHOOSERS = ("kind", "by")
"""Keys whose value chooses one of several forms of their section; pydantic adds this value to the path."""


def load_params(path: Path, experiment: str) -> ExperimentParams:
    """Read the section of `experiment` from the params file at `path`, with the recipe it asks for.

    Raises:
        ParamsError: the file is missing or is not YAML, the experiment is not in it, or a key in its section is
            unknown, missing or of a wrong type; the message gives the key's path.
    """
    return load_recipes(path, experiment)[0]


def load_recipes(path: Path, experiment: str) -> tuple[ExperimentParams, ExperimentParams]:
    """Read the section of `experiment` as `load_params` does, once with the recipe asked for and once with the other.

    Raises:
        ParamsError: as in `load_params`.
    """
    document = _read_yaml(path)
    if experiment not in document:
        sections = [name for name in document if isinstance(document[name], dict) and name != "imported"]
        known = ", ".join(map(str, sections)) or "none"
        message = f"{path}: there is no experiment '{experiment}' in it (experiments there: {known})"
        raise ParamsError(message)
    section = document[experiment]
    default = _validated(path, experiment, section)
    changes = default.paper_recipe
    changed = {**section, **{name: {**section[name], **keys} for name, keys in changes}}
    training = {key: value for key, value in changes.addressing.items() if key in AddressingTraining.model_fields}
    baselines = section["baselines"]
    changed["baselines"] = {**baselines, "addressing": {**baselines["addressing"], **training}}
    paper = _validated(path, experiment, changed)
    return (default, paper) if default.recipe == "default" else (paper, default)


def load_record_params(path: Path, experiment: str) -> RecordParams:
    """Read the recording plan of `experiment`.

    Raises:
        ParamsError: as in `load_params`, or the experiment is imported.
    """
    plan = load_params(path, experiment).record
    if plan is None:
        message = (
            f"{path}: {experiment}: there is nothing to record, because it has a 'source'; "
            "name it under 'imported' in params.yaml instead of 'recorded', and run the stage import_logs"
        )
        raise ParamsError(message)
    return plan


def load_source_params(path: Path, experiment: str) -> SourceParams:
    """Read what `experiment` imports.

    Raises:
        ParamsError: as in `load_params`, or the experiment is recorded.
    """
    source = load_params(path, experiment).source
    if source is None:
        message = (
            f"{path}: {experiment}: there is nothing to import, because it has a 'record'; "
            "name it under 'recorded' in params.yaml instead of 'imported', and run the stage record"
        )
        raise ParamsError(message)
    return source


def _validated(path: Path, experiment: str, section: Any) -> ExperimentParams:
    try:
        return ExperimentParams.model_validate_json(json.dumps(section))
    except ValidationError as error:
        raise ParamsError(_one_line(path, experiment, section, error)) from error
    except TypeError as error:
        message = f"{path}: the section '{experiment}' has a value of a kind that params cannot hold ({error})"
        raise ParamsError(message) from error


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        document = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        message = f"{path}: no such params file"
        raise ParamsError(message) from error
    except (OSError, UnicodeDecodeError) as error:
        message = f"{path}: the params file cannot be read ({error})"
        raise ParamsError(message) from error
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark is not None else ""
        problem = str(getattr(error, "problem", None) or error).split("\n", maxsplit=1)[0]
        message = f"{path}{where}: not a YAML file ({problem})"
        raise ParamsError(message) from error
    if not isinstance(document, dict):
        message = f"{path}: a params file is a mapping of sections, but this one holds {type(document).__name__}"
        raise ParamsError(message)
    return document


def _one_line(path: Path, experiment: str, section: Any, error: ValidationError) -> str:
    problems = error.errors()
    first = problems[0]
    where = ".".join([experiment, *_key_path(first["loc"], section)])
    match first["type"]:
        case "extra_forbidden":
            what = "unknown key; check its spelling, or remove it"
        case "missing":
            what = "missing key"
        case "value_error":
            what = first["msg"].removeprefix("Value error, ")
        case _:
            what = f"{first['msg'][0].lower()}{first['msg'][1:]}, but it is {reprlib.repr(first['input'])}"
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"{path}: {where}: {what}{more}"


def _key_path(location: tuple[int | str, ...], section: Any) -> list[str]:
    """Return the path of a key as it is in the file, without what pydantic adds to it."""
    keys: list[str] = []
    place, chosen = section, False
    for part in location:
        if part in _FORMS:
            continue
        if isinstance(place, dict) and not chosen and part in [place.get(key) for key in _CHOOSERS]:
            chosen = True
            continue
        keys.append(str(part))
        chosen = False
        match place:
            case dict():
                place = place.get(part)
            case list() if isinstance(part, int) and part < len(place):
                place = place[part]
            case _:
                place = None
    return keys
