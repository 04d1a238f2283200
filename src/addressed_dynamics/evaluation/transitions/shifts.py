"""Transitions that are not like those of the training: other starts, another behaviour, changed mechanics."""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float32, Shaped

from addressed_dynamics.base.errors import EvaluationError, RecordingError, SpaceError, TransitionsError
from addressed_dynamics.episodes.transitions import Dimension, DiscreteAction, SpaceSpec, Transitions
from addressed_dynamics.recording.behaviours import Policy, unlearned_policy
from addressed_dynamics.recording.environments import Environment, make_environment
from addressed_dynamics.recording.spaces import space_spec
from addressed_dynamics.sources.transitions.params import ShiftParams


def record_shifts(shifts: Sequence[ShiftParams], spaces: SpaceSpec) -> dict[str, Transitions]:
    """Return what happens under each shift, by its name; the same params make the same transitions.

    Args:
        shifts: what is not as in the training.
        spaces: those of the experiment, which are also those of every shift.

    Raises:
        EvaluationError: an environment cannot be made or recorded, or has other spaces; a behaviour does not fit it.
    """
    return {shift.name: record_shift(shift, spaces) for shift in shifts}


def record_shift(shift: ShiftParams, spaces: SpaceSpec) -> Transitions:
    """Return the episodes of one shift, numbered from 0, as a log of them would be read.

    An episode has `shift.steps` transitions, or fewer if the environment ends it.

    Raises:
        EvaluationError: as in `record_shifts`.
    """
    kwargs = {**shift.environment.kwargs, "max_episode_steps": shift.steps}
    try:
        with closing(make_environment(shift.environment.model_copy(update={"kwargs": kwargs}))) as environment:
            if found := _difference(space_spec(environment), spaces):
                message = f"'{shift.environment.id}' is not the experiment's world: {found}; change its id or kwargs"
                raise SpaceError(message)
            policy = unlearned_policy(shift.behaviour, environment, 1, np.random.default_rng(shift.seed))
            episodes = [_play(environment, policy, shift.seed + number) for number in range(shift.episodes)]
        return _joined(episodes, spaces)
    except (RecordingError, SpaceError, TransitionsError) as error:
        message = f"evaluation.shifts.{shift.name}: {error}"
        raise EvaluationError(message) from error


@dataclass(frozen=True)
class _Episode:
    states: Float32[np.ndarray, "time observation"]
    """One more than there are actions."""
    actions: Shaped[np.ndarray, "step ..."]
    rewards: list[float]
    terminated: bool
    """Whether it ended for a reason inside the task; else it was cut."""


def _play(environment: Environment, policy: Policy, seed: int) -> _Episode:
    """Make one episode; the environment has a time limit."""
    observation, _ = environment.reset(seed=seed)
    states, actions, rewards = [_flat(observation)], [], []
    terminated = truncated = False
    while not (terminated or truncated):
        action = policy(np.asarray(observation)[None])[0]
        # A copy before the step: an environment may clip the action in place.
        actions.append(action.copy())
        observation, reward, terminated, truncated, _ = environment.step(action)
        states.append(_flat(observation))
        rewards.append(float(reward))
    return _Episode(np.stack(states), np.stack(actions), rewards, bool(terminated))


def _flat(observation: Any) -> Float32[np.ndarray, " observation"]:
    return np.array(observation, dtype=np.float32).ravel()


def _joined(episodes: Sequence[_Episode], spaces: SpaceSpec) -> Transitions:
    lengths = [len(episode.actions) for episode in episodes]
    actions = np.concatenate([episode.actions for episode in episodes])
    discrete = isinstance(spaces.action, DiscreteAction)
    last = np.cumsum(lengths) - 1
    ended = np.array([episode.terminated for episode in episodes], dtype=np.bool_)
    terminated, truncated = np.zeros((2, sum(lengths)), dtype=np.bool_)
    terminated[last], truncated[last] = ended, ~ended
    return Transitions(
        spec=spaces,
        episode=np.repeat(np.arange(len(episodes), dtype=np.int64), lengths),
        step=np.concatenate([np.arange(length, dtype=np.int32) for length in lengths]),
        time_ns=np.rint(np.arange(sum(lengths)) * (spaces.step_seconds * 1e9)).astype(np.int64),
        observation=np.concatenate([episode.states[:-1] for episode in episodes]),
        action=actions.astype(np.int64) if discrete else actions.reshape(len(actions), -1).astype(np.float32),
        reward=np.concatenate([episode.rewards for episode in episodes]).astype(np.float32),
        next_observation=np.concatenate([episode.states[1:] for episode in episodes]),
        terminated=terminated,
        truncated=truncated,
    )


def _difference(found: SpaceSpec, expected: SpaceSpec) -> str | None:
    """Say in what spaces differ first, to six digits, as bounds come in single precision too; None if they do not."""
    ours, theirs = _words(found), _words(expected)
    for part in ours:
        if ours[part] != theirs[part]:
            return f"expected the {part} {theirs[part]}, found {ours[part]}"
    return None


def _words(spaces: SpaceSpec) -> dict[str, str]:
    action = spaces.action
    return {
        "observation": _listed(spaces.observation),
        "action": "/".join(action.names) if isinstance(action, DiscreteAction) else _listed(action.dimensions),
        "step": f"{spaces.step_seconds:g} s",
        "exogenous inputs": _listed(spaces.exogenous),
    }


def _listed(dimensions: Sequence[Dimension]) -> str:
    return (
        ", ".join(f"{each.name} in {each.low:g}..{each.high:g} {each.unit}".rstrip() for each in dimensions) or "none"
    )
