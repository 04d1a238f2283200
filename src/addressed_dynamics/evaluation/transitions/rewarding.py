"""Learn reward and end of steps from training episodes, and judge who says them on held-out ones."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Float64, Int64
from torch import Tensor

from addressed_dynamics.base.params.sections import OptimiserParams
from addressed_dynamics.base.params.training import AddressingTraining, EnsembleParams
from addressed_dynamics.episodes.parquet import joined
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.evaluation.transitions.calibration import shuffled
from addressed_dynamics.evaluation.transitions.reward_records import JudgedTask, TaskRecord
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.common.spool import IN_MEMORY, Scratch
from addressed_dynamics.simulators.rewards import (
    LEARNED,
    NOBODY,
    Fitted,
    KeptTask,
    LearnedTask,
    end_inputs,
    end_scores,
    task_inputs,
)
from addressed_dynamics.simulators.tasks import Told, reward_and_end, sources, told
from addressed_dynamics.training.addressing import train_addressing
from addressed_dynamics.training.ensemble import train_ensemble
from addressed_dynamics.training.epochs import updates_per_epoch

MOST_ROWS = 50_000
"""Training steps that a network learns from, at most; all that end an episode are among them."""
FEWEST_UPDATES = 600
"""Updates of a network, at least: few rows make smaller batches, and are then passed through more often."""
SMALLEST_BATCH = 32
SMALLEST_DEVIATION = 1e-6
"""An input, or the reward, that deviates less is constant."""
REWARD = EnsembleParams(
    members=1, hidden=(64, 64), activation="tanh", loss="mse", optimiser=OptimiserParams(learning_rate=3e-3),
    batch_size=256, epochs=12, cluster_epochs=1, early_stopping=4,
)  # fmt: skip
"""How the network of rewards is trained."""
END = AddressingTraining(
    hidden=(64, 64), activation="tanh", optimiser=OptimiserParams(learning_rate=3e-3), batch_size=256, epochs=15,
    tie_share=0.5,
)  # fmt: skip
"""How the network of ends is trained: to choose between going on and ending."""


TrainingParams = TypeVar("TrainingParams", EnsembleParams, AddressingTraining)


@dataclass(frozen=True)
class Telling:
    """Which episodes tell where an episode ends."""

    telling: frozenset[str]
    """Segments in which some training or validation episode terminated; none if none did."""
    silent: Mapping[str, int]
    """Training steps of all others, by segment: what they do where others end says nothing of ends."""


def learn_task(
    train: Transitions, validation: Transitions, segments: Mapping[int, str], scratch: Scratch = IN_MEMORY
) -> tuple[LearnedTask, Telling]:
    """Learn reward and end of a step from its state, its action and the next state.

    The network of ends sees steps that end an episode more often than they are, by the square root of how rare they
    are (`misclassification_weights`); what it says is put right by a threshold that is chosen on validation episodes,
    or, where none of these ends, on those of the training.

    A segment in which no episode terminates, while some do in others, is from a world that does not end there, or was
    recorded without being told: it has no part in learning ends.

    Args:
        train: training episodes.
        validation: validation episodes; may have no rows.
        segments: the segment of each episode.
        scratch: where validation episodes lie, and a few numbers of each of their steps.
    """
    told_by = _telling(train, validation, segments)
    spaces = train.spec
    mean, deviation = float(train.reward.mean(dtype=np.float64)), float(train.reward.std(dtype=np.float64))
    reward = None
    if deviation > SMALLEST_DEVIATION * max(1.0, abs(mean)):
        reward = _network_of_rewards(train, validation, mean, deviation, scratch)
    else:
        deviation = 0.0
    end, threshold = None, 0.0
    if told_by.telling:
        ending = _of_segments(train, segments, told_by.telling)
        held_out = _of_segments(validation, segments, told_by.telling, scratch)
        end, threshold = _network_of_ends(ending, held_out, reward, scratch)
    return LearnedTask(spaces, reward, mean, deviation, end, threshold), told_by


def judge_tasks(
    kept: KeptTask,
    told_by: Telling,
    train: Transitions,
    test: Transitions,
    segments: Mapping[int, str],
    scratch: Scratch = IN_MEMORY,
) -> TaskRecord:
    """Judge who says reward and end on test episodes: what was learned, and the function that is named, if one is.

    Args:
        kept: both of them.
        told_by: which episodes tell where one ends.
        train: training episodes.
        test: test episodes.
        segments: the segment of each episode.
        scratch: where test episodes lie, and a few numbers of each of their steps.

    Raises:
        ModelError: there is no such function, or it fails.
    """
    ending = _of_segments(test, segments, told_by.telling, scratch)
    tasks: dict[str, Told | LearnedTask] = {}
    if kept.function is not None:
        tasks[kept.function] = told(kept.function, "evaluation.reward")
    if kept.learned is not None:
        tasks[LEARNED] = kept.learned
    says_reward, says_end = sources(next(iter(tasks.values()), None))
    return TaskRecord(
        reward_source=says_reward,
        end_source=says_end,
        reward_deviation=_deviation(test.reward, scratch) if len(test) else 0.0,
        ends_in_training=int(train.terminated.sum()),
        silent_steps=dict(told_by.silent),
        judged={name: _judged(task, test, ending, scratch) for name, task in tasks.items()},
    )


def _judged(task: Told | LearnedTask, test: Transitions, ending: Transitions, scratch: Scratch) -> JudgedTask:
    says_reward, says_end = (source != NOBODY for source in sources(task))
    error = (
        scratch.filled(len(test), lambda rows: np.abs(_said(task, test, rows)[0] - test.reward[rows]))
        if says_reward and len(test)
        else None
    )
    false = missed = 0
    for rows in scratch.blocks(len(ending)):
        ends, true = _said(task, ending, rows)[1], ending.terminated[rows]
        false += int((ends & ~true).sum())
        missed += int((~ends & true).sum())
    ended = int(np.count_nonzero(ending.terminated))
    return JudgedTask(
        says_ends=says_end,
        steps=len(test),
        reward_largest_error=None if error is None else float(error.max()),
        reward_rmse=None if error is None else float(np.sqrt(np.square(error, out=error).mean())),
        steps_that_go_on=len(ending) - ended,
        false_ends=false,
        ends=ended,
        missed_ends=missed,
    )


def _said(
    task: Told | LearnedTask, part: Transitions, rows: slice
) -> tuple[Float64[np.ndarray, " chosen"], Bool[np.ndarray, " chosen"]]:
    columns = (part.observation, part.action, part.next_observation, part.exogenous)
    return reward_and_end(task, *(each[rows] for each in columns))


def _deviation(values: Float32[np.ndarray, " step"], scratch: Scratch) -> float:
    """Return the standard deviation, in float64."""
    mean = values.mean(dtype=np.float64)
    squares = scratch.filled(len(values), lambda rows: (values[rows] - mean) ** 2)
    return float(np.sqrt(squares.mean()))


def _telling(train: Transitions, validation: Transitions, segments: Mapping[int, str]) -> Telling:
    telling = {segments[int(each)] for part in (train, validation) for each in part.episode[part.terminated]}
    episodes, counts = np.unique(train.episode, return_counts=True)
    silent = dict[str, int]()
    for episode, count in zip(episodes.tolist(), counts.tolist(), strict=True):
        if telling and segments[episode] not in telling:
            silent[segments[episode]] = silent.get(segments[episode], 0) + count
    return Telling(frozenset(telling), silent)


def _of_segments(
    part: Transitions, segments: Mapping[int, str], wanted: frozenset[str], scratch: Scratch = IN_MEMORY
) -> Transitions:
    """Return the episodes of some segments; all if none are wanted."""
    blocks = [np.unique(part.episode[rows]) for rows in scratch.blocks(len(part))]
    every = np.unique(np.concatenate([part.episode[:0], *blocks]))
    inside = [episode for episode in every.tolist() if segments[episode] in wanted]
    if not wanted or len(inside) == len(every):
        return part
    chosen = scratch.filled(len(part), lambda rows: np.isin(part.episode[rows], inside))
    kept = (part.select(slice(rows.start, rows.stop)).select(chosen[rows]) for rows in scratch.blocks(len(part)))
    return joined(kept, int(np.count_nonzero(chosen)), scratch.like)


def _inputs(part: Transitions, rows: slice | Int64[np.ndarray, " chosen"]) -> Float[Tensor, "chosen input"]:
    return task_inputs(
        part.spec, part.observation[rows], part.action[rows], part.next_observation[rows], part.exogenous[rows]
    )


def _chosen(
    part: Transitions, name: str, always: Bool[np.ndarray, " step"] | None, scratch: Scratch
) -> Int64[np.ndarray, " chosen"]:
    """Return rows that are drawn, and all those that are always wanted."""
    wanted = np.empty(0, np.int64) if always is None else np.flatnonzero(always)
    drawn = shuffled(len(part), name, scratch)[: max(0, MOST_ROWS - len(wanted))]
    return np.unique(np.concatenate([wanted, drawn]))


def _long_enough(params: TrainingParams, rows: int) -> TrainingParams:
    """Return how to train on so many rows: in batches and epochs that make enough updates."""
    batch = max(SMALLEST_BATCH, min(params.batch_size, rows * params.epochs // FEWEST_UPDATES))
    epochs = max(params.epochs, math.ceil(FEWEST_UPDATES / updates_per_epoch(rows, 1, batch)))
    return params.model_copy(update={"batch_size": batch, "epochs": epochs})


def _samples(x: Float[Tensor, "row input"], y: Float[Tensor, "row output"]) -> Samples:
    rows = torch.arange(len(x))
    return Samples(x.contiguous(), y.contiguous(), rows, torch.zeros_like(rows))


def _units(x: Float[Tensor, "row input"]) -> tuple[Float[Tensor, " input"], Float[Tensor, " input"]]:
    mean, deviation = x.double().mean(dim=0).float(), x.double().std(dim=0, correction=0).float()
    return mean, torch.where(deviation > SMALLEST_DEVIATION, deviation, 1.0)


def _network_of_rewards(
    train: Transitions, validation: Transitions, mean: float, deviation: float, scratch: Scratch
) -> Fitted:
    parts = [
        (part, _chosen(part, f"reward/{name}", None, scratch))
        for name, part in (("train", train), ("validation", validation if len(validation) else train))
    ]
    inputs = [_inputs(part, rows) for part, rows in parts]
    targets = [
        torch.from_numpy(((part.reward[rows] - mean) / deviation).astype(np.float32)).unsqueeze(1)
        for part, rows in parts
    ]
    centre, unit = _units(inputs[0])
    samples = [_samples((x - centre) / unit, y) for x, y in zip(inputs, targets, strict=True)]
    *_, last = train_ensemble(samples[0], samples[1], _long_enough(REWARD, len(samples[0])), seed=0, loss_unit=1.0)
    return Fitted(last.network.requires_grad_(False), centre, unit)


def _network_of_ends(
    train: Transitions, validation: Transitions, reward: Fitted | None, scratch: Scratch
) -> tuple[Fitted, float]:
    parts = [
        (part, _chosen(part, f"end/{name}", part.terminated, scratch))
        for name, part in (("train", train), ("validation", validation if len(validation) else train))
    ]
    inputs = [end_inputs(_inputs(part, rows), reward) for part, rows in parts]
    centre, unit = _units(inputs[0])
    ended = [torch.from_numpy(part.terminated[rows]) for part, rows in parts]
    rarity = float((~ended[0]).sum() / ended[0].sum().clamp(min=1))
    # What it costs to say that a step goes on, and that it ends: a missed end weighs as much as it is rare.
    costs = [torch.stack([rarity * each, (~each).float()], dim=1).float() for each in ended]
    samples = [_samples((x - centre) / unit, each) for x, each in zip(inputs, costs, strict=True)]
    params = _long_enough(END, len(samples[0]))
    *_, last = train_addressing(samples[0], costs[0], samples[1], costs[1], params, seed=0, variant="cost_sensitive")
    end = Fitted(last.network.requires_grad_(False), centre, unit)
    judge = validation if validation.terminated.any() else train
    scores = scratch.filled(len(judge), lambda rows: end_scores(end, _inputs(judge, rows), reward))
    return end, best_threshold(scores, judge.terminated, scratch)


def best_threshold(
    score: Float64[np.ndarray, " step"], ended: Bool[np.ndarray, " step"], scratch: Scratch = IN_MEMORY
) -> float:
    """Return the threshold above which scores are called ends at the least cost, in the middle of the widest room.

    A missed end costs as many false ones as the square root of how rare ends are: counted alike, the best of all
    would be to never end where an end is one of thousands of steps that are all but the same.
    """
    count, of_ends = len(score), scratch.selected(score, lambda rows: ended[rows])
    weight = np.sqrt(max(1.0, float(count - len(of_ends)) / max(1, len(of_ends))))
    of_ends.sort()
    # Between which two scores it may lie; beyond the lowest and the highest by one.
    edges = scratch.array(count + 2)
    for rows in scratch.blocks(count):
        edges[1 + rows.start : 1 + rows.stop] = score[rows]
    edges[1:-1].sort()
    edges[0], edges[-1] = edges[1] - 1.0, edges[-2] + 1.0
    least, widest, found = np.inf, 0.0, 0.0
    for rows in scratch.blocks(count + 1):
        low, high = edges[rows], edges[rows.start + 1 : rows.stop + 1]
        missed = np.searchsorted(of_ends, low, side="right")
        false = count - len(of_ends) - (np.arange(rows.start, rows.stop) - missed)
        room = high - low
        cost = np.where(room > 0, weight * missed + false, np.inf)
        best = np.flatnonzero(cost == cost.min())
        place = best[room[best].argmax()]
        if cost[place] < least or (cost[place] == least and room[place] > widest):
            least, widest = float(cost[place]), float(room[place])
            found = float((low[place] + high[place]) / 2)
    return found
