"""Whose trust is calibrated, and how far it can itself be trusted, on episodes that had no part in it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64

from addressed_dynamics.episodes.splits import Split
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.evaluation.transitions.calibration import (
    follow,
    one_step,
    reachable,
    stretches,
    stretches_from,
)
from addressed_dynamics.evaluation.transitions.candidates import Candidate, origin_of
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.records import NOTHING, REFERENCES
from addressed_dynamics.evaluation.transitions.trust_measures import (
    auroc,
    break_even_steps,
    covered,
    map_edges,
    risk_against_coverage,
    trust_map,
    trusted_steps,
)
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.calibrated import Calibrated
from addressed_dynamics.simulators.delivery import ENSEMBLE, Choice, Origin
from addressed_dynamics.simulators.modes import MODES
from addressed_dynamics.simulators.trust import SIGNALS, Trust, save_trust
from addressed_dynamics.sources.transitions.params import ShiftParams

ASKED = (0.5, 0.9)
"""Coverages that are measured."""
AHEAD = (1, 10, 100)
"""After so many steps of a rollout."""
TRUSTED_SHARE = 0.1
"""Share of the range that a 90 % interval may be wide, within the horizon of trust."""
WINDOW = 20
"""Steps over which changed mechanics are looked for, and over which places in the logs are judged."""
BAD = 0.99
"""An error is bad if it is above this quantile of the validation errors."""
TEST_ROLLOUTS = 400
FEWEST_KNOWN = 20
"""Validation episodes, or all if there are fewer, by which intervals are known well enough to be told in figures."""
CELLS = 24
"""Cells of the map of trust, in each direction."""
MOST_PLACES = 5
"""Places in the logs that are named."""


@dataclass(frozen=True)
class Pair:
    """A model with the second one that it is held against."""

    model: AddressedDynamics
    origin: Origin
    partner: AddressedDynamics
    partner_origin: Origin


def pair_of(candidates: Sequence[Candidate], chosen: Choice) -> Pair | None:
    """Return the model that is meant, in its mode, and a second one; None if no other was trained.

    The second is the same from another seed, else the addressed ensemble of the first seed, else any other.
    """
    models = {origin: each for each in candidates if (origin := origin_of(each)) is not None}
    own = Origin(chosen.candidate, chosen.seed, chosen.variant)
    used = models[own]
    found = used.model
    assert found is not None
    others = [each for each in models if each.candidate not in REFERENCES and _is_other(each, own)]
    if not others:
        return None
    partner = min(others, key=lambda each: (each.candidate != own.candidate, each.candidate != ENSEMBLE))
    second = models[partner].model
    assert second is not None
    mode = next((each for each in MODES if each == chosen.mode), used.mode)
    model = AddressedDynamics(found.features, found.ensemble, found.addressing, mode=mode, origin=own)
    return Pair(model, own, second, partner)


def calibrated(pair: Pair, trust: Trust) -> Calibrated:
    """Return what is to be kept of the trust in a model."""
    single = pair.partner.ensemble.members == 1
    partner = {**asdict(pair.partner_origin), "mode": None if single else pair.partner.mode}
    return Calibrated(pair.origin, pair.model.mode, lambda folder: save_trust(folder, trust, partner))


@dataclass(frozen=True)
class _Looked:
    """What a model and its trust say of points, one step ahead."""

    points: Points
    error: Float64[np.ndarray, " point"]
    """Root mean square over the dimensions, in multiples of their ranges."""
    trust: Float64[np.ndarray, " point"]
    surprise: Float64[np.ndarray, " point"]
    expected: Float64[np.ndarray, " point"]
    """What was expected of `error`."""
    scores: Mapping[str, Float64[np.ndarray, " point"]]
    """The larger, the less is to be trusted."""


def judge_trust(
    pair: Pair,
    trust: Trust,
    points: Mapping[Split, Points],
    shifts: Mapping[str, Transitions],
    kinds: Sequence[ShiftParams],
    errors: Mapping[str, Float64[np.ndarray, " step"]],
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return how far the trust in a model can itself be trusted, for evaluation.json, and arrays for figures.

    Args:
        pair: the model and the second one.
        trust: what was calibrated.
        points: those of the splits `validation` and `test`.
        shifts: transitions unlike those of the training, by name.
        kinds: what is not as in the training.
        errors: errors of the median rollout against the horizon, of `model` and of the reference that nothing changes.
    """
    splits: tuple[Split, ...] = ("validation", "test")
    looked = {split: _look(pair, trust, points[split]) for split in splits}
    test, features = looked["test"], pair.model.features
    scale = np.array(features.scale)
    coverage, horizon, steps = _coverage(pair, trust, points, scale)
    record: dict[str, Any] = {
        "model": str(pair.origin),
        "episodes": trust.episodes,
        "coverage": coverage,
        "shifts": {
            kind.name: _shift(pair, trust, kind.kind, Points.of(shifts[kind.name], features), looked) for kind in kinds
        },
        "risk": [asdict(each) for each in risk_against_coverage(test.error, test.trust)],
        "trusted_steps": horizon,
        "rollout_steps": steps,
        "trusted_share": TRUSTED_SHARE,
        "step_seconds": features.spaces.step_seconds,
        "places": _places(looked.values()),
    }
    if NOTHING in errors:
        record["break_even_steps"] = break_even_steps(errors["model"], errors[NOTHING])
        record["compared_steps"] = len(errors["model"])
    plane = test.points.features.plane(test.points.observation)
    if plane is None:
        return record, {}
    return record, {"trust_map": trust_map(plane, test.trust, CELLS), "trust_map_edges": map_edges(plane, CELLS)}


def half_widths(
    pair: Pair, trust: Trust, truth: TrueRollouts, validation: Points
) -> Float64[np.ndarray, "rollout step state"] | None:
    """Return half of the widest intervals of `ASKED` around the states that a model predicts in rollouts.

    They are infinite beyond the steps that were calibrated on `FEWEST_KNOWN` episodes, or on all if there are fewer:
    the longest episodes are those that come to rest, and say little of others. None if there are too few errors for
    such intervals.

    Args:
        pair: the model and the second one.
        trust: what was calibrated.
        truth: the rollouts.
        validation: what it was calibrated on.
    """
    if not trust.coverages[0] <= ASKED[-1] <= trust.coverages[-1]:
        return None
    half = np.full((len(truth.states), truth.steps, truth.states.shape[2]), np.inf)
    history, actions, exogenous = truth.given
    known = actions.shape[1] - truth.steps + reachable(validation, min(truth.steps, trust.steps[-1]), FEWEST_KNOWN)
    beside = np.empty((*actions.shape[:2], 0), np.float32) if exogenous is None else exogenous
    given = [torch.from_numpy(each) for each in (history, actions[:, :known], beside[:, :known])]
    followed = follow(pair.model, pair.partner, trust.gauge, *given)
    found = trust.half(followed.scale, ASKED[-1]).double().numpy()
    half[:, : found.shape[1]] = found
    return half


def _is_other(origin: Origin, own: Origin) -> bool:
    return (origin.candidate, origin.seed) != (own.candidate, own.seed)


def _look(pair: Pair, trust: Trust, points: Points) -> _Looked:
    scale = torch.tensor(pair.model.features.scale)
    error, scales = one_step(pair.model, pair.partner, trust.gauge, points, torch.arange(len(points)))
    ordered = points.probabilities(pair.model).sort(dim=1, descending=True).values.double().numpy()
    scores = {"trust": trust.unlikely(scales.signals), **dict(zip(SIGNALS, scales.signals, strict=True))}
    if ordered.shape[1] > 1:
        scores["margin"] = 1.0 - (ordered[:, 0] - ordered[:, 1])
    sizes = [(each / scale).double().square().mean(dim=1).sqrt().numpy() for each in (error, scales.error)]
    surprise = trust.surprises(error, scales.error)
    return _Looked(points, sizes[0], trust.trust(scales.signals), surprise, sizes[1], scores)


def _coverage(
    pair: Pair, trust: Trust, points: Mapping[Split, Points], scale: Float64[np.ndarray, " dimension"]
) -> tuple[list[dict[str, Any]], int | None, int | None]:
    """Return how much intervals cover of the test episodes, and the horizon of trust within so many steps."""
    test = points["test"]
    names = [each.name for each in pair.model.features.spaces.observation]
    rows = []
    error, scales = one_step(pair.model, pair.partner, trust.gauge, test, torch.arange(len(test)))
    zero = torch.zeros_like(error).numpy()
    known = [asked for asked in ASKED if trust.coverages[0] <= asked <= trust.coverages[-1]]
    for asked in known:
        half = trust.half(scales.error.unsqueeze(1), asked)[:, 0]
        rows.append(_covered(1, asked, zero, (error - half).numpy(), (error + half).numpy(), names, test.episode))
    longest = min(trust.steps[-1], reachable(test, trust.steps[-1]))
    if longest < 2:
        return rows, None, None
    ways = stretches(test, longest, TEST_ROLLOUTS, "trust/test")
    followed = follow(pair.model, pair.partner, trust.gauge, ways.history, ways.actions, ways.exogenous)
    truth = ways.states.numpy()
    for steps in [each for each in AHEAD[1:] if each <= longest]:
        there = ways.there[:, steps - 1]
        for asked in known:
            half = trust.half(followed.scale, asked)
            low, high = ((followed.states + sign * half)[there, steps - 1].numpy() for sign in (-1, 1))
            rows.append(_covered(steps, asked, truth[there, steps - 1], low, high, names, ways.episode[there]))
    if ASKED[-1] not in known:
        return rows, None, longest
    steps = reachable(points["validation"], longest, FEWEST_KNOWN)
    width = 2 * trust.half(followed.scale[:, :steps], ASKED[-1]).double().numpy()
    return rows, trusted_steps(width, scale, TRUSTED_SHARE), steps


def _covered(
    steps: int,
    asked: float,
    truth: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    names: Sequence[str],
    episode: Int64[np.ndarray, " point"],
) -> dict[str, Any]:
    found = covered(truth, low, high, episode)
    return {
        "steps": steps,
        "asked": asked,
        "of_all": found.of_all,
        "standard_error": found.error,
        "dimensions": dict(zip(names, found.dimensions.tolist(), strict=True)),
        "points": len(truth),
        "episodes": len(np.unique(episode)),
    }


def _shift(pair: Pair, trust: Trust, kind: str, points: Points, looked: Mapping[Split, _Looked]) -> dict[str, Any]:
    """Return how well scores tell bad predictions from good ones, among those under a shift and those of the test.

    Bad is what is above the quantile `BAD` of the validation errors. Where all are, or none is, nothing can be told
    apart so, and bad is what is above that quantile of these very predictions. What nothing can be counted over, as
    episodes are too short for it, is None.
    """
    shifted, test = _look(pair, trust, points), looked["test"]
    if kind != "mechanics":
        held_out, *errors = looked["validation"].error, shifted.error, test.error
        scores = [dict(each.scores) | {"surprise": each.surprise} for each in (shifted, test)]
    else:
        held_out, *errors = (_window_errors(pair, each.points) for each in (looked["validation"], shifted, test))
        scores = [_over_windows(each) for each in (shifted, test)]
    if not len(errors[0]) or not len(held_out):
        return {"kind": kind, "auroc": dict.fromkeys(scores[0]), "positive_share": None}
    both, limit = np.concatenate(errors), float(np.quantile(held_out, BAD))
    absolute = bool((both > limit).any() and (both <= limit).any())
    positive: Bool[np.ndarray, " point"] = both > (limit if absolute else np.quantile(both, BAD))
    return {
        "kind": kind,
        "auroc": {name: auroc(np.concatenate([each[name] for each in scores]), positive) for name in scores[0]},
        "positive_share": float((errors[0] > limit).mean()),
        "bad": "validation" if absolute else "worst",
    }


def _over_windows(looked: _Looked) -> dict[str, Float64[np.ndarray, " window"]]:
    """Return the mean of each score over windows."""
    rows = window_starts(looked.points)[:, None] + np.arange(WINDOW)
    scores = dict(looked.scores) | {"surprise": looked.surprise}
    return {name: each[rows].mean(axis=1) for name, each in scores.items()}


def _window_errors(pair: Pair, points: Points) -> Float64[np.ndarray, " window"]:
    """Return the root mean square error of rollouts over windows, in multiples of the ranges."""
    ways = stretches_from(points, window_starts(points), WINDOW)
    predicted = pair.model.rollout(ways.history, ways.actions, exogenous=_given(ways.exogenous)).double()
    squared = ((predicted - ways.states) / torch.tensor(pair.model.features.scale)).square()
    errors: Float64[np.ndarray, " window"] = squared.mean(dim=(1, 2)).sqrt().nan_to_num(nan=1e6, posinf=1e6).numpy()
    return errors


def _given(exogenous: torch.Tensor) -> torch.Tensor | None:
    return exogenous if exogenous.shape[-1] else None


def window_starts(points: Points) -> Int64[np.ndarray, " window"]:
    """Return the numbers of the points at which windows of `WINDOW` points begin, one after the other in an episode."""
    episode = points.episode
    first = np.flatnonzero(np.append(True, episode[1:] != episode[:-1])) if len(episode) else np.empty(0, np.int64)
    lengths = np.diff(np.append(first, len(episode)))
    starts = [begin + np.arange(0, length - WINDOW + 1, WINDOW) for begin, length in zip(first, lengths, strict=True)]
    return np.concatenate(starts).astype(np.int64) if starts else np.empty(0, np.int64)


def _places(looked: Iterable[_Looked]) -> list[dict[str, Any]]:
    """Return where in the logs more data would help most: the windows in which the largest errors are expected."""
    places = sorted((place for each in looked for place in _windows(each)), key=lambda place: -place[0])
    return [record for _, record in places[:MOST_PLACES]]


def _windows(looked: _Looked) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield the windows with the largest errors that are expected, as root mean squares, and what is known of them."""
    points, starts = looked.points, window_starts(looked.points)
    inside = starts[:, None] + np.arange(WINDOW)
    names = [dimension.name for dimension in points.features.spaces.observation]
    expected, error = (np.sqrt(np.square(each)[inside].mean(axis=1)) for each in (looked.expected, looked.error))
    for place in np.argsort(-expected, kind="stable")[:MOST_PLACES].tolist():
        state = points.observation[inside[place]].mean(axis=0).tolist()
        yield (
            float(expected[place]),
            {
                "episode": int(points.episode[starts[place]]),
                "step": int(points.step[starts[place]]),
                "steps": WINDOW,
                "expected_percent": float(100 * expected[place]),
                "error_percent": float(100 * error[place]),
                "trust": float(looked.trust[inside[place]].mean()),
                "state": dict(zip(names, state, strict=True)),
            },
        )
