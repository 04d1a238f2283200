"""What rollouts are held against: an environment that acts, or stretches of held-out episodes."""

from collections.abc import Mapping
from dataclasses import dataclass

import gymnasium
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

import addressed_dynamics.envs  # noqa: F401 - registers the environments that a params file may name
from addressed_dynamics.errors import EvaluationError
from addressed_dynamics.params import EnvironmentRollouts, RecordedRollouts
from addressed_dynamics.transitions import Dimension, Transitions


@dataclass(frozen=True)
class TrueRollouts:
    """What really happened."""

    states: Float64[np.ndarray, "episode time observation"]
    """States, the first before any action: T + 1 of them, in the environment's units."""
    actions: Int64[np.ndarray, "episode step"] | Float32[np.ndarray, "episode step action"]
    """The T actions of each episode: their numbers if discrete, else vectors in the environment's units."""
    touched_bounds: Bool[np.ndarray, " episode"] | None
    """Whether the first dimension of the state reached its lowest or highest possible value, that is, a wall, on the
    way; None where nothing says that a bound is a wall."""

    @property
    def steps(self) -> int:
        """Number of steps in each episode, T."""
        return int(self.states.shape[1]) - 1

    @property
    def groups(self) -> Mapping[str, Bool[np.ndarray, " episode"]]:
        """Which episodes belong to each group: `all`, and, where there are walls, `no_wall` and `wall`."""
        everything = {"all": np.ones(len(self.states), dtype=np.bool_)}
        if self.touched_bounds is None:
            return everything
        return everything | {"no_wall": ~self.touched_bounds, "wall": self.touched_bounds}


def true_rollouts(params: EnvironmentRollouts | RecordedRollouts, test: Transitions) -> TrueRollouts:
    """Return the rollouts that a params file asks for.

    Args:
        params: where they come from, how many and how long.
        test: held-out transitions; of an environment's rollouts, they say what the dimensions mean.

    Raises:
        EvaluationError: the environment cannot be rolled out, or there is nothing recorded to replay.
    """
    if isinstance(params, RecordedRollouts):
        return replay_recorded(params, test)
    return record_true_rollouts(params, test.spec.observation)


def replay_recorded(params: RecordedRollouts, test: Transitions) -> TrueRollouts:
    """Take stretches of recorded episodes.

    Every episode is cut into stretches of `params.steps` from its first step on, and the rest of it is left out; among
    all stretches, `params.seed` decides. If no episode is as long, the stretches are as long as the longest episode.

    Raises:
        EvaluationError: no episode has at least two steps.
    """
    episodes = list(test.episode_slices())
    longest = max((rows.stop - rows.start for rows in episodes), default=0)
    if longest < 2:
        message = (
            f"evaluation.rollouts replays held-out episodes, but the longest of the {len(episodes)} has {longest} "
            "steps and at least 2 are needed; give longer episodes or raise convert.test_share"
        )
        raise EvaluationError(message)
    steps = min(params.steps, longest)
    starts = np.concatenate([np.arange(rows.start, rows.stop - steps + 1, steps) for rows in episodes])
    generator = np.random.default_rng(params.seed)
    chosen = np.sort(generator.permutation(starts)[: params.episodes]).astype(np.int64)
    rows = chosen[:, None] + np.arange(steps)
    first, after = test.observation[chosen], test.next_observation[rows]
    states = np.concatenate([first[:, None], after], axis=1).astype(np.float64)
    return TrueRollouts(states, test.action[rows], None)


def record_true_rollouts(params: EnvironmentRollouts, dimensions: tuple[Dimension, ...]) -> TrueRollouts:
    """Let the environment run under a behaviour that no model has seen.

    In stretches of geometric length it either pushes in the direction of motion (which drives a car to both walls) or
    holds a random action. The first third of the episodes does only the latter and mostly stays in the valley; over the
    others the share of pushes rises to `params.swing_share`, and they hit the walls again and again.

    Raises:
        EvaluationError: the environment cannot be made, its actions are not discrete, or it ends an episode early.
    """
    try:
        environment = gymnasium.make(
            params.environment.id,
            disable_env_checker=True,  # it looks at every step, and doubles their cost
            **{**params.environment.kwargs, "max_episode_steps": params.steps + 1},
        )
    except (gymnasium.error.Error, TypeError) as error:
        message = f"evaluation.rollouts.environment '{params.environment.id}' cannot be made ({error})"
        raise EvaluationError(message) from error
    space = environment.action_space
    if not isinstance(space, gymnasium.spaces.Discrete):
        message = f"rollouts need discrete actions, but '{params.environment.id}' has {space}"
        raise EvaluationError(message)
    generator = np.random.default_rng(params.seed)
    states = np.empty((params.episodes, params.steps + 1, len(dimensions)))
    actions = np.empty((params.episodes, params.steps), dtype=np.int64)
    for episode in range(params.episodes):
        swing_share = params.swing_share * max(0.0, 1.5 * (episode + 1) / params.episodes - 0.5)
        states[episode, 0], _ = environment.reset(seed=params.seed + episode)
        swinging, held, left = False, 0, 0
        for step in range(params.steps):
            if not left:
                swinging, left = (
                    generator.random() < swing_share,
                    int(generator.geometric(1.0 / params.mean_hold_steps)),
                )
                held = int(generator.integers(space.n))
            left -= 1
            velocity = states[episode, step, -1]
            actions[episode, step] = (space.n - 1 if velocity >= 0 else 0) if swinging else held
            states[episode, step + 1], _, terminated, _, _ = environment.step(actions[episode, step])
            if terminated:
                message = (
                    f"'{params.environment.id}' ended a rollout after {step + 1} steps; use a variant that goes on"
                )
                raise EvaluationError(message)
    environment.close()
    position = dimensions[0]
    at_bounds = (states[:, 1:, 0] <= np.float32(position.low)) | (states[:, 1:, 0] >= np.float32(position.high))
    touched: Bool[np.ndarray, " episode"] = np.any(at_bounds, axis=1)
    return TrueRollouts(states, actions, touched)
