"""What changes over time: the recording agent's return, and the training of the ensemble and of its addressing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from addressed_dynamics.reporting.common.blocks import Chart, Line, View
from addressed_dynamics.reporting.common.charts import MOST_SHOWN, numbers
from addressed_dynamics.reporting.common.figures.specialisation import OF_STATES, Words
from addressed_dynamics.reporting.common.figures.style import FAINT, OWN, TRUTH, member_colour, thinned
from addressed_dynamics.reporting.common.numbers import listed
from addressed_dynamics.reporting.common.reading import Columns

WINDOW = 50
"""Episodes over which a return is averaged."""
MOST_EPISODES = 400
"""Episodes that a chart keeps."""
VARIANTS = {"plain": ("plain", FAINT), "cost_sensitive": ("cost-sensitive", OWN)}
"""Title and colour of each addressing network."""


def learner_returns(learner: Mapping[str, Columns], segments: list[str]) -> Chart | None:
    """Return the return of every episode of the segments in which the agent learned; None without any."""
    shown = [name for name in segments if name in learner and len(learner[name]["return"])]
    if not shown:
        return None
    views = []
    for name in shown:
        returns, ended = learner[name]["return"], 100 * _trailing_mean(learner[name]["terminated"])
        kept = thinned(len(returns), MOST_EPISODES)
        places = tuple((kept + 1).tolist())
        mean = Line(f"mean of the last {WINDOW}", OWN, numbers(_trailing_mean(returns)[kept].tolist()))
        each = Line("an episode", TRUTH, numbers(returns[kept].tolist()), style="points")
        share = Line(f"share of the last {WINDOW}", OWN, numbers(ended[kept].tolist()))
        views += [
            View((name, "return"), "return", places, (mean, each), logarithmic=False),
            View((name, "ends"), "ended inside the task, %", places, (share,), logarithmic=False),
        ]
    caption = (
        f"The recorded agent learns (segment {', '.join(shown)}): return of the finished episodes, at most "
        f"{MOST_EPISODES} of them, and mean of the last {WINDOW}; share of these that ended inside the task."
    )
    return Chart(
        "learner", caption, "Return and ends of the agent's episodes", "finished episode", tuple(views),
        ("Segment", "Show"),
    )  # fmt: skip


def _trailing_mean(values: Float[np.ndarray, " episode"]) -> Float[np.ndarray, " episode"]:
    """Return the mean of the last `WINDOW` values, or of as many as there are."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    stop = np.arange(1, len(values) + 1)
    start = np.maximum(stop - WINDOW, 0)
    mean: Float[np.ndarray, " episode"] = (total[stop] - total[start]) / (stop - start)
    return mean


def ensemble_training(curves: Mapping[str, Columns], words: Words = OF_STATES) -> Chart:
    """Return losses, specialisation and changes of bins over the epochs of phase 1; the first seed comes first."""
    first, *others = curves
    own = curves[first]
    members = sum(name.startswith("loss_member/") for name in own)

    def of_seeds(column: str, factor: float = 1.0) -> list[Line]:
        return [
            Line(name, OWN if name == first else FAINT, numbers((factor * curves[name][column]).tolist()))
            for name in (first, *others)
        ]

    def of_members(prefix: str, title: str) -> list[Line]:
        return [
            Line(f"network {k + 1}{title}", member_colour(k), numbers(own[f"{prefix}/{k}"].tolist()),
                 style="dashed" if prefix == "not_selected" else "line")
            for k in range(members)
            if f"{prefix}/{k}" in own
        ]  # fmt: skip

    apart = [*of_members("selected", ", best here"), *of_members("not_selected", ", not best")]
    views = (
        _view("validation", "validation loss, best network", own, of_seeds("loss/validation")),
        _view("training", "training loss, own bin", own, of_members("loss_member", "")),
        _view("specialisation", "validation loss, by network", own, apart),
        _view("bins", "samples that changed bin, %", own, of_seeds("bins/changed", 100.0), logarithmic=False),
    )
    caption = (
        "Phase 1, epoch by epoch (the report's seed; others in grey). Validation: under each sample's best network. "
        "Training: mean loss of each network on its own bin. Specialisation: each network apart, on the samples for "
        f"which it is the best (solid) and on the others (dashed). All losses are of {words.scaled}. Bins: share of "
        "training samples whose bin is another than in the epoch before."
    )
    shown = tuple(view for view in views if view.lines)
    return Chart("ensemble-training", caption, "Phase 1 over the epochs", "epoch", shown, ("Show",))


def _view(choice: str, label: str, columns: Columns, lines: Sequence[Line], *, logarithmic: bool = True) -> View:
    """Return a view of curves over the epochs; seeds that were trained for fewer of them end earlier."""
    epochs = tuple(columns["epoch"].tolist())
    drawn = tuple(
        Line(line.name, line.colour, (*line.values, *[None] * len(epochs))[: len(epochs)], style=line.style,
             shown=index < MOST_SHOWN)
        for index, line in enumerate(lines)
    )  # fmt: skip
    return View((choice,), label, epochs, drawn, logarithmic=logarithmic)


def addressing_training(curves: Mapping[str, Columns], seed: str, validation: str) -> Chart | None:
    """Return agreement and regret of one seed's addressing networks over the epochs of phase 2; None without any."""
    shown = {name.partition("/")[2]: columns for name, columns in curves.items() if name.startswith(f"seed-{seed}/")}
    if not shown:
        return None
    longest = max(shown.values(), key=lambda columns: len(columns["epoch"]))
    wanted = {
        "agreement": ("agreement", "best network selected, %", 100.0),
        "regret": ("regret/mean", "mean regret", 1.0),
        "largest regret": ("regret/max", "largest regret", 1.0),
    }
    views = tuple(
        _view(
            choice,
            label,
            longest,
            [Line(*VARIANTS.get(name, (name, FAINT)), numbers((factor * columns[column]).tolist()))
             for name, columns in shown.items()],
            logarithmic=choice != "agreement",
        )
        for choice, (column, label, factor) in wanted.items()
    )  # fmt: skip
    kinds = {
        "plain": "plain cross-entropy",
        "cost_sensitive": "the one weighted by what a wrong choice costs",
    }
    trained = listed([f"for {title}" for name, title in kinds.items() if name in shown])
    caption = (
        f"Phase 2, epoch by epoch, on {validation}: how often the addressing network selects the best network, "
        f"and its regret (loss of the selected network minus loss of the best), {trained}."
    )
    return Chart("addressing-training", caption, "Phase 2 over the epochs", "epoch", views, ("Show",))
