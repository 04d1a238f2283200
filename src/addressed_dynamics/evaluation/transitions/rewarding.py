"""Learn reward and end of steps from training episodes, and judge who says them on held-out ones."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from addressed_dynamics.base.params.sections import OptimiserParams
from addressed_dynamics.base.params.training import AddressingTraining, EnsembleParams
from addressed_dynamics.base.torch_runtime import named_generator
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.evaluation.transitions.reward_records import JudgedTask, TaskRecord
from addressed_dynamics.features.common.samples import Samples
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


def learn_task(train: Transitions, validation: Transitions, segments: Mapping[int, str]) -> tuple[LearnedTask, Telling]:
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
    """
    told_by = _telling(train, validation, segments)
    spaces = train.spec
    mean, deviation = float(train.reward.mean(dtype=np.float64)), float(train.reward.std(dtype=np.float64))
    reward = None
    if deviation > SMALLEST_DEVIATION * max(1.0, abs(mean)):
        reward = _network_of_rewards(train, validation, mean, deviation)
    else:
        deviation = 0.0
    end, threshold = None, 0.0
    if told_by.telling:
        ending, held_out = (_of_segments(each, segments, told_by.telling) for each in (train, validation))
        end, threshold = _network_of_ends(ending, held_out, reward)
    return LearnedTask(spaces, reward, mean, deviation, end, threshold), told_by


def judge_tasks(
    kept: KeptTask, told_by: Telling, train: Transitions, test: Transitions, segments: Mapping[int, str]
) -> TaskRecord:
    """Judge who says reward and end on test episodes: what was learned, and the function that is named, if one is.

    Raises:
        ModelError: there is no such function, or it fails.
    """
    ending = _of_segments(test, segments, told_by.telling)
    tasks: dict[str, Told | LearnedTask] = {}
    if kept.function is not None:
        tasks[kept.function] = told(kept.function, "evaluation.reward")
    if kept.learned is not None:
        tasks[LEARNED] = kept.learned
    says_reward, says_end = sources(next(iter(tasks.values()), None))
    return TaskRecord(
        reward_source=says_reward,
        end_source=says_end,
        reward_deviation=float(test.reward.std(dtype=np.float64)) if len(test) else 0.0,
        ends_in_training=int(train.terminated.sum()),
        silent_steps=dict(told_by.silent),
        judged={name: _judged(task, test, ending) for name, task in tasks.items()},
    )


def _judged(task: Told | LearnedTask, test: Transitions, ending: Transitions) -> JudgedTask:
    (reward, _), (_, ends) = (
        reward_and_end(task, part.observation, part.action, part.next_observation, part.exogenous)
        for part in (test, ending)
    )
    says_reward, says_end = (source != NOBODY for source in sources(task))
    error = np.abs(reward - test.reward) if says_reward and len(test) else None
    ended = int(ending.terminated.sum())
    return JudgedTask(
        says_ends=says_end,
        steps=len(test),
        reward_rmse=None if error is None else float(np.sqrt(np.mean(error**2))),
        reward_largest_error=None if error is None else float(error.max()),
        steps_that_go_on=len(ending) - ended,
        false_ends=int((ends & ~ending.terminated).sum()),
        ends=ended,
        missed_ends=int((~ends & ending.terminated).sum()),
    )


def _telling(train: Transitions, validation: Transitions, segments: Mapping[int, str]) -> Telling:
    telling = {segments[int(each)] for part in (train, validation) for each in part.episode[part.terminated]}
    episodes, counts = np.unique(train.episode, return_counts=True)
    silent = dict[str, int]()
    for episode, count in zip(episodes.tolist(), counts.tolist(), strict=True):
        if telling and segments[episode] not in telling:
            silent[segments[episode]] = silent.get(segments[episode], 0) + count
    return Telling(frozenset(telling), silent)


def _of_segments(part: Transitions, segments: Mapping[int, str], wanted: frozenset[str]) -> Transitions:
    """Return the episodes of some segments; all if none are wanted."""
    if not wanted:
        return part
    episodes = np.unique(part.episode)
    inside = [episode for episode in episodes.tolist() if segments[episode] in wanted]
    return part.select(np.isin(part.episode, inside))


def _inputs(part: Transitions, rows: Int64[np.ndarray, " chosen"]) -> Float[Tensor, "chosen input"]:
    return task_inputs(
        part.spec, part.observation[rows], part.action[rows], part.next_observation[rows], part.exogenous[rows]
    )


def _chosen(part: Transitions, name: str, always: Bool[np.ndarray, " step"]) -> Int64[np.ndarray, " chosen"]:
    """Return rows that are drawn, and all those that are always wanted."""
    order = torch.randperm(len(part), generator=named_generator(0, name)).numpy()
    drawn = order[: max(0, MOST_ROWS - int(always.sum()))]
    return np.unique(np.concatenate([np.flatnonzero(always), drawn]))


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


def _network_of_rewards(train: Transitions, validation: Transitions, mean: float, deviation: float) -> Fitted:
    parts = [
        (part, _chosen(part, f"reward/{name}", np.zeros(len(part), bool)))
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


def _network_of_ends(train: Transitions, validation: Transitions, reward: Fitted | None) -> tuple[Fitted, float]:
    parts = [
        (part, _chosen(part, f"end/{name}", part.terminated))
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
    scores = end_scores(end, _inputs(judge, np.arange(len(judge))), reward)
    return end, best_threshold(scores, judge.terminated)


def best_threshold(score: Float64[np.ndarray, " step"], ended: Bool[np.ndarray, " step"]) -> float:
    """Return the threshold above which scores are called ends at the least cost, in the middle of the widest room.

    A missed end costs as many false ones as the square root of how rare ends are: counted alike, the best of all
    would be to never end where an end is one of thousands of steps that are all but the same.
    """
    order = np.argsort(score, kind="stable")
    ordered, true = score[order], ended[order]
    weight = np.sqrt(max(1.0, float((~true).sum()) / max(1, int(true.sum()))))
    missed = np.concatenate([[0], np.cumsum(true)])
    false = np.concatenate([np.cumsum(~true[::-1])[::-1], [0]])
    # Between which two scores it may lie; beyond the lowest and the highest by one.
    edges = np.concatenate([[ordered[0] - 1.0], ordered, [ordered[-1] + 1.0]])
    room = edges[1:] - edges[:-1]
    cost = np.where(room > 0, weight * missed + false, np.inf)
    least = np.flatnonzero(cost == cost.min())
    widest = least[room[least].argmax()]
    return float((edges[widest] + edges[widest + 1]) / 2)
