"""The params file as frozen, checked models: an unknown key, a missing key or a wrong type is a one-line error."""

from __future__ import annotations

import json
import reprlib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from addressed_dynamics.errors import ParamsError
from addressed_dynamics.params_base import Count, Positive, Section, Seed, Share
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
    learning_rate: Positive
    batch_size: Count
    """Transitions per gradient step."""
    buffer_size: Count
    """Transitions kept for replay."""
    learning_starts: Annotated[int, Field(ge=0)]
    """Transitions recorded before the first gradient step."""
    discount: Share
    return_steps: Count
    """Rewards that a target sums before it asks the value network for the rest (n-step returns)."""
    target_update_interval: Count
    """Transitions between two copies of the value network to the target network."""
    train_every: Count
    """Steps of each environment between two rounds of training."""
    gradient_steps: Count
    """Gradient steps in a round of training."""
    exploration_share: Share
    """Share of the segment over which epsilon falls from 1 to its final value."""
    exploration_final: Share
    """Final epsilon."""
    exploration_hold_steps: Annotated[float, Field(ge=1.0)]
    """Mean number of steps for which a random action is held (geometric)."""
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
    """The policy that an earlier `dqn` segment ended with, with a share of random actions."""

    kind: Literal["greedy"]
    segment: str
    """Name of the earlier segment."""
    epsilon: Share
    """Share of actions drawn uniformly."""


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


class FeatureParams(Section):
    """What a network is given and what it is asked for."""

    target: Literal["absolute", "change"]
    """`absolute`: the next state, as in the paper; `change`: the next state minus the state."""


class OptimiserParams(Section):
    """Adam and its schedule."""

    learning_rate: Positive
    """Peak learning rate."""
    betas: tuple[Share, Share]
    """Decay rates of Adam's moment estimates."""
    final_share: Share
    """The learning rate falls to this share of its peak (half a cosine); 1 keeps it constant, as in the paper."""


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
    epochs: Count
    cluster_epochs: Count
    """Bins are made anew in the first so many epochs and kept after that; as many as `epochs` is the paper's way."""
    processes: Count
    """Seeds that are trained at the same time, each in a process with one thread."""


class AddressingTraining(Section):
    """How an addressing network is made and trained."""

    hidden: tuple[Count, ...]
    """Widths of the hidden layers."""
    activation: Literal["relu", "tanh", "elu"]
    optimiser: OptimiserParams
    batch_size: Count
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


class BaselinesParams(Section):
    """What the ensemble is compared with; same data, same number of updates."""

    train: tuple[Literal["total_parameters", "wide", "unequal_bins", "random_bins"], ...]
    """`total_parameters`: one network with as many parameters as the ensemble; `wide`: the paper's 3 x 512;
    `unequal_bins`: each sample to its best member; `random_bins`: fixed random bins."""
    wide_hidden: tuple[Count, ...]
    """Hidden layers of `wide`."""
    wide_batch_size: Count
    """Samples per update of `wide`, which costs as much as a dozen small networks."""
    seeds: Annotated[tuple[Seed, ...], Field(min_length=1)]
    """One of each is trained from each seed."""
    addressing: AddressingTraining
    """The addressing networks of `unequal_bins` and `random_bins`, trained on plain argmin targets."""
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
    """Steps in a stretch; if no held-out episode is as long, those of the longest."""
    seed: Seed
    """Which stretches are taken, if there are more than asked for."""


class EvaluationParams(Section):
    """What is measured on held-out episodes."""

    rollouts: Annotated[EnvironmentRollouts | RecordedRollouts, Field(discriminator="kind")]


class ExperimentParams(Section):
    """All sections of one experiment; its transitions are either recorded or imported."""

    title: str
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
    """Read the section of `experiment` from the params file at `path`.

    Raises:
        ParamsError: the file is missing or is not YAML, the experiment is not in it, or a key in its section is
            unknown, missing or of a wrong type; the message gives the key's path.
    """
    document = _read_yaml(path)
    if experiment not in document:
        sections = [name for name in document if isinstance(document[name], dict) and name != "imported"]
        known = ", ".join(map(str, sections)) or "none"
        message = f"{path}: there is no experiment '{experiment}' in it (experiments there: {known})"
        raise ParamsError(message)
    try:
        return ExperimentParams.model_validate_json(json.dumps(document[experiment]))
    except ValidationError as error:
        raise ParamsError(_one_line(path, experiment, document[experiment], error)) from error
    except TypeError as error:
        message = f"{path}: the section '{experiment}' has a value of a kind that params cannot hold ({error})"
        raise ParamsError(message) from error


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
