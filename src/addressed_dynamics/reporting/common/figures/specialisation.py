"""How the members share the samples, on what they have learned from and on held-out episodes (Figs. 8 and 9)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median

from addressed_dynamics.evaluation.common.records import BaselineLosses, Specialisation, Specialisations
from addressed_dynamics.reporting.common.blocks import Chart, Line, View
from addressed_dynamics.reporting.common.charts import numbers
from addressed_dynamics.reporting.common.figures.style import ERROR_FLOOR, OWN, member_colour, model_style
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
    paper: bool = False
    """Whether the experiment is the paper's, so that its figures are cited."""

    def title(self, split: str) -> str:
        """Return the title of a split."""
        return {"train": "training points", "test": self.held_out}[split]

    def cited(self, figure: int) -> str:
        """Return where in the paper there is such a figure, in brackets; nothing for experiments that are not its."""
        return f" (Fig. {figure} of the paper)" if self.paper else ""


OF_STATES = Words()
"""Words for the states of environments."""
OF_ANY = Words("held-out data", "what the networks predict, as it is given to them", "validation data")
"""Words for any kind of data."""


def samples_by_member(found: Specialisations, agreement: float | None, words: Words = OF_STATES) -> Chart:
    """Return how many samples each member serves best and is selected for (Fig. 8).

    Args:
        found: the shares of the members.
        agreement: what the paper reports of it on its training points; None if nothing.
        words: what samples and losses are called.
    """
    views = []
    for name, each in splits(found):
        lines = []
        for k, counts in enumerate(zip(each.addressed, each.lowest_loss, strict=True)):
            selected, lowest = (100 * count / each.samples for count in counts)
            low, high = (numbers([reduce(selected, lowest)]) for reduce in (min, max))
            lines.append(Line(f"network {k + 1}", member_colour(k), numbers([selected]), low, high))
        views.append(View((words.title(name),), "share of the points, %", (), tuple(lines), logarithmic=False))
    reported = "" if agreement is None else f" (the paper, on its training points: {percent(agreement)})"
    least = {name: min(each.addressed) / each.samples for name, each in splits(found)}
    most = {name: max(each.addressed) / each.samples for name, each in splits(found)}
    caption = (
        f"Points per network{words.cited(8)}, of {found.train.samples:,} training points and "
        f"{found.test.samples:,} of {words.held_out}: dots, those for which the addressing network selects it; the "
        "other end of a bar, those on which it has the lowest loss. The two choices agree on "
        f"{percent(found.train.agreement)} of the training points and {percent(found.test.agreement)} of the held-out "
        f"ones{reported}. The networks are selected for {percent(least['train'])} to {percent(most['train'])} of the "
        f"training points each, and for {percent(least['test'])} to {percent(most['test'])} of the held-out ones."
    )
    alternative = "Share of the points on which each network is selected and has the lowest loss"
    return Chart("specialisation-samples", caption, alternative, "", tuple(views), ("Points",), form="ranges")


def mean_losses(found: Specialisations, baselines: BaselineLosses, words: Words = OF_STATES) -> Chart:
    """Return each member's mean loss on all samples and on its own, beside that of single networks (Fig. 9)."""
    singles = {name: _by_model(getattr(baselines, name)) for name in SPLITS}
    views = tuple(
        View((words.title(name),), "mean loss", (), _loss_lines(each, singles[name])) for name, each in splits(found)
    )
    beside = "; below, single networks, each trained as long" if any(singles.values()) else ""
    caption = (
        f"Mean loss of what the networks predict, of {words.scaled}{words.cited(9)}: of each network on those points "
        f"for which it is selected (dot) and on all of them (the other end of its bar){beside}. "
        f"{_own_against_all(found.test)}{_best_single(found.test, singles['test'])}"
    )
    alternative = "Mean loss of each network on all points and on its own"
    return Chart("specialisation-mean-loss", caption, alternative, "", views, ("Points",), form="ranges")


def _loss_lines(found: Specialisation, singles: Mapping[str, list[float]]) -> tuple[Line, ...]:
    lines = []
    for k, (everywhere, own) in enumerate(zip(found.mean_loss.all, found.mean_loss.own, strict=True)):
        ends = sorted(max(loss, ERROR_FLOOR) for loss in (everywhere, everywhere if own is None else own))
        dot = () if own is None else numbers([max(own, ERROR_FLOOR)])
        lines.append(Line(f"network {k + 1}", member_colour(k), dot, numbers(ends[:1]), numbers(ends[1:])))
    lines.append(Line("addressed ensemble", OWN, numbers([max(_addressed_mean(found), ERROR_FLOOR)])))
    for name, losses in singles.items():
        title, colour = model_style(name, singles)
        lines.append(Line(title, colour, numbers([max(loss, ERROR_FLOOR) for loss in losses])))
    return tuple(lines)


def splits(found: Specialisations) -> tuple[tuple[str, Specialisation], ...]:
    """Return what was found on each split by its name."""
    return (("train", found.train), ("test", found.test))


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
