"""All candidates beside each other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from addressed_dynamics.episodes.transitions import Dimension
from addressed_dynamics.evaluation.transitions.records import CandidateResult, Evaluation
from addressed_dynamics.reporting.common.blocks import Figure
from addressed_dynamics.reporting.common.figures.style import OWN, logarithmic, model_style, panel, positive


def candidates(evaluation: Evaluation, dimensions: Sequence[Dimension]) -> Figure:
    """Draw each candidate's one-step and rollout errors as a range with its middle."""
    named = evaluation.candidates

    one_step = {
        name: (each.one_step.scaled.median, each.one_step.scaled.mean, each.one_step.scaled.p99)
        for name, each in named.items()
    }
    height = 0.9 + 0.23 * len(one_step)
    panels = [
        panel(
            "candidates-one-step",
            "One-step error of every candidate: median, mean and 99th percentile",
            partial(_ranges, named=named, spreads=one_step, title="one step, scaled states"),
            size=(4.6, height),
        )
    ]
    for dimension in dimensions:
        spreads = {
            name: (spread.p10, spread.median, spread.p90)
            for name, each in named.items()
            if each.rollouts and (spread := each.rollouts.all.mse.get(dimension.name))
        }
        if spreads:
            title = f"rollouts, {dimension.name}"
            panels.append(
                panel(
                    f"candidates-{dimension.name}",
                    f"Rollout error of {dimension.name} of every candidate: median, 10th and 90th percentile",
                    partial(_ranges, named=named, spreads=spreads, title=title),
                    size=(4.6, 0.9 + 0.23 * len(spreads)),
                )
            )
    shares = {
        name: share
        for name, each in named.items()
        if each.rollouts and (share := each.rollouts.left_bounds_share) is not None
    }
    if shares:
        panels.append(
            panel(
                "candidates-bounds",
                "Share of the rollouts of every candidate that leave the bounds",
                partial(_shares, named=named, shares=shares),
                size=(4.6, 0.9 + 0.23 * len(shares)),
            )
        )
    caption = (
        "All candidates; further left is better. One step: mean error (dot) between the median and the 99th "
        "percentile of all test transitions (bar); a mean beyond the bar comes from a few large errors. Rollouts: "
        "mean squared error of whole rollouts, median (dot) and 10th to 90th percentile (bar) over rollouts"
        f"{'; and the share of rollouts in which a predicted state leaves the bounds' * bool(shares)}."
    )
    return Figure(caption, tuple(panels))


def _short(name: str, candidate: CandidateResult) -> str:
    if not name.startswith("ensemble/"):
        title = model_style(name)[0]
        seed = name.partition("/seed-")[2]
        return f"{title}, seed {seed}" if seed not in {"", "0"} else title
    return candidate.label.removeprefix("ensemble, ").replace(" addressing", "")


def _ranges(
    axes: Axes, named: dict[str, CandidateResult], spreads: dict[str, tuple[float, float, float]], title: str
) -> None:
    for place, (name, spread) in enumerate(spreads.items()):
        low, middle, high = positive(np.array(spread))
        own = name == "ensemble/argmax"
        axes.plot([low, high], [place, place], color=_colour(name, named), linewidth=2.5 if own else 1.5, alpha=0.5)
        axes.plot(middle, place, marker="o", markersize=6 if own else 4.5, color=_colour(name, named))
    axes.set(title=title)
    logarithmic(axes, "x")
    _name_rows(axes, [_short(name, named[name]) for name in spreads])


def _shares(axes: Axes, named: dict[str, CandidateResult], shares: dict[str, float]) -> None:
    for place, (name, share) in enumerate(shares.items()):
        axes.plot([0, 100 * share], [place, place], color=_colour(name, named), linewidth=1.5, alpha=0.5)
        axes.plot(100 * share, place, marker="o", markersize=4.5, color=_colour(name, named))
    axes.set(title="rollouts that leave the bounds (%)", xlim=(-2, 102))
    _name_rows(axes, [_short(name, named[name]) for name in shares])


def _name_rows(axes: Axes, titles: list[str]) -> None:
    axes.set_yticks(range(len(titles)), titles)
    axes.set_ylim(len(titles) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.grid(visible=False, axis="y")


def _colour(name: str, named: Iterable[str]) -> str:
    return OWN if name.startswith("ensemble/") else model_style(name, named)[1]
