"""Whose trust is calibrated, and how far it can itself be trusted, on episodes that had no part in it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, Int64

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
    Covered,
    Tally,
    auroc,
    break_even_steps,
    covered,
    map_edges,
    risk_against_coverage,
    trust_map,
    trusted_steps,
)
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts
from addressed_dynamics.features.common.spool import Scratch
from addressed_dynamics.networks.stacked import BLOCKS_HELD, CHUNK_ROWS
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
    off: Float32[np.ndarray, "point observation"]
    """Errors, in the environment's units."""
    size: Float32[np.ndarray, "point observation"]
    """What was expected of them."""
    error: Float64[np.ndarray, " point"]
    """Root mean square over the dimensions, in multiples of their ranges."""
    trust: Float64[np.ndarray, " point"]
    surprise: Float64[np.ndarray, " point"]
    expected: Float64[np.ndarray, " point"]
    """What was expected of `error`."""
    scores: Mapping[str, Float64[np.ndarray, " point"]]
    """The larger, the less is to be trusted."""

    @property
    def scratch(self) -> Scratch:
        """Where all of it lies."""
        return self.points.scratch


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
    coverage, horizon, steps = _coverage(pair, trust, points, test, scale)
    record: dict[str, Any] = {
        "model": str(pair.origin),
        "episodes": trust.episodes,
        "coverage": coverage,
        "shifts": {
            kind.name: _shift(pair, trust, kind.kind, Points.of(shifts[kind.name], features), looked) for kind in kinds
        },
        "risk": [asdict(each) for each in risk_against_coverage(test.error, test.trust, test.scratch)],
        "trusted_steps": horizon,
        "rollout_steps": steps,
        "trusted_share": TRUSTED_SHARE,
        "step_seconds": features.spaces.step_seconds,
        "places": _places(looked.values()),
    }
    if NOTHING in errors:
        record["break_even_steps"] = break_even_steps(errors["model"], errors[NOTHING])
        record["compared_steps"] = len(errors["model"])
    states = test.points.observation
    if features.plane(states[:1]) is None:
        return record, {}
    plane = test.scratch.filled(len(states), lambda rows: np.asarray(features.plane(states[rows])))
    field = trust_map(plane, test.trust, CELLS, test.scratch)
    return record, {"trust_map": field, "trust_map_edges": map_edges(plane, CELLS)}


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
    probabilities = points.probabilities(pair.model)
    parts: dict[str, np.ndarray] = {}

    def look(rows: slice) -> Iterator[tuple[str, np.ndarray]]:
        error, scales = one_step(pair.model, pair.partner, trust.gauge, points, torch.arange(rows.start, rows.stop))
        yield from (("off", error.numpy()), ("size", scales.error.numpy()))
        for name, each in (("error", error), ("expected", scales.error)):
            yield name, (each / scale).double().square().mean(dim=1).sqrt().numpy()
        yield "trust", trust.trust(scales.signals)
        yield "surprise", trust.surprises(error, scales.error)
        yield "score/trust", trust.unlikely(scales.signals)
        for name, signal in zip(SIGNALS, scales.signals, strict=True):
            yield f"score/{name}", signal
        ordered = probabilities[rows].sort(dim=1, descending=True).values.double().numpy()
        if ordered.shape[1] > 1:
            yield "score/margin", 1.0 - (ordered[:, 0] - ordered[:, 1])

    for first in range(0, max(len(points), 1), CHUNK_ROWS):
        rows = slice(first, min(first + CHUNK_ROWS, len(points)))
        for name, part in look(rows):
            if name not in parts:
                parts[name] = points.scratch.array((len(points), *part.shape[1:]), torch.from_numpy(part).dtype)
            parts[name][rows] = part
        if not first // CHUNK_ROWS % BLOCKS_HELD:
            points.scratch.release()
    scores = {name.removeprefix("score/"): parts.pop(name) for name in [*parts] if name.startswith("score/")}
    return _Looked(points, **parts, scores=scores)


def _coverage(
    pair: Pair,
    trust: Trust,
    points: Mapping[Split, Points],
    looked: _Looked,
    scale: Float64[np.ndarray, " dimension"],
) -> tuple[list[dict[str, Any]], int | None, int | None]:
    """Return how much intervals cover of the test episodes, and the horizon of trust within so many steps."""
    test = points["test"]
    names = [each.name for each in pair.model.features.spaces.observation]
    known = [asked for asked in ASKED if trust.coverages[0] <= asked <= trust.coverages[-1]]
    rows = [_covered_at_once(trust, asked, looked, names) for asked in known]
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
            found = covered(truth[there, steps - 1], low, high, ways.episode[there])
            episodes = len(np.unique(ways.episode[there]))
            rows.append(_covered(steps, asked, found, names, int(there.sum()), episodes))
    if ASKED[-1] not in known:
        return rows, None, longest
    steps = reachable(points["validation"], longest, FEWEST_KNOWN)
    width = 2 * trust.half(followed.scale[:, :steps], ASKED[-1]).double().numpy()
    return rows, trusted_steps(width, scale, TRUSTED_SHARE), steps


def _covered_at_once(trust: Trust, asked: float, looked: _Looked, names: Sequence[str]) -> dict[str, Any]:
    """Return how much intervals cover one step ahead."""
    points, begins = looked.points, looked.points.begins
    place = np.argsort(np.argsort(points.episode[begins[:-1]]))
    tally = Tally(len(names), len(place))
    for rows in points.scratch.blocks(len(points)):
        error, size = (torch.from_numpy(each[rows]) for each in (looked.off, looked.size))
        half = trust.half(size.unsqueeze(1), asked)[:, 0]
        inside = (error - half <= 0) & (error + half >= 0)
        tally.add(inside.numpy(), place[points.run(rows)])
    count = np.empty_like(place)
    count[place] = np.diff(begins)
    return _covered(1, asked, tally.covered(count, independent=True), names, len(points), len(place))


def _covered(
    steps: int, asked: float, found: Covered, names: Sequence[str], points: int, episodes: int
) -> dict[str, Any]:
    return {
        "steps": steps,
        "asked": asked,
        "of_all": found.of_all,
        "standard_error": found.error,
        "dimensions": dict(zip(names, found.dimensions.tolist(), strict=True)),
        "points": points,
        "episodes": episodes,
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
    scratch = test.scratch
    both, limit = _joined(errors, scratch), _quantile(held_out, BAD, scratch)
    above = sum(int(np.count_nonzero(both[rows] > limit)) for rows in scratch.blocks(len(both)))
    absolute = 0 < above < len(both)
    least = limit if absolute else _quantile(both, BAD, scratch)
    positive: Bool[np.ndarray, " point"] = scratch.filled(len(both), lambda rows: both[rows] > least)
    return {
        "kind": kind,
        "auroc": {
            name: auroc(_joined([each[name] for each in scores], scratch), positive, scratch) for name in scores[0]
        },
        "positive_share": float((errors[0] > limit).mean()),
        "bad": "validation" if absolute else "worst",
    }


def _joined(parts: Sequence[Float64[np.ndarray, " part"]], scratch: Scratch) -> Float64[np.ndarray, " point"]:
    found: Float64[np.ndarray, " point"] = scratch.array(sum(map(len, parts)))
    return np.concatenate(parts, out=found)


def _quantile(values: Float64[np.ndarray, " point"], share: float, scratch: Scratch) -> float:
    copied = _joined([values], scratch)
    return float(np.quantile(copied, share, overwrite_input=True))


def _by_window(points: Points, function: Callable[[Int64[np.ndarray, " window"]], np.ndarray]) -> np.ndarray:
    """Return `function` of where windows begin, a number for each, in blocks of `CHUNK_ROWS`."""
    starts = window_starts(points)
    parts = [starts[first : first + CHUNK_ROWS] for first in range(0, max(len(starts), 1), CHUNK_ROWS)]
    return np.concatenate([function(part) for part in parts])


def _over_windows(looked: _Looked) -> dict[str, Float64[np.ndarray, " window"]]:
    """Return the mean of each score over windows."""
    scores = dict(looked.scores) | {"surprise": looked.surprise}
    return {name: _by_window(looked.points, partial(_window_means, each)) for name, each in scores.items()}


def _window_means(
    values: Float64[np.ndarray, " point"], starts: Int64[np.ndarray, " window"]
) -> Float64[np.ndarray, " window"]:
    means: Float64[np.ndarray, " window"] = values[starts[:, None] + np.arange(WINDOW)].mean(axis=1)
    return means


def _window_root_mean_squares(
    values: Float64[np.ndarray, " point"], starts: Int64[np.ndarray, " window"]
) -> Float64[np.ndarray, " window"]:
    squares = np.square(values[starts[:, None] + np.arange(WINDOW)])
    found: Float64[np.ndarray, " window"] = np.sqrt(squares.mean(axis=1))
    return found


def _window_errors(pair: Pair, points: Points) -> Float64[np.ndarray, " window"]:
    """Return the root mean square error of rollouts over windows, in multiples of the ranges."""

    def errors(starts: Int64[np.ndarray, " window"]) -> Float64[np.ndarray, " window"]:
        ways = stretches_from(points, starts, WINDOW)
        predicted = pair.model.rollout(ways.history, ways.actions, exogenous=_given(ways.exogenous)).double()
        squared = ((predicted - ways.states) / torch.tensor(pair.model.features.scale)).square()
        found: Float64[np.ndarray, " window"] = squared.mean(dim=(1, 2)).sqrt().nan_to_num(nan=1e6, posinf=1e6).numpy()
        return found

    return _by_window(points, errors)


def _given(exogenous: torch.Tensor) -> torch.Tensor | None:
    return exogenous if exogenous.shape[-1] else None


def window_starts(points: Points) -> Int64[np.ndarray, " window"]:
    """Return the numbers of the points at which windows of `WINDOW` points begin, one after the other in an episode."""
    starts = [np.arange(begin, end - WINDOW + 1, WINDOW) for begin, end in pairwise(points.begins.tolist())]
    return np.concatenate(starts).astype(np.int64) if starts else np.empty(0, np.int64)


def _places(looked: Iterable[_Looked]) -> list[dict[str, Any]]:
    """Return where in the logs more data would help most: the windows in which the largest errors are expected."""
    places = sorted((place for each in looked for place in _windows(each)), key=lambda place: -place[0])
    return [record for _, record in places[:MOST_PLACES]]


def _windows(looked: _Looked) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield the windows with the largest errors that are expected, as root mean squares, and what is known of them."""
    points, starts = looked.points, window_starts(looked.points)
    names = [dimension.name for dimension in points.features.spaces.observation]
    expected, error = (
        _by_window(points, partial(_window_root_mean_squares, each)) for each in (looked.expected, looked.error)
    )
    for place in np.argsort(-expected, kind="stable")[:MOST_PLACES].tolist():
        inside = starts[place] + np.arange(WINDOW)
        state = points.observation[inside].mean(axis=0).tolist()
        yield (
            float(expected[place]),
            {
                "episode": int(points.episode[starts[place]]),
                "step": int(points.step[starts[place]]),
                "steps": WINDOW,
                "expected_percent": float(100 * expected[place]),
                "error_percent": float(100 * error[place]),
                "trust": float(looked.trust[inside].mean()),
                "state": dict(zip(names, state, strict=True)),
            },
        )
