"""How the members share the samples, on what they have learned from and on held-out episodes (Figs. 8 and 9)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from statistics import median

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Patch

from addressed_dynamics.evaluation.common.records import BaselineLosses, Specialisation, Specialisations
from addressed_dynamics.reporting.common.blocks import Figure, Panel
from addressed_dynamics.reporting.common.figures.style import (
    FAINT,
    INK,
    OWN,
    logarithmic,
    member_colour,
    model_style,
    panel,
    picture,
    positive,
)
from addressed_dynamics.reporting.common.numbers import percent, scientific

SPLITS = ("train", "test")
"""The splits that stand side by side."""


@dataclass(frozen=True)
class Words:
    """What samples and losses are called, which depends on the kind of data."""

    held_out: str = "held-out episodes"
    """What the held-out samples come from."""
    scaled: str = "states scaled to [0, 1]"
    """What losses are of."""
    validation: str = "validation episodes"
    """What the samples come from by which models are chosen."""

    def title(self, split: str) -> str:
        """Return the title of a split."""
        return {"train": "training points", "test": self.held_out}[split]


OF_STATES = Words()
"""Words for the states of environments."""
OF_ANY = Words("held-out data", "what the networks predict, as it is given to them", "validation data")
"""Words for any kind of data."""


def samples_by_member(found: Specialisations, agreement: float | None, words: Words = OF_STATES) -> Figure:
    """Draw how many samples each member serves best and is selected for (Fig. 8).

    Args:
        found: the shares of the members.
        agreement: what the paper reports of it on its training points; None if nothing.
        words: what samples and losses are called.
    """
    panels = both_splits(
        found,
        "samples",
        "Samples on which each network has the lowest loss and is selected",
        _draw_samples,
        words=words,
    )
    reported = "" if agreement is None else f" (the paper, on its training points: {percent(agreement)})"
    least = {name: min(each.addressed) / each.samples for name, each in splits(found)}
    most = {name: max(each.addressed) / each.samples for name, each in splits(found)}
    caption = (
        f"Points per network (Fig. 8 of the paper), of {found.train.samples:,} training points and "
        f"{found.test.samples:,} of {words.held_out}: light, those on which a network has the lowest loss; full, "
        "those for which the addressing network selects it. The two choices agree on "
        f"{percent(found.train.agreement)} of the training points and {percent(found.test.agreement)} of the held-out "
        f"ones{reported}. The networks are selected for {percent(least['train'])} to {percent(most['train'])} of the "
        f"training points each, and for {percent(least['test'])} to {percent(most['test'])} of the held-out ones. Grey "
        "line: equal shares."
    )
    return Figure(caption, panels)


def mean_losses(found: Specialisations, baselines: BaselineLosses, words: Words = OF_STATES) -> Figure:
    """Draw each member's mean loss on all samples and on its own, beside that of single networks (Fig. 9)."""
    singles = {name: _by_model(getattr(baselines, name)) for name in SPLITS}
    rows = 1 + len(found.test.addressed) + max(map(len, singles.values()))
    lowest, highest = _reach(
        loss
        for name, each in splits(found)
        for loss in (*each.mean_loss.all, *each.mean_loss.own, *(x for group in singles[name].values() for x in group))
    )

    def draw(axes: Axes, found: Specialisation, split: str) -> None:
        _draw_mean_losses(axes, found, singles[split])
        axes.set(xlim=(lowest, highest), title=f"{words.title(split)} ({found.samples:,})")
        logarithmic(axes, "x")

    panels = tuple(
        panel(
            f"specialisation-mean-loss-{name}",
            f"Mean loss of each network on all points and on its own, {words.title(name)}",
            partial(draw, found=each, split=name),
            size=(4.6, 1.1 + 0.23 * rows),
        )
        for name, each in splits(found)
    )
    beside = "; below, single networks, each trained as long" if any(singles.values()) else ""
    caption = (
        f"Mean loss of what the networks predict, of {words.scaled} (Fig. 9 of the paper): of each network on "
        f"all points (ring) and on those for which it is selected (dot){beside}. {_own_against_all(found.test)}"
        f"{_best_single(found.test, singles['test'])}"
    )
    return Figure(caption, panels)


def both_splits(
    found: Specialisations,
    name: str,
    what: str,
    draw: Callable[..., None],
    *,
    height: float = 3.0,
    words: Words = OF_STATES,
) -> tuple[Panel, ...]:
    """Draw one picture for each split."""
    return tuple(
        picture(
            f"specialisation-{name}-{split}",
            f"{what}, {words.title(split)}",
            partial(draw, found=each, title=words.title(split)),
            size=(4.6, height),
        )
        for split, each in splits(found)
    )


def splits(found: Specialisations) -> tuple[tuple[str, Specialisation], ...]:
    """Return what was found on each split by its name."""
    return (("train", found.train), ("test", found.test))


def _draw_samples(canvas: Canvas, found: Specialisation, title: str) -> None:
    axes = canvas.subplots()
    members = range(len(found.addressed))
    for offset, counts, strength in ((-0.2, found.lowest_loss, 0.4), (0.2, found.addressed, 1.0)):
        shares = [100 * count / found.samples for count in counts]
        axes.bar([k + offset for k in members], shares, 0.38, color=[member_colour(k) for k in members], alpha=strength)
    axes.axhline(100 / len(members), color=FAINT, linewidth=0.8)
    patches = [Patch(color=INK, alpha=strength) for strength in (0.4, 1.0)]
    axes.legend(
        patches, ["lowest loss", "selected"], loc="lower right", ncols=2, bbox_to_anchor=(1, 1), borderaxespad=0.2
    )
    axes.set_xticks(members, [str(k + 1) for k in members])
    axes.set(xlabel="network", ylabel="share of the points (%)", title=title)
    axes.tick_params(axis="x", length=0)
    axes.grid(visible=False, axis="x")
    axes.set_axisbelow(True)


def _draw_mean_losses(axes: Axes, found: Specialisation, singles: Mapping[str, list[float]]) -> None:
    titles = []
    for k, (everywhere, own) in enumerate(zip(found.mean_loss.all, found.mean_loss.own, strict=True)):
        colour = member_colour(k)
        ends = positive(np.array([everywhere if own is None else own, everywhere]))
        axes.plot(ends, [k, k], color=colour, linewidth=1.2, alpha=0.5)
        axes.plot(ends[1], k, marker="o", markersize=5.5, markerfacecolor="white", color=colour)
        if own is not None:
            axes.plot(ends[0], k, marker="o", markersize=5.5, color=colour)
        titles.append(f"network {k + 1}")
    place = len(titles)
    axes.plot(positive(np.array(_addressed_mean(found))), place, marker="o", markersize=6.5, color=OWN)
    titles.append("addressed ensemble")
    for name, losses in singles.items():
        place += 1
        title, colour = model_style(name, singles)
        axes.plot(positive(np.array(losses)), [place] * len(losses), linestyle="", marker="o", color=colour, ms=5.5)
        titles.append(title)
    axes.axhline(len(found.addressed) - 0.5, color=FAINT, linewidth=0.7)
    axes.set(xlabel="mean loss")
    axes.set_yticks(range(len(titles)), titles)
    axes.set_ylim(len(titles) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.grid(visible=False, axis="y")


def _by_model(losses: Mapping[str, float]) -> dict[str, list[float]]:
    """Gather the seeds of each model."""
    grouped: dict[str, list[float]] = {}
    for name, loss in losses.items():
        grouped.setdefault(name.partition("/seed-")[0], []).append(loss)
    return grouped


def _addressed_mean(found: Specialisation) -> float:
    """Return the mean loss with the member that is selected for each sample."""
    parts = zip(found.mean_loss.own, found.addressed, strict=True)
    return sum(own * count for own, count in parts if own is not None) / found.samples


def _reach(losses: Iterable[float | None]) -> tuple[float, float]:
    shown = positive(np.array([loss for loss in losses if loss is not None]))
    return float(shown.min() / 2), float(shown.max() * 2)


def _own_against_all(found: Specialisation) -> str:
    pairs = zip(found.mean_loss.all, found.mean_loss.own, strict=True)
    ratios = [everywhere / own for everywhere, own in pairs if own]
    if not ratios:
        return "No network has an error on points of its own."
    low, high = (scientific(each(ratios)) for each in (min, max))
    extent = f"{low} times" if low == high else f"{low} to {high} times"
    return f"On the held-out points the mean loss of a network on all of them is {extent} that on its own."


def _best_single(found: Specialisation, singles: Mapping[str, list[float]]) -> str:
    if not singles:
        return ""
    middle = {name: median(losses) for name, losses in singles.items()}
    name = min(middle, key=lambda each: middle[each])
    ours = _addressed_mean(found)
    seeds = f", the median of {len(singles[name])} seeds" if len(singles[name]) > 1 else ""
    return (
        f" The addressed ensemble has {scientific(ours)} there; the lowest of the single networks, "
        f"{model_style(name)[0]}, {scientific(middle[name])}{seeds}."
    )
