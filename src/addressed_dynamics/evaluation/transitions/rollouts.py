"""Free-running rollouts: a model follows its own predictions from a true first state under the recorded actions.

Exogenous inputs are known in advance by their meaning: the recorded ones are replayed beside the actions.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32, Float64

from addressed_dynamics.base.threads import single_thread
from addressed_dynamics.base.torch_runtime import CPU
from addressed_dynamics.episodes.transitions import Dimension, SpaceSpec, Transitions
from addressed_dynamics.evaluation.transitions.candidates import Candidate
from addressed_dynamics.evaluation.transitions.horizons import percent_of_range
from addressed_dynamics.evaluation.transitions.physics import ANGLE_LIMIT, acrobot_course, check_recording, simulate
from addressed_dynamics.evaluation.transitions.spreads import (
    ERROR,
    INTERVAL,
    INTERVAL_OF,
    against_horizon,
    spread,
    with_intervals,
)
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.modes import Mode
from addressed_dynamics.simulators.on_device import rolled_out
from addressed_dynamics.sources.transitions.params import EnvironmentRollouts, RecordedRollouts

LEFT_BOUNDS_TOLERANCE = 0.01
"""A predicted state has left the bounds when it lies outside by more than this share of their range."""


FLOWN_WIDTHS = 1.0
"""A rollout has flown off when a predicted state lies outside of the range of the training data by more than so many
times the width of that range, or is no number."""


def free_run(
    model: AddressedDynamics, truth: TrueRollouts, mode: Mode, device: torch.device = CPU
) -> Float32[np.ndarray, "episode step state"]:
    """Return the states that a model predicts from the true first states (its whole history) and the actions alone.

    Beside the actions it is given the exogenous inputs, if there are any. The same models give the same states, in the
    mode `sample` too; on another device, the same up to rounding and what grows of it.
    """
    history, actions, exogenous = truth.given
    generator = torch.Generator().manual_seed(0)
    with single_thread():
        return rolled_out(model, device, history, actions, mode, exogenous=exogenous, generator=generator)


def roll_out(
    candidates: Sequence[Candidate], truth: TrueRollouts, *, cores: int, device: torch.device = CPU
) -> dict[str, Float32[np.ndarray, "episode step state"]]:
    """Return what each candidate that can be rolled out predicts, by its name; so many run at once, each in a thread.

    Threads are enough, because most of the time goes into products of matrices. A GPU does them one after the other.
    """
    cores = cores if device == CPU else 1
    models = {each.name: (each.model, each.mode) for each in candidates if each.model is not None}
    # All threads together: one that ends must not give torch its threads back while others go on.
    with single_thread(), ThreadPoolExecutor(max(1, min(cores, len(models)))) as pool:
        return dict(
            zip(models, pool.map(lambda each: free_run(each[0], truth, each[1], device), models.values()), strict=True)
        )


def evaluate_rollouts(
    name: str,
    predicted: Float32[np.ndarray, "episode step state"],
    truth: TrueRollouts,
    spaces: SpaceSpec,
    scale: Float64[np.ndarray, " state"],
    *,
    physics: bool,
    half: Float64[np.ndarray, "episode step state"] | None = None,
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the rollout errors of one candidate, and rows of its error against the horizon.

    Args:
        name: the candidate's.
        predicted: the states that it predicts.
        truth: what really happened.
        spaces: what the states mean.
        scale: range of each dimension of the state.
        physics: whether the states are those of Acrobot and are to be judged by their angles and energy too.
        half: half of the intervals around each predicted state, infinite where none is known; None of what has none.
    """
    summary, rows = _measured(name, finite(predicted), truth, spaces, scale, physics=physics)
    if half is None:
        return summary, rows
    widths = {INTERVAL: percent_of_range(half**2, scale)}
    widths |= {INTERVAL_OF.format(name): half[..., index] for index, name in enumerate(spaces.observation_names)}
    return summary, with_intervals(rows, widths, truth)


def evaluate_simulations(
    params: EnvironmentRollouts | RecordedRollouts,
    truth: TrueRollouts,
    spaces: SpaceSpec,
    scale: Float64[np.ndarray, " state"],
) -> tuple[dict[str, Any] | None, list[dict[str, Any]]]:
    """Return what the true equations of motion make of the rollouts, and rows of this against the horizon.

    None and no rows where the params file asks for no physics.

    Raises:
        EvaluationError: the recording does not follow these equations.
    """
    if not isinstance(params, RecordedRollouts) or params.physics is None:
        return None, []
    check_recording(truth, spaces)
    results: dict[str, Any] = {}
    rows: list[dict[str, Any]] = []
    for simulation in simulate(truth, spaces.step_seconds, params.apart):
        summary, more = _measured(simulation.name, simulation.states, simulation.reference, spaces, scale, physics=True)
        results[simulation.name] = {"label": simulation.label, **summary}
        rows += more
    record = {
        "name": params.physics,
        "step_seconds": spaces.step_seconds,
        "angle_limit": ANGLE_LIMIT,
        "apart": params.apart,
        "simulations": results,
    }
    return record, rows


def _measured(
    name: str,
    predicted: Float64[np.ndarray, "episode step observation"],
    truth: TrueRollouts,
    spaces: SpaceSpec,
    scale: Float64[np.ndarray, " state"],
    *,
    physics: bool,
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    squared = (predicted - truth.states[:, 1:]) ** 2
    summary = summarise_rollouts(squared, predicted, truth, spaces.observation)
    values = {dimension.name: squared[..., index] for index, dimension in enumerate(spaces.observation)}
    if physics:
        course = acrobot_course(predicted, truth.states)
        for group, members in truth.groups.items():
            summary["groups"][group]["physics"] = course.summary(members, spaces.step_seconds)
        values |= course.values
    values[ERROR] = percent_of_range(squared, scale)
    return summary, [{"model": name, **row} for row in against_horizon(values, truth)]


def seen_range(train: Transitions) -> Float64[np.ndarray, "2 state"]:
    """Return the lowest and the highest value of each dimension of the state in training data."""
    ends = [(each.min(axis=0), each.max(axis=0)) for each in (train.observation, train.next_observation)]
    return np.array([np.minimum(*(low for low, _ in ends)), np.maximum(*(high for _, high in ends))], np.float64)


def flown_off_share(
    predicted: Float32[np.ndarray, "episode step state"], seen: Float64[np.ndarray, "2 state"]
) -> float:
    """Return the share of rollouts that fly off (`FLOWN_WIDTHS`); a state that never changed counts as 1 wide.

    Args:
        predicted: what a model predicts.
        seen: what `seen_range` says of the data that it was trained on.
    """
    low, high = seen
    slack = FLOWN_WIDTHS * np.where(high > low, high - low, 1.0)
    with np.errstate(invalid="ignore"):
        inside = (predicted >= low - slack) & (predicted <= high + slack)
    return float((~inside).any(axis=(1, 2)).mean())


def finite(predicted: Float32[np.ndarray, "episode step state"]) -> Float64[np.ndarray, "episode step state"]:
    """Return predicted states with something large in place of what is larger or no number.

    A diverged rollout must count as a large error, and JSON cannot hold what is not finite.
    """
    bounded: Float64[np.ndarray, "episode step state"] = np.nan_to_num(
        predicted.astype(np.float64), nan=1e6, posinf=1e6, neginf=-1e6
    ).clip(-1e6, 1e6)
    return bounded


def squared_errors(
    predicted: Float32[np.ndarray, "episode step state"], truth: TrueRollouts
) -> Float64[np.ndarray, "episode step state"]:
    """Return the squared errors of predicted states; of those that are not finite, large ones (`finite`)."""
    errors: Float64[np.ndarray, "episode step state"] = (finite(predicted) - truth.states[:, 1:]) ** 2
    return errors


def summarise_rollouts(
    squared: Float64[np.ndarray, "episode step observation"],
    predicted: Float64[np.ndarray, "episode step observation"],
    truth: TrueRollouts,
    dimensions: tuple[Dimension, ...],
) -> dict[str, Any]:
    """Return the mean squared error of whole rollouts per dimension, over each of `groups` of episodes.

    `left_bounds_share` is the share of rollouts in which a predicted state leaves the bounds; None if there are none.
    """
    per_episode = squared.mean(axis=1)
    groups = {
        name: {
            "episodes": int(members.sum()) if truth.episode is None else len(np.unique(truth.episode[members])),
            "rollouts": int(members.sum()),
            "mse": {
                dimension.name: spread(per_episode[members, index]) if members.any() else None
                for index, dimension in enumerate(dimensions)
            },
        }
        for name, members in truth.groups.items()
    }
    return {"left_bounds_share": _left_bounds_share(predicted, dimensions), "groups": groups}


def _left_bounds_share(
    predicted: Float64[np.ndarray, "episode step observation"], dimensions: tuple[Dimension, ...]
) -> float | None:
    low, high = np.array([(dimension.low, dimension.high) for dimension in dimensions]).T
    if not np.isfinite([low, high]).any():
        return None
    slack = LEFT_BOUNDS_TOLERANCE * np.where(np.isfinite(high - low), high - low, 0.0)
    outside = ((predicted < low - slack) | (predicted > high + slack)).any(axis=(1, 2))
    return float(outside.mean())
