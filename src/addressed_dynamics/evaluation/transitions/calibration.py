"""Calibrate how far a model is to be trusted, on validation episodes: they are what is exchangeable with new ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Float64, Int64
from torch import Tensor

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.base.params.sections import OptimiserParams
from addressed_dynamics.base.params.training import EnsembleParams
from addressed_dynamics.base.torch_runtime import named_generator
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.common.spool import Scratch
from addressed_dynamics.features.transitions.windows import windows
from addressed_dynamics.networks.stacked import CHUNK_ROWS, StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.trust import (
    Followed,
    Gauge,
    Reference,
    Scales,
    Trust,
    beyond_expectation,
    difference,
    fingerprint,
    together,
)
from addressed_dynamics.training.ensemble import train_ensemble

FEWEST_EPISODES = 2
"""Validation episodes without which nothing can be calibrated."""
COVERAGES = (0.01, 0.02, *(round(0.05 * k, 2) for k in range(1, 20)), 0.98, 0.99)
"""Shares of errors whose intervals are kept; others lie between them."""
STEPS = (1, 2, 3, 5, 7, 10, 15, 20, 30, 50, 70, 100, 150, 200, 300, 500, 700, 1000, 1500, 2000)
"""Steps of a rollout whose errors are looked at; others lie between them."""
MOST_POINTS = 50_000
"""Training points that the network of errors and the centres are made of, at most; as many validation points."""
CENTRES = 512
MOST_STEPS = 120_000
"""Steps of all rollouts together that one calibration takes."""
MOST_ROLLOUTS = 2_000
LONG = 100
"""Steps after a start that count as many."""
SMALLEST_DEVIATION = 1e-5
"""An input that deviates less is constant: its unit stays as it is, so that rounding is no deviation."""
FOLDS = 10
"""Parts of the validation episodes of which each in turn is judged by the others."""
ERRORS = EnsembleParams(
    members=1, hidden=(64, 64), activation="tanh", loss="mse", optimiser=OptimiserParams(learning_rate=3e-3),
    batch_size=256, epochs=12, cluster_epochs=1, early_stopping=4,
)  # fmt: skip
"""How the network of errors is trained."""


@dataclass(frozen=True)
class Stretches:
    """Recorded stretches of episodes from many starts on, as far as each episode goes."""

    history: Float32[Tensor, "stretch ..."]
    """First states with those before them, as `AddressedDynamics.rollout` takes them."""
    actions: Tensor
    """The actions beside them and after them; where the episode is over, its last."""
    exogenous: Float32[Tensor, "stretch time exogenous"]
    """What stands beside the actions."""
    states: Float32[Tensor, "stretch step observation"]
    """What really followed."""
    there: Bool[np.ndarray, "stretch step"]
    """Whether the episode goes on so long."""
    episode: Int64[np.ndarray, " stretch"]


def calibrate(
    model: AddressedDynamics, partner: AddressedDynamics, train: Points, validation: Points, *, steps: int
) -> Trust:
    """Return how far a model is to be trusted.

    Intervals are calibrated by the errors of validation episodes, one step ahead and in rollouts that begin all over
    them. How much wider they must be than those errors say, because a new episode is another one, follows from judging
    each part of the episodes by the others.

    Args:
        model: in the mode in which it is used.
        partner: a second model of the same data.
        train: what both were trained on.
        validation: what neither was.
        steps: longest rollouts.

    Raises:
        EvaluationError: there are too few validation episodes.
    """
    episodes = len(validation.begins) - 1
    if episodes < FEWEST_EPISODES:
        message = (
            f"calibration needs at least {FEWEST_EPISODES} validation episodes, but there are {episodes}: raise "
            "convert.validation_share or record more episodes"
        )
        raise EvaluationError(message)
    gauge = make_gauge(model, partner, train, validation)
    chosen = _drawn(validation, "trust/validation")
    error, found = one_step(model, partner, gauge, validation, chosen)
    signals = tuple(Reference.of(each) for each in found.signals)
    combined = Reference.of(together(signals, found.signals))
    surprise = Reference.of(beyond_expectation(error, found.error))
    # Of so many points, the largest error is the quantile of no larger share.
    coverages = tuple(share for share in COVERAGES if share <= len(chosen) / (len(chosen) + 1))
    multiples, reached = (
        [_multiples((error.abs() / found.error).numpy(), validation.episode[chosen.numpy()], coverages)],
        [1],
    )
    for step, ratios, of in _rollout_ratios(model, partner, gauge, validation, steps):
        multiples.append(np.maximum(_multiples(ratios, of, coverages, one_course=step >= LONG), 0.0))
        reached.append(step)
    return Trust(
        gauge, partner, signals, combined, surprise, tuple(reached), coverages,
        np.stack(multiples).astype(np.float32), episodes, (fingerprint(model), fingerprint(partner)),
    )  # fmt: skip


def make_gauge(model: AddressedDynamics, partner: AddressedDynamics, train: Points, validation: Points) -> Gauge:
    """Return what is expected of a model's errors, learned from its errors in training and weighted in validation."""
    chosen, held_out = _drawn(train, "trust/train"), _drawn(validation, "trust/validation")
    x, x_validation = train.x(model.features)[chosen], validation.x(model.features)[held_out]
    scale = torch.tensor(model.features.scale)
    error, _ = _errors(model, partner, train, chosen)
    error_validation, apart = _errors(model, partner, validation, held_out)
    error, error_validation, apart = error.abs() / scale, error_validation.abs() / scale, apart.abs() / scale
    floor = torch.from_numpy(np.quantile(error.numpy(), 0.01, axis=0)).float() + 1e-9
    logs, logs_validation = (error + floor).log(), (error_validation + floor).log()
    mean, deviation = x.double().mean(dim=0).float(), x.std(dim=0, correction=0)
    deviation = torch.where(deviation > SMALLEST_DEVIATION, deviation, 1.0)
    standard, standard_validation = (x - mean) / deviation, (x_validation - mean) / deviation
    error_mean = logs.mean(dim=0)
    network = _network_of_errors(standard, logs - error_mean, standard_validation, logs_validation - error_mean)
    covariance = standard.double().T @ standard.double() / len(standard) + 1e-6 * torch.eye(len(mean)).double()
    whitening = torch.linalg.cholesky(torch.linalg.inv(covariance)).float()
    with torch.no_grad():
        says = network(standard_validation)[0] + error_mean
    tensors = {
        "mean": mean, "deviation": deviation, "whitening": whitening, "centres": cover(x, CENTRES),
        "error_mean": error_mean, "floor": floor, "limits": torch.ones(2),
        "weights": _weights(says, (apart + floor).log(), logs_validation),
    }  # fmt: skip
    unlimited = Gauge(model.features, network, tensors)
    with torch.no_grad():
        distances = unlimited.scales(x_validation, torch.zeros_like(apart)).signals[1:]
    limits = torch.from_numpy(np.exp(np.quantile(distances, 0.99, axis=1))).float().clamp(min=1e-6)
    return Gauge(model.features, network, {**tensors, "limits": limits})


def cover(x: Float[Tensor, "row input"], number: int) -> Float[Tensor, "centre input"]:
    """Return rows that cover all: each next one is the farthest from those before (Gonzalez 1985)."""
    chosen = [int((x - x.mean(dim=0)).square().sum(dim=1).argmin())]
    nearest = (x - x[chosen[0]]).square().sum(dim=1)
    while len(chosen) < min(number, len(x)) and float(nearest.max()) > 0:
        chosen.append(int(nearest.argmax()))
        nearest = torch.minimum(nearest, (x - x[chosen[-1]]).square().sum(dim=1))
    return x[chosen].clone()


@torch.no_grad()
def one_step(
    model: AddressedDynamics, partner: AddressedDynamics, gauge: Gauge, points: Points, chosen: Int64[Tensor, " chosen"]
) -> tuple[Float[Tensor, "chosen observation"], Scales]:
    """Return the errors of some points one step ahead, in the environment's units, and what was expected of them."""
    error, apart = _errors(model, partner, points, chosen)
    return error, gauge.scales(points.x(model.features)[chosen], apart)


def stretches(points: Points, steps: int, most: int, name: str) -> Stretches:
    """Return recorded stretches of at most so many steps from starts that are drawn.

    Half of them are drawn from all points, and half from those that have `LONG` steps after them, or `steps`: many
    starts are near the end of their episodes. Of each half, an episode has as many as any other where it has them.

    Args:
        points: of the episodes.
        steps: longest stretch.
        most: number of starts, at most.
        name: of the source of randomness.
    """
    order = shuffled(len(points), name, points.scratch)
    ends = np.cumsum(points.lengths)

    def long_enough(point: Int64[np.ndarray, " chosen"]) -> Bool[np.ndarray, " chosen"]:
        row = points.rows[point]
        long: Bool[np.ndarray, " chosen"] = ends[np.searchsorted(ends, row, side="right")] - row >= min(LONG, steps)
        return long

    far = _in_turn(order, points, long_enough, most // 2)
    near = _in_turn(order, points, lambda point: ~np.isin(point, far), most - len(far))
    return stretches_from(points, np.sort(np.concatenate([far, near])), steps)


def shuffled(count: int, name: str, scratch: Scratch) -> Int64[np.ndarray, " row"]:
    """Return so many numbers in an order that is drawn from the source of randomness with this name."""
    drawn = scratch(count, torch.int64)
    torch.randperm(count, generator=named_generator(0, name), out=drawn)
    found: Int64[np.ndarray, " row"] = drawn.numpy()
    return found


def _in_turn(
    order: Int64[np.ndarray, " point"],
    points: Points,
    wanted: Callable[[Int64[np.ndarray, " chosen"]], Bool[np.ndarray, " chosen"]],
    most: int,
) -> Int64[np.ndarray, " chosen"]:
    """Return the first so many of the points that are wanted: every episode gives its first, then all their second."""
    given = np.zeros(len(points.begins) - 1, dtype=np.int64)
    found, turns = np.empty(0, np.int64), np.empty(0, np.int64)
    for rows in points.scratch.blocks(len(order)):
        chosen = order[rows][wanted(order[rows])]
        place = np.searchsorted(points.begins, chosen, side="right") - 1
        by_episode = np.argsort(place, kind="stable")
        ordered = place[by_episode]
        turn = np.empty(len(chosen), dtype=np.int64)
        turn[by_episode] = given[ordered] + np.arange(len(chosen)) - np.searchsorted(ordered, ordered)
        given += np.bincount(place, minlength=len(given))
        found, turns = np.append(found, chosen), np.append(turns, turn)
        first = np.argsort(turns, kind="stable")[:most]
        found, turns = found[first], turns[first]
    return found


def stretches_from(points: Points, starts: Int64[np.ndarray, " stretch"], steps: int) -> Stretches:
    """Return recorded stretches of at most so many steps from the points with these numbers on."""
    transitions, history = points.transitions, points.features.history
    start = points.rows[starts]
    last = points.last_rows(start)
    after = start[:, None] + np.arange(steps)
    within = np.minimum(start[:, None] + np.arange(1 - history, steps), last[:, None])
    return Stretches(
        windows(torch.from_numpy(transitions.observation), torch.from_numpy(start), history),
        torch.from_numpy(transitions.action[within]),
        torch.from_numpy(transitions.exogenous[within]),
        torch.from_numpy(transitions.next_observation[np.minimum(after, last[:, None])]),
        after <= last[:, None],
        transitions.episode[start],
    )


@torch.no_grad()
def follow(
    model: AddressedDynamics,
    partner: AddressedDynamics,
    gauge: Gauge,
    history: Tensor,
    actions: Tensor,
    exogenous: Tensor,
) -> Followed:
    """Return a model's rollouts, with what was expected of its errors; the last three are as in `Stretches`."""
    return model.follow(history, actions, exogenous, partial(gauge.beside, partner), model.mode)


def reachable(points: Points, steps: int, episodes: int = FEWEST_EPISODES) -> int:
    """Return the longest rollout of at most so many steps that so many episodes have, or all if there are fewer."""
    lengths = np.sort(np.diff(points.begins))
    return int(min(steps, lengths[-min(episodes, len(lengths))])) if len(lengths) >= FEWEST_EPISODES else 0


def _rollout_ratios(
    model: AddressedDynamics, partner: AddressedDynamics, gauge: Gauge, validation: Points, steps: int
) -> Iterator[tuple[int, Float64[np.ndarray, "rollout observation"], Int64[np.ndarray, " rollout"]]]:
    """Yield the errors of rollouts in multiples of what was expected, after more and more steps, and their episodes."""
    longest = reachable(validation, steps)
    if longest < STEPS[1]:
        return
    # Half of all steps are in rollouts as long as most questions are: the more episodes, the better they are known.
    lengths = sorted({min(LONG, longest), longest})
    for before, length in zip((1, *lengths), lengths, strict=False):
        number = min(MOST_ROLLOUTS, max(FOLDS, MOST_STEPS // len(lengths) // length))
        ways = stretches(validation, length, number, "trust/rollouts")
        followed = follow(model, partner, gauge, ways.history, ways.actions, ways.exogenous)
        ratio = ((followed.states - ways.states).double().abs() / followed.scale).nan_to_num(nan=torch.inf).numpy()
        for step in [each for each in STEPS if before < each <= length]:
            there = ways.there[:, step - 1]
            if len(np.unique(ways.episode[there])) < FEWEST_EPISODES:
                return
            yield step, ratio[there, step - 1], ways.episode[there]


def _multiples(
    ratios: Float64[np.ndarray, "row observation"] | Float32[np.ndarray, "row observation"],
    episode: Int64[np.ndarray, " row"],
    coverages: Sequence[float],
    *,
    one_course: bool = False,
) -> Float64[np.ndarray, "coverage observation"]:
    """Return for each coverage the multiple of the expected sizes that covers as many errors of other episodes.

    Every episode counts as much as any other, however many errors are of it (hierarchical conformal prediction:
    Dunn et al. 2023, Lee et al. 2023): a new episode is exchangeable with them, and its errors are with its own alone.
    Where stretches of an episode are so long that they count as one course, no quantile of n episodes promises to cover
    more than n / (n + 1) of another's errors: beyond, all that were seen are covered.
    """
    values = np.where(np.isfinite(ratios), ratios, np.nanmax(ratios, where=np.isfinite(ratios), initial=0.0))
    levels = np.concatenate([np.linspace(0.0, 0.98, 99), np.linspace(0.981, 1.0, 20)])
    order = np.unique(episode)
    folds = np.array_split(np.random.default_rng(0).permutation(order), min(FOLDS, len(order)))
    weights, promised = episode_weights(episode), len(order) / (len(order) + 1) if one_course else 1.0
    covered = np.zeros((len(levels), values.shape[1]))
    for fold in folds:
        inside = np.isin(episode, fold)
        for column in range(values.shape[1]):
            limits = _weighted_quantiles(values[~inside, column], weights[~inside], levels)
            place = np.argsort(values[inside, column], kind="stable")
            upto = np.append(0.0, np.cumsum(weights[inside][place]))
            covered[:, column] += upto[np.searchsorted(values[inside, column][place], limits, side="right")]
    found = []
    for column in range(values.shape[1]):
        # As often as not exactly so many are covered; a level is the lowest that covers enough.
        rising = np.maximum.accumulate(covered[:, column])
        level = np.where(np.array(coverages) > promised, 1.0, np.interp(coverages, rising, levels))
        found.append(_weighted_quantiles(values[:, column], weights, level))
    return np.stack(found, axis=1)


def episode_weights(episode: Int64[np.ndarray, " row"]) -> Float64[np.ndarray, " row"]:
    """Return weights of rows, 1 together, by which all episodes count the same."""
    _, place, count = np.unique(episode, return_inverse=True, return_counts=True)
    weights: Float64[np.ndarray, " row"] = 1.0 / (count[place] * len(count))
    return weights


def _weighted_quantiles(
    values: Float64[np.ndarray, " row"], weights: Float64[np.ndarray, " row"], levels: Float64[np.ndarray, " level"]
) -> Float64[np.ndarray, " level"]:
    """Return quantiles: linear between the values, each of which stands in the middle of its weight."""
    order = np.argsort(values, kind="stable")
    share = np.cumsum(weights[order]) - weights[order] / 2.0
    found: Float64[np.ndarray, " level"] = np.interp(levels, share / weights.sum(), values[order])
    return found


def _network_of_errors(x: Tensor, logs: Tensor, x_validation: Tensor, logs_validation: Tensor) -> StackedMLP:
    parts = []
    for inputs, outputs in ((x, logs), (x_validation, logs_validation)):
        rows = torch.arange(len(inputs))
        parts.append(Samples(inputs.float().contiguous(), outputs.float().contiguous(), rows, torch.zeros_like(rows)))
    *_, last = train_ensemble(parts[0], parts[1], ERRORS, seed=0, loss_unit=1.0)
    return last.network


def _weights(
    says: Float[Tensor, "row observation"],
    apart: Float[Tensor, "row observation"],
    logs: Float[Tensor, "row observation"],
) -> Float[Tensor, "3 observation"]:
    """Return weights of two logarithms, neither below 0, and a constant, with the least squared error of a third."""
    found = []
    for column in range(logs.shape[1]):
        a, b, y = (each[:, column].double().numpy() for each in (says, apart, logs))
        options = []
        for used in ((0, 1), (0,), (1,), ()):
            matrix = np.stack([*((a, b)[k] for k in used), np.ones_like(y)], axis=1)
            solution = np.linalg.lstsq(matrix, y, rcond=None)[0]
            if (solution[:-1] >= 0).all():
                weights = np.zeros(3)
                weights[[*used, 2]] = solution
                options.append((float(((matrix @ solution - y) ** 2).mean()), weights))
        found.append(min(options, key=lambda option: option[0])[1])
    return torch.from_numpy(np.stack(found, axis=1)).float()


@torch.no_grad()
def _errors(
    model: AddressedDynamics, partner: AddressedDynamics, points: Points, chosen: Int64[Tensor, " chosen"]
) -> tuple[Float[Tensor, "chosen observation"], Float[Tensor, "chosen observation"]]:
    """Return errors one step ahead, and what a second model predicts otherwise, both in the environment's units."""
    errors, apart = [], []
    truth = torch.from_numpy(points.next_observation)
    for part in torch.split(chosen, CHUNK_ROWS):
        observation, action = points.inputs(part)
        given = (observation, action, points.exogenous_inputs(part))
        x = points.x(model.features)[part]
        predicted = model.step(*given, x=x)
        errors.append(truth[part] - predicted)
        apart.append(difference(model, partner, *given, predicted, x))
    return torch.cat(errors), torch.cat(apart)


def _drawn(points: Points, name: str) -> Int64[Tensor, " chosen"]:
    """Return numbers of points, drawn without repetition and sorted; all if they are few."""
    return torch.from_numpy(np.sort(shuffled(len(points), name, points.scratch)[:MOST_POINTS]))
