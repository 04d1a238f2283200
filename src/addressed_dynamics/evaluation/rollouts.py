"""Free-running rollouts: a model follows its own predictions from a true first state under the recorded actions."""

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from jaxtyping import Bool, Float64, Int64

import addressed_dynamics.envs  # noqa: F401 - registers the environments that a params file may name
from addressed_dynamics.errors import EvaluationError
from addressed_dynamics.models.addressed import AddressedDynamics, Mode
from addressed_dynamics.params import RolloutParams
from addressed_dynamics.transitions import Dimension

LEFT_BOUNDS_TOLERANCE = 0.01
"""A predicted state has left the bounds when it lies outside by more than this share of their range."""


@dataclass(frozen=True)
class TrueRollouts:
    """What the environment did."""

    states: Float64[np.ndarray, "episode time observation"]
    """States, the first before any action: T + 1 of them, in the environment's units."""
    actions: Int64[np.ndarray, "episode step"]
    """The T actions of each episode."""
    touched_bounds: Bool[np.ndarray, " episode"]
    """Whether a dimension of the state reached its lowest or highest possible position, that is, a wall, on the way."""


def record_true_rollouts(params: RolloutParams, dimensions: tuple[Dimension, ...]) -> TrueRollouts:
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


def rollout_errors(
    model: AddressedDynamics, truth: TrueRollouts, mode: Mode
) -> tuple[Float64[np.ndarray, "episode step observation"], Float64[np.ndarray, "episode step observation"]]:
    """Return the squared errors of a model's open-loop rollouts, and the predicted states, in environment units."""
    first = truth.states[:, 0].astype(np.float32)
    predicted = model.rollout(first, truth.actions, mode).astype(np.float64)
    # A diverged rollout must count as a large error, and JSON cannot hold what is not finite.
    predicted = np.nan_to_num(predicted, nan=1e6, posinf=1e6, neginf=-1e6).clip(-1e6, 1e6)
    return (predicted - truth.states[:, 1:]) ** 2, predicted


def summarise_rollouts(
    squared: Float64[np.ndarray, "episode step observation"],
    predicted: Float64[np.ndarray, "episode step observation"],
    truth: TrueRollouts,
    dimensions: tuple[Dimension, ...],
) -> dict[str, Any]:
    """Return the mean squared error of whole rollouts per dimension, over all, wall-free and wall-touching episodes."""
    groups = {
        "all": np.ones(len(squared), dtype=np.bool_),
        "no_wall": ~truth.touched_bounds,
        "wall": truth.touched_bounds,
    }
    low, high = np.array([(d.low, d.high) for d in dimensions]).T
    slack = LEFT_BOUNDS_TOLERANCE * np.where(np.isfinite(high - low), high - low, 0.0)
    outside = ((predicted < low - slack) | (predicted > high + slack)).any(axis=(1, 2))
    per_episode = squared.mean(axis=1)
    summary: dict[str, Any] = {"left_bounds_share": float(outside.mean())}
    for name, members in groups.items():
        summary[name] = {
            "episodes": int(members.sum()),
            "mse": {
                dimension.name: _spread(per_episode[members, index]) if members.any() else None
                for index, dimension in enumerate(dimensions)
            },
        }
    return summary


def error_against_horizon(
    squared: Float64[np.ndarray, "episode step observation"], dimensions: tuple[Dimension, ...], every: int
) -> list[dict[str, float]]:
    """Return rows for a table: squared error at each horizon (10th, 50th and 90th percentile over episodes)."""
    rows = []
    for horizon in range(every, squared.shape[1] + 1, every):
        row: dict[str, float] = {"horizon": horizon}
        for index, dimension in enumerate(dimensions):
            values = np.quantile(squared[:, horizon - 1, index], [0.1, 0.5, 0.9])
            row |= {
                f"{dimension.name}_{label}": float(v) for label, v in zip(("p10", "p50", "p90"), values, strict=True)
            }
        rows.append(row)
    return rows


def _spread(values: Float64[np.ndarray, " episode"]) -> dict[str, float]:
    return {
        "median": float(np.median(values)),
        "mean": float(values.mean()),
        "p10": float(np.quantile(values, 0.1)),
        "p90": float(np.quantile(values, 0.9)),
        "max": float(values.max()),
    }
