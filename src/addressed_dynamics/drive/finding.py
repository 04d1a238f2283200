"""What is meant by a name: an experiment's models or a folder of some, and the environment that they model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium

from addressed_dynamics.base.errors import DriveError, ModelError, ParamsError, RecordingError, SpaceError
from addressed_dynamics.base.params.experiments import PARAMS, check_section, load_experiment, load_kind
from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.envs import ACROBOT, CONTINUING_MOUNTAIN_CAR
from addressed_dynamics.episodes.transitions import DiscreteAction, SpaceSpec
from addressed_dynamics.networks.files import read_index
from addressed_dynamics.recording.environments import Environment, make_environment
from addressed_dynamics.recording.spaces import space_spec
from addressed_dynamics.simulators.delivery import MODELS, find_models, find_parts
from addressed_dynamics.sources.transitions.params import EnvironmentRollouts

LIMIT = "max_episode_steps"
UNLIMITED = -1
"""What Gymnasium takes for no limit of time: a person says when an episode is over."""


@dataclass(frozen=True)
class Named:
    """What a person meant."""

    folder: Path
    """The folder of models."""
    title: str
    """What it is called in the page."""
    kind: str
    """The models' kind of data."""
    environments: tuple[EnvironmentParams, ...] = ()
    """Environments that the experiment's params name, the one to drive beside first; none if there are no params."""
    released: Path | None = None
    """The published network that the experiment's params name."""


def find(name: str, params: Path | None = None, candidate: str | None = None, models: Path = MODELS) -> Named:
    """Return what is meant by the name of an experiment, or by a model folder.

    Args:
        name: either; a name without a slash is that of an experiment if it has models.
        params: the params file that says what the experiment was recorded in, which has to have a section of that
            name, or of the folder's; None for the project's if it is there and says something of the experiment.
        candidate: which of the models; None for what is delivered.
        models: where the models of experiments are.

    Raises:
        DriveError: there is nothing of that name.
        ModelError: what is there is no model folder, or it has no such candidate.
        ParamsError: the params file is not there, is not YAML or has something else under that name.
    """
    try:
        folder = find_models(name, models, params or PARAMS)
    except ModelError as error:
        raise DriveError(str(error)) from error
    features = read_index(find_parts(folder, candidate, None, None).network, "config.json").get("features")
    kind = str(features.get("kind", "transitions")) if isinstance(features, dict) else "transitions"
    experiment, file = folder.resolve().name, params or PARAMS
    if params is not None:
        _check_kind(params, experiment, kind, folder)
    elif folder == Path(name) or not file.is_file() or load_kind(file, experiment) != kind:
        return Named(folder, experiment, kind)
    section = _section(file, experiment, kind)
    title = section.title or experiment
    if kind == "motion":
        released = section.evaluation.released
        return Named(folder, title, kind, released=None if released is None else Path(released))
    return Named(folder, title, kind, tuple(_environments(section)))


def _check_kind(params: Path, experiment: str, kind: str, folder: Path) -> None:
    check_section(params, experiment)
    if (found := load_kind(params, experiment)) not in (None, kind):
        message = f"{params}: '{experiment}' is of {found} there, but {folder} is a model of {kind}; name another file"
        raise ParamsError(message)


def _section(params: Path, name: str, kind: str) -> Any:
    try:
        return load_experiment(params, name, kind)
    except ParamsError as error:
        message = f"{error}; or name another file with --params"
        raise ParamsError(message) from error


def _environments(section: Any) -> Iterator[EnvironmentParams]:
    rollouts = section.evaluation.rollouts
    if isinstance(rollouts, EnvironmentRollouts):
        yield _without_limit(rollouts.environment)
    for segment in section.record.segments if section.record else ():
        yield _without_limit(segment.environment)


def _without_limit(params: EnvironmentParams) -> EnvironmentParams:
    kwargs = {name: value for name, value in params.kwargs.items() if name != LIMIT}
    return EnvironmentParams(id=params.id, kwargs=kwargs)


def environment_of(named: Named, spaces: SpaceSpec, wanted: str | None) -> EnvironmentParams | None:
    """Return the environment that a model is a model of; None if nobody knows.

    That is the one asked for, else the first that the experiment's params name, else one of those that this package and
    Gymnasium know, if what it observes and takes has the same names and its step is as long.

    Raises:
        DriveError: the environment that was asked for has other spaces, or cannot be made.
    """
    if wanted is not None:
        asked = EnvironmentParams(id=wanted)
        try:
            with made(asked) as environment:
                found = space_spec(environment)
        except (RecordingError, SpaceError) as error:
            raise DriveError(str(error)) from error
        if not same_world(found, spaces):
            theirs, own = (_said(each) for each in (found, spaces))
            message = f"--environment {wanted}: it has {theirs}, but the model {own}; name the one that was recorded"
            raise DriveError(message)
        return asked
    for each in (*named.environments, *_known(spaces)):
        try:
            with made(each) as environment:
                if same_world(space_spec(environment), spaces):
                    return each
        except (RecordingError, SpaceError):
            # What needs a package that is not there is as good as unknown: the model can be driven alone.
            continue
    return None


def made(params: EnvironmentParams) -> Environment:
    """Make an environment that goes on for as long as one drives.

    Raises:
        RecordingError: it cannot be made.
    """
    return make_environment(EnvironmentParams(id=params.id, kwargs={**params.kwargs, LIMIT: UNLIMITED}))


def same_world(found: SpaceSpec, spaces: SpaceSpec) -> bool:
    """Return whether two descriptions are of one world: the same names in the same order, and about the same step."""
    return (
        found.observation_names == spaces.observation_names
        and _action_names(found) == _action_names(spaces)
        and not spaces.exogenous
        and abs(found.step_seconds - spaces.step_seconds) <= 1e-3 * spaces.step_seconds
    )


def _known(spaces: SpaceSpec) -> Iterator[EnvironmentParams]:
    yield EnvironmentParams(id=CONTINUING_MOUNTAIN_CAR)
    if spaces.step_seconds <= 1.0:
        yield EnvironmentParams(id=ACROBOT, kwargs={"time_step": spaces.step_seconds, "ends_at_goal": False})
    for name in ("MountainCarContinuous-v0", "CartPole-v1", "Pendulum-v1"):
        if name in gymnasium.registry:
            yield EnvironmentParams(id=name)


def _action_names(spaces: SpaceSpec) -> tuple[str, ...]:
    action = spaces.action
    return action.names if isinstance(action, DiscreteAction) else tuple(each.name for each in action.dimensions)


def _said(spaces: SpaceSpec) -> str:
    names, actions = ", ".join(spaces.observation_names), ", ".join(_action_names(spaces))
    return f"states {names}, actions {actions} and steps of {spaces.step_seconds:g} s"
