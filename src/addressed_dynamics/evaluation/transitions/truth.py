"""What rollouts are held against: an environment that acts, or stretches of held-out episodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

import addressed_dynamics.envs  # noqa: F401 - registers the environments that a params file may name
from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.episodes.transitions import Dimension, Transitions
from addressed_dynamics.evaluation.common.bootstrap import FEWEST_ROLLOUTS
from addressed_dynamics.features.common.samples import Dropped
from addressed_dynamics.features.transitions.windows import episode_lengths, shorter_episodes
from addressed_dynamics.sources.transitions.params import EnvironmentRollouts, RecordedRollouts


@dataclass(frozen=True)
class TrueRollouts:
    """What really happened."""

    states: Float64[np.ndarray, "episode time observation"]
    """States, the first before any action: T + 1 of them, in the environment's units."""
    actions: Int64[np.ndarray, "episode step"] | Float32[np.ndarray, "episode step action"]
    """The T actions of each episode: their numbers if discrete, else vectors in the environment's units."""
    history_states: Float64[np.ndarray, "episode frame observation"]
    """The H states that a model is given, oldest first; the last one is the first of `states`."""
    history_actions: Int64[np.ndarray, "episode before"] | Float32[np.ndarray, "episode before action"]
    """The H - 1 actions before the first of `actions`."""
    groups: Mapping[str, Bool[np.ndarray, " episode"]]
    """Which episodes belong to each group: `all` of them, and those of the groups that are told apart."""
    too_short: Mapping[str, int] = field(default_factory=dict)
    """Segments of the recording that no rollout is from, for want of a held-out episode that is long enough, each with
    the steps of its longest; 0 if there is none."""
    dropped: Dropped = field(default_factory=Dropped)
    """Held-out episodes that no rollout is from because they are shorter than one."""
    exogenous: Float32[np.ndarray, "episode time exogenous"] | None = None
    """The exogenous inputs beside the H - 1 + T actions, those of the history first; None if there are none."""
    episode: Int64[np.ndarray, " episode"] | None = None
    """Held-out episode that each is a stretch of; None beside an environment, where each is an episode of its own."""

    overlapping: bool = False
    """Whether stretches of the same episode overlap, because fewer than `FEWEST_ROLLOUTS` that do not are there."""

    @property
    def steps(self) -> int:
        """Number of steps in each episode, T."""
        return int(self.states.shape[1]) - 1

    @property
    def given(self) -> tuple[
        Float32[np.ndarray, "episode ..."],
        Int64[np.ndarray, "episode time"] | Float32[np.ndarray, "episode time action"],
        Float32[np.ndarray, "episode time exogenous"] | None,
    ]:  # fmt: skip
        """First states, actions and exogenous inputs, as `AddressedDynamics.rollout` takes them."""
        frames = self.history_states.astype(np.float32)
        actions = np.concatenate([self.history_actions, self.actions], axis=1)
        return frames[:, 0] if frames.shape[1] == 1 else frames, actions, self.exogenous

    def select(self, episodes: Sequence[int]) -> TrueRollouts:
        """Return some of the episodes, in this order."""
        rows = list(episodes)
        return replace(
            self,
            states=self.states[rows],
            actions=self.actions[rows],
            history_states=self.history_states[rows],
            history_actions=self.history_actions[rows],
            groups={name: members[rows] for name, members in self.groups.items()},
            exogenous=None if self.exogenous is None else self.exogenous[rows],
            episode=None if self.episode is None else self.episode[rows],
        )


def true_rollouts(
    params: EnvironmentRollouts | RecordedRollouts, test: Transitions, history: int, segments: Mapping[int, str]
) -> TrueRollouts:
    """Return the rollouts that a params file asks for.

    Args:
        params: where they come from, how many and how long.
        test: held-out transitions; of an environment's rollouts, they say what the dimensions mean.
        history: number of states that a model is given, H.
        segments: for every recorded episode, the segment of the recording that it comes from.

    Raises:
        EvaluationError: the environment cannot be rolled out, or there is nothing recorded to replay.
    """
    if isinstance(params, RecordedRollouts):
        return replay_recorded(params, test, history, segments)
    if test.spec.exogenous:
        names = ", ".join(dimension.name for dimension in test.spec.exogenous)
        message = (
            f"evaluation.rollouts: beside '{params.environment.id}' nobody knows the exogenous inputs ({names}) that "
            "the model needs; replay held-out episodes with 'kind: recorded'"
        )
        raise EvaluationError(message)
    return record_true_rollouts(params, test.spec.observation, history)


def replay_recorded(
    params: RecordedRollouts, test: Transitions, history: int, segments: Mapping[int, str]
) -> TrueRollouts:
    """Take stretches of recorded episodes, from each segment of the recording as many as from the others.

    Every episode is cut into stretches of `params.steps` from the first step on that has H - 1 steps before it, and the
    rest of it is left out. Among the stretches of a segment, `params.seed` decides; a segment that has too few leaves
    its share to the others. If no episode is as long, the stretches are as long as the longest episode allows.

    Where this gives fewer than `FEWEST_ROLLOUTS`, and fewer than are asked for, more begin in the same episodes,
    equally spaced and overlapping, in each as many as in any other where there is room (`_starts`).

    Raises:
        EvaluationError: no episode has two steps after the history.
    """
    longest: dict[str, int] = dict.fromkeys(segments.values(), 0)
    episodes = [(segments[int(test.episode[rows.start])], rows) for rows in test.episode_slices()]
    for segment, rows in episodes:
        longest[segment] = max(longest[segment], rows.stop - rows.start)
    most = max(longest.values(), default=0)
    if most < history + 1:
        message = (
            f"evaluation.rollouts replays held-out episodes, but the longest of the {len(episodes)} has {most} "
            f"steps and at least {history + 1} are needed; give longer episodes or raise convert.test_share"
        )
        raise EvaluationError(message)
    steps = min(params.steps, most - history + 1)
    room = [(segment, range(rows.start + history - 1, rows.stop - steps + 1)) for segment, rows in episodes]
    found = _starts([each for _, each in room], steps, min(params.episodes, FEWEST_ROLLOUTS))
    starts = {start: segment for (segment, _), each in zip(room, found, strict=True) for start in each}
    chosen = _equal_shares(starts, params.episodes, np.random.default_rng(params.seed))
    within = chosen[:, None] + np.arange(steps)
    before = chosen[:, None] + np.arange(1 - history, 0)
    exogenous = test.exogenous[chosen[:, None] + np.arange(1 - history, steps)] if test.spec.exogenous else None
    history_states = test.observation[chosen[:, None] + np.arange(1 - history, 1)].astype(np.float64)
    states = np.concatenate([history_states[:, -1:], test.next_observation[within]], axis=1)
    groups = _segment_groups([starts[start] for start in chosen.tolist()])
    too_short = {segment: length for segment, length in longest.items() if length < steps + history - 1}
    dropped = shorter_episodes(episode_lengths([test]), steps + history - 1)
    beside = (np.diff(chosen) < steps) & (np.diff(test.episode[chosen]) == 0)
    return TrueRollouts(
        states,
        test.action[within],
        history_states,
        test.action[before],
        groups,
        too_short,
        dropped,
        exogenous,
        test.episode[chosen],
        bool(beside.any()),
    )


def _starts(room: Sequence[range], steps: int, wanted: int) -> list[list[int]]:
    """Return where stretches begin in each episode: one after the other if that is enough, else as many as are wanted.

    Where more are wanted, an episode has the smallest number of equally spaced starts with which there are enough, or
    those of before if they are more; all there are, if that is fewer.

    Args:
        room: all rows in which a stretch can begin, for each episode.
        steps: of a stretch.
        wanted: stretches of all episodes together.
    """
    apart = [list(each[::steps]) for each in room]
    most = sum(map(len, room))
    if sum(map(len, apart)) >= min(wanted, most):
        return apart
    number = next(
        number
        for number in range(1, wanted + 1)
        if sum(max(len(few), min(number, len(each))) for few, each in zip(apart, room, strict=True))
        >= min(wanted, most)
    )
    return [
        few if len(few) >= min(number, len(each)) else [each[place] for place in _even(len(each), number)]
        for few, each in zip(apart, room, strict=True)
    ]


def _even(length: int, number: int) -> list[int]:
    """Return so many equally spaced places in so many, the first and the last among them; all if there are fewer."""
    places: list[int] = np.rint(np.linspace(0, length - 1, min(number, length))).astype(int).tolist()
    return places


def _equal_shares(
    starts: Mapping[int, str], number: int, generator: np.random.Generator
) -> Int64[np.ndarray, " episode"]:
    """Draw so many starts without repetition, as many of each segment as of any other where it has them; sorted."""
    drawn = generator.permutation(list(starts))
    taken: dict[str, int] = {}
    place = np.empty(len(drawn), dtype=np.int64)
    for index, start in enumerate(drawn.tolist()):
        place[index] = taken[starts[start]] = taken.get(starts[start], -1) + 1
    chosen: Int64[np.ndarray, " episode"] = np.sort(drawn[np.argsort(place, kind="stable")[:number]])
    return chosen


def _segment_groups(segments: Sequence[str]) -> dict[str, Bool[np.ndarray, " episode"]]:
    """Return the groups of episodes from these segments; with one segment, there is nothing to tell apart."""
    found = np.array(segments)
    groups = {"all": np.ones(len(found), dtype=np.bool_)}
    names = list(dict.fromkeys(segments))
    if len(names) > 1:
        groups |= {f"segment_{name}" if name == "all" else name: found == name for name in names}
    return groups


def record_true_rollouts(params: EnvironmentRollouts, dimensions: tuple[Dimension, ...], history: int) -> TrueRollouts:
    """Let the environment run under a behaviour that no model has seen.

    In stretches of geometric length it either pushes in the direction of motion (which drives a car to both walls) or
    holds a random action. The first third of the episodes does only the latter and mostly stays in the valley; over the
    others the share of pushes rises to `params.swing_share`, and they hit the walls again and again. The first H - 1
    steps are a model's history.

    Its groups are `all`, `no_wall` and `wall`: in the last, the first dimension of the state reaches its lowest or
    highest possible value, that is, a wall, on the way.

    Raises:
        EvaluationError: the environment cannot be made, its actions are not discrete, or it ends an episode early.
    """
    steps = history - 1 + params.steps
    environment, count = _rollout_environment(params, steps)
    generator = np.random.default_rng(params.seed)
    states = np.empty((params.episodes, steps + 1, len(dimensions)))
    actions = np.empty((params.episodes, steps), dtype=np.int64)
    for episode in range(params.episodes):
        swing_share = params.swing_share * max(0.0, 1.5 * (episode + 1) / params.episodes - 0.5)
        states[episode, 0], _ = environment.reset(seed=params.seed + episode)
        swinging, held, left = False, 0, 0
        for step in range(steps):
            if not left:
                swinging, left = (
                    generator.random() < swing_share,
                    int(generator.geometric(1.0 / params.mean_hold_steps)),
                )
                held = int(generator.integers(count))
            left -= 1
            velocity = states[episode, step, -1]
            actions[episode, step] = (count - 1 if velocity >= 0 else 0) if swinging else held
            states[episode, step + 1], _, terminated, _, _ = environment.step(actions[episode, step])
            if terminated:
                message = (
                    f"'{params.environment.id}' ended a rollout after {step + 1} steps; use a variant that goes on"
                )
                raise EvaluationError(message)
    environment.close()
    history_states, states = states[:, :history], states[:, history - 1 :]
    history_actions, actions = actions[:, : history - 1], actions[:, history - 1 :]
    return TrueRollouts(states, actions, history_states, history_actions, _wall_groups(states, dimensions[0]))


def _rollout_environment(params: EnvironmentRollouts, steps: int) -> tuple[gymnasium.Env[Any, Any], int]:
    """Make an environment that goes on for so many steps, and return it with its number of actions."""
    try:
        environment = gymnasium.make(
            params.environment.id,
            disable_env_checker=True,  # it looks at every step, and doubles their cost
            **{**params.environment.kwargs, "max_episode_steps": steps + 1},
        )
    except (gymnasium.error.Error, TypeError) as error:
        message = f"evaluation.rollouts.environment '{params.environment.id}' cannot be made ({error})"
        raise EvaluationError(message) from error
    space = environment.action_space
    if not isinstance(space, gymnasium.spaces.Discrete):
        message = f"rollouts need discrete actions, but '{params.environment.id}' has {space}"
        raise EvaluationError(message)
    return environment, int(space.n)


def _wall_groups(
    states: Float64[np.ndarray, "episode time observation"], position: Dimension
) -> dict[str, Bool[np.ndarray, " episode"]]:
    at_bounds = (states[:, 1:, 0] <= np.float32(position.low)) | (states[:, 1:, 0] >= np.float32(position.high))
    touched: Bool[np.ndarray, " episode"] = np.any(at_bounds, axis=1)
    return {"all": np.ones_like(touched), "no_wall": ~touched, "wall": touched}
