"""By what trust is judged: whether it tells good predictions from bad, whether intervals cover their share, how far."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.features.common.spool import IN_MEMORY, Scratch

COVERAGES = tuple(step / 20 for step in range(1, 21))
"""Shares of the points at which the risk is looked at."""


def auroc(
    score: Float[np.ndarray, " point"], positive: Bool[np.ndarray, " point"], scratch: Scratch = IN_MEMORY
) -> float | None:
    """Return the area under the receiver operating characteristic.

    It is the probability that a positive point has a higher score than a negative one; ties count half (Mann and
    Whitney's U over the number of pairs). None if there are no positive or no negative points.

    Args:
        score: higher where a point is thought to be positive; infinite values are ranked as they are.
        positive: what a point is.
        scratch: where the scores of positive points may lie.

    Raises:
        EvaluationError: a score is NaN.
    """
    _refuse_nan("score", score, scratch)
    positives = int(np.count_nonzero(positive))
    negatives = len(score) - positives
    if not positives or not negatives:
        return None
    ordered, twice = scratch.selected(score, lambda rows: positive[rows]), 0
    ordered.sort()
    for rows in scratch.blocks(len(score)):
        # In their order they are found sooner.
        others = np.sort(score[rows][~positive[rows]])
        below, upto = (np.searchsorted(ordered, others, side=side) for side in ("left", "right"))
        twice += int((2 * positives - below - upto).sum())
    return twice / 2 / (positives * negatives)


@dataclass(frozen=True)
class Risk:
    """The mean error of the points that are trusted most, at one coverage."""

    coverage: float
    """Share of the points that are kept, those with the most trust first."""
    risk: float
    """Mean error of those; at coverage 1 it is the mean of all."""
    oracle: float
    """The same where the points with the smallest errors are kept: no trust can do better."""


def risk_against_coverage(
    error: Float[np.ndarray, " point"], trust: Float[np.ndarray, " point"], scratch: Scratch = IN_MEMORY
) -> tuple[Risk, ...]:
    """Return the risk at every one of `COVERAGES`; none if there are no points.

    Points of equal trust are kept in a random order, of which this is the expectation: a trust that is the same
    everywhere has the same risk everywhere.

    Args:
        error: of each prediction, at least 0.
        trust: higher where a prediction is trusted more.
        scratch: where a few numbers of each point may lie.

    Raises:
        EvaluationError: an error or a trust is NaN.
    """
    _refuse_nan("error", error, scratch)
    _refuse_nan("trust", trust, scratch)
    if not len(error):
        return ()
    kept = np.array([int(np.ceil(round(share * len(error), 9))) for share in COVERAGES])
    trusted = _running_means(_alike(error, trust, scratch), kept, scratch)
    smallest = scratch.filled(len(error), lambda rows: error[rows].astype(np.float64))
    smallest.sort()
    oracle = _running_means(smallest, kept, scratch)
    return tuple(map(Risk, COVERAGES, trusted.tolist(), oracle.tolist()))


def _alike(
    error: Float[np.ndarray, " point"], trust: Float[np.ndarray, " point"], scratch: Scratch
) -> Float64[np.ndarray, " point"]:
    """Return the errors in the order of trust, the most first, each the mean of all with the same trust.

    Of points with equal trust any may come first, so that each has their mean.
    """
    count = len(error)
    # Complex numbers are sorted by their real part and then by the imaginary one: here the number of the point.
    keyed = scratch.array((count, 2)).view(np.complex128)[:, 0]
    for rows in scratch.blocks(count):
        keyed[rows] = -trust[rows] + 1j * np.arange(rows.start, rows.stop)
    keyed.sort()
    group, before, last = scratch.array(count, torch.int64), -1, None
    for rows in scratch.blocks(count):
        values = keyed[rows].real
        begins = np.append(values[:1] != last, values[1:] != values[:-1])
        group[rows] = before + np.cumsum(begins)
        before, last = int(group[rows][-1]), values[-1]
    total, members = (scratch.array(before + 1, kind) for kind in (torch.float64, torch.int64))
    for each in (total, members):
        each[:] = 0
    for rows in scratch.blocks(count):
        np.add.at(total, group[rows], error[keyed[rows].imag.astype(np.int64)])
        np.add.at(members, group[rows], 1)
    return scratch.filled(count, lambda rows: total[group[rows]] / members[group[rows]])


def _running_means(
    values: Float64[np.ndarray, " point"], counts: Int64[np.ndarray, " kept"], scratch: Scratch
) -> Float64[np.ndarray, " kept"]:
    """Return the means of so many first values each."""
    found, carried = np.empty(len(counts)), 0.0
    for rows in scratch.blocks(len(values)):
        sums = np.cumsum(np.append(carried, values[rows]))[1:]
        inside = (counts > rows.start) & (counts <= rows.stop)
        found[inside] = sums[counts[inside] - rows.start - 1] / counts[inside]
        carried = sums[-1]
    return found


@dataclass(frozen=True)
class Covered:
    """How much of the truth lies in the intervals that were given for it."""

    dimensions: Float64[np.ndarray, " dimension"]
    """Share of the points, by dimension."""
    of_all: float
    """Share of all numbers: the mean over the dimensions. An interval is of one dimension, and promises this."""
    together: float
    """Share of the points of which every dimension lies in its interval; lower, unless dimensions err together."""
    error: float | None
    """Standard error of `of_all` over the episodes; None if there is only one, or if nobody said which there are."""


def covered(
    truth: Float[np.ndarray, "*point dimension"],
    low: Float[np.ndarray, "*point dimension"],
    high: Float[np.ndarray, "*point dimension"],
    episode: Int64[np.ndarray, " row"] | None = None,
) -> Covered:
    """Return the shares of the truth that lie in the intervals from `low` to `high`, ends included.

    An interval with NaN for an end covers nothing, an infinite one everything.

    Args:
        truth: what happened.
        low: lower ends.
        high: upper ends.
        episode: of each point; every episode then counts as much as any other. None if every point does.

    Raises:
        EvaluationError: there are no points.
    """
    if not truth.size:
        message = "coverage needs at least one point, but there is none; hold more or longer episodes out"
        raise EvaluationError(message)
    inside = ((low <= truth) & (truth <= high)).reshape(-1, truth.shape[-1])
    row = np.arange(len(inside)) if episode is None else episode
    _, place, count = np.unique(row, return_inverse=True, return_counts=True)
    tally = Tally(truth.shape[-1], len(count))
    tally.add(inside, place)
    return tally.covered(count, independent=episode is not None)


class Tally:
    """How many numbers lay in their intervals, by episode, while points are looked at block by block."""

    def __init__(self, dimensions: int, episodes: int) -> None:
        self._sums = np.zeros((dimensions + 2, episodes))

    def add(self, inside: Bool[np.ndarray, "point dimension"], place: Int64[np.ndarray, " point"]) -> None:
        """Add points, each with the place of its episode."""
        for total, each in zip(self._sums, (*inside.T, inside.mean(axis=1), inside.all(axis=1)), strict=True):
            # One after the other, so that it does not matter where a block ends.
            np.add.at(total, place, each)

    def covered(self, count: Int64[np.ndarray, " episode"], *, independent: bool) -> Covered:
        """Return the shares.

        Args:
            count: points of each episode.
            independent: whether they are episodes, over which there is a standard error.
        """
        of_each = self._sums / count
        *dimensions, of_all, together = (float(each.mean()) for each in of_each)
        known = independent and len(count) > 1
        error = float(of_each[-2].std(ddof=1) / np.sqrt(len(count))) if known else None
        return Covered(np.array(dimensions), of_all, together, error)


def break_even_steps(
    model_error: Float[np.ndarray, " step"], reference_error: Float[np.ndarray, " step"]
) -> int | None:
    """Return the first step of a rollout, from 1, at which a model is worse than a reference; None if there is none.

    An error that is NaN is worse.

    Args:
        model_error: after so many steps, for instance the median over episodes.
        reference_error: the same of the reference, for instance of persistence.
    """
    worse = np.flatnonzero(~(model_error <= reference_error))
    return int(worse[0]) + 1 if len(worse) else None


def trusted_steps(
    width: Float[np.ndarray, "episode step dimension"], scale: Float[np.ndarray, " dimension"], share: float
) -> int:
    """Return the horizon of trust: for how many steps of a rollout the intervals stay narrow enough.

    They do as long as the median of their width over the episodes is at most `share` of the range **in every
    dimension**: the one that is known least decides, for a state is of use as a whole. All steps if they always do, 0
    if they never do. A width that is NaN counts as infinite.

    Args:
        width: of the intervals.
        scale: range of each dimension, above 0 and in the same units.
        share: the largest share of the range.

    Raises:
        EvaluationError: there is no episode, or a range is not above 0.
    """
    if not len(width) or not (scale > 0).all():
        message = f"a horizon of trust needs episodes and ranges above 0, found {len(width)} and {scale.tolist()}"
        raise EvaluationError(message)
    relative = np.nan_to_num(width.astype(np.float64), nan=np.inf, posinf=np.inf) / scale
    wide = np.flatnonzero((np.median(relative, axis=0) > share).any(axis=1))
    return int(wide[0]) if len(wide) else width.shape[1]


def map_edges(states: Float[np.ndarray, "point 2"], cells: int) -> Float64[np.ndarray, "2 edge"]:
    """Return the edges of the cells that divide the range of the points evenly, for each of the two dimensions."""
    low, high = states.min(axis=0).astype(np.float64), states.max(axis=0).astype(np.float64)
    return np.stack([np.linspace(*ends, cells + 1) for ends in zip(low, high, strict=True)])


def trust_map(
    states: Float[np.ndarray, "point 2"],
    trust: Float[np.ndarray, " point"],
    cells: int,
    scratch: Scratch = IN_MEMORY,
) -> Float64[np.ndarray, "vertical horizontal"]:
    """Return the mean trust of the points in each cell of `map_edges`; NaN where there are none.

    Args:
        states: two dimensions of the state; the first is drawn from left to right, the second from bottom to top.
        trust: of each point.
        cells: in each direction.
        scratch: where both lie.

    Raises:
        EvaluationError: a state or a trust is NaN, or there are no points.
    """
    _refuse_nan("state", states, scratch)
    _refuse_nan("trust", trust, scratch)
    if not len(states):
        message = "a map of trust needs at least one point, but there is none; hold more or longer episodes out"
        raise EvaluationError(message)
    edges, (count, total) = map_edges(states, cells), np.zeros((2, cells**2))
    for rows in scratch.blocks(len(states)):
        place = [
            np.searchsorted(edge[1:-1], column.astype(np.float64), side="right")
            for edge, column in zip(edges, states[rows].T, strict=True)
        ]
        cell = place[1] * cells + place[0]
        count += np.bincount(cell, minlength=cells**2)
        np.add.at(total, cell, trust[rows].astype(np.float64))
    with np.errstate(invalid="ignore"):
        return (total / count).reshape(cells, cells)


def _refuse_nan(name: str, values: Float[np.ndarray, "point ..."], scratch: Scratch) -> None:
    if bad := sum(int(np.isnan(values[rows]).sum()) for rows in scratch.blocks(len(values))):
        message = f"trust cannot be judged: {bad} of {values.size} values of the {name} are NaN; leave these points out"
        raise EvaluationError(message)
