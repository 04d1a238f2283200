"""What changed over time: the recording agent's return, and the training of the ensemble and of its addressing."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from addressed_dynamics.reporting.common.blocks import Figure, Panel
from addressed_dynamics.reporting.common.figures.specialisation import OF_STATES, Words
from addressed_dynamics.reporting.common.figures.style import (
    FAINT,
    INK,
    OWN,
    logarithmic,
    member_colour,
    member_legend,
    panel,
    positive,
)
from addressed_dynamics.reporting.common.numbers import listed
from addressed_dynamics.reporting.common.reading import Columns

WINDOW = 50
"""Episodes over which a return is averaged."""
VARIANTS = {"plain": ("plain", FAINT), "cost_sensitive": ("cost-sensitive", OWN)}
"""Title and colour of each addressing network."""


def learner_returns(learner: Mapping[str, Columns], segments: list[str]) -> Figure | None:
    """Draw the return of every episode of the segments in which the agent learned; None without any."""
    shown = [name for name in segments if name in learner]

    def returns(axes: Axes, values: Float[np.ndarray, " episode"]) -> None:
        episodes = np.arange(1, len(values) + 1)
        axes.plot(episodes, values, linestyle="", marker="o", markersize=2, color="#b5b5b5", markeredgewidth=0)
        axes.plot(episodes, _trailing_mean(values), color=INK)
        axes.set(xlabel="finished episode", ylabel="return")

    def ends(axes: Axes, terminated: Float[np.ndarray, " episode"]) -> None:
        axes.plot(np.arange(1, len(terminated) + 1), 100 * _trailing_mean(terminated), color=INK)
        axes.set(xlabel="finished episode", ylabel="ended inside the task (%)", ylim=(-2, 102))

    panels: list[Panel] = []
    for name in shown:
        values, terminated = learner[name]["return"], learner[name]["terminated"]
        title = f"of the episodes of segment {name}"
        panels += [
            panel(f"learner-return-{name}", f"Return {title}", partial(returns, values=values), size=(4.6, 2.8)),
            panel(f"learner-ends-{name}", f"Ends {title}", partial(ends, terminated=terminated), size=(4.6, 2.8)),
        ]
    caption = (
        f"The recorded agent learns (segment {', '.join(shown)}). Left: return of each finished episode (dots) and "
        f"mean of the last {WINDOW} (line). Right: share of the last {WINDOW} episodes that ended inside the task."
    )
    return Figure(caption, tuple(panels)) if panels else None


def _trailing_mean(values: Float[np.ndarray, " episode"]) -> Float[np.ndarray, " episode"]:
    """Return the mean of the last `WINDOW` values, or of as many as there are."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    stop = np.arange(1, len(values) + 1)
    start = np.maximum(stop - WINDOW, 0)
    mean: Float[np.ndarray, " episode"] = (total[stop] - total[start]) / (stop - start)
    return mean


def ensemble_training(curves: Mapping[str, Columns], words: Words = OF_STATES) -> Figure:
    """Draw losses, specialisation and changes of bins over the epochs of phase 1; the first seed stands out."""
    first, *others = curves
    own = curves[first]
    members = sum(name.startswith("loss_member/") for name in own)

    def losses(axes: Axes) -> None:
        for name in others:
            axes.plot(curves[name]["epoch"], positive(curves[name]["loss/validation"]), color="#c4c4c4", linewidth=1)
        axes.plot(own["epoch"], positive(own["loss/validation"]), color=INK)
        axes.set(xlabel="epoch", title="validation loss, best network")
        logarithmic(axes, "y")

    def training(axes: Axes) -> None:
        for member in range(members):
            axes.plot(own["epoch"], positive(own[f"loss_member/{member}"]), color=member_colour(member))
        axes.set(xlabel="epoch", title="training loss, own bin")
        logarithmic(axes, "y")
        member_legend(axes, list(range(members)), loc="upper right")

    def specialisation(axes: Axes) -> None:
        for member in range(members):
            colour = member_colour(member)
            for column, style in ((f"selected/{member}", "-"), (f"not_selected/{member}", ":")):
                if column in own:
                    axes.plot(own["epoch"], positive(own[column]), color=colour, linestyle=style)
        axes.plot([], [], color=FAINT, label="best here")
        axes.plot([], [], color=FAINT, linestyle=":", label="not best")
        axes.set(xlabel="epoch", title="validation loss, by network")
        logarithmic(axes, "y")
        axes.legend(loc="center right")

    def changes(axes: Axes) -> None:
        for name in (*others, first):
            style = {"color": INK} if name == first else {"color": "#c4c4c4", "linewidth": 1.0}
            axes.plot(curves[name]["epoch"], 100 * curves[name]["bins/changed"], **style)
        axes.set(xlabel="epoch", title="samples that changed bin (%)", ylim=(0, None))

    drawings = {"training": training, "validation": losses, "specialisation": specialisation, "bins": changes}
    panels = tuple(
        panel(f"ensemble-{name}", f"Phase 1 over the epochs: {name}", draw, size=(4.6, 2.8))
        for name, draw in drawings.items()
    )
    caption = (
        "Phase 1, epoch by epoch (the report's seed; others in light grey). Training: mean loss of each network on its "
        "own bin. Validation: under each sample's best network; then each network apart, on the samples for which it "
        f"is the best (solid) and on the others (dotted). All losses are of {words.scaled}. Last: share of training "
        "samples whose bin is another than in the epoch before."
    )
    return Figure(caption, panels)


def addressing_training(curves: Mapping[str, Columns], seed: str, validation: str) -> Figure | None:
    """Draw agreement and regret of one seed's addressing networks over the epochs of phase 2; None without any."""
    shown = {name.partition("/")[2]: columns for name, columns in curves.items() if name.startswith(f"seed-{seed}/")}
    if not shown:
        return None

    def draw(axes: Axes, column: str, title: str, factor: float, scale: str) -> None:
        for variant, columns in shown.items():
            name, colour = VARIANTS.get(variant, (variant, INK))
            values = factor * columns[column]
            axes.plot(columns["epoch"], positive(values) if scale == "log" else values, color=colour, label=name)
        axes.set(xlabel="epoch", title=title)
        if scale == "log":
            logarithmic(axes, "y")
        axes.legend(loc="best")

    wanted = {
        "agreement": ("agreement", "best network selected (%)", 100.0, "linear"),
        "regret": ("regret/mean", "mean regret", 1.0, "log"),
        "worst": ("regret/max", "largest regret", 1.0, "log"),
    }
    panels = tuple(
        panel(
            f"addressing-{name}",
            f"Phase 2 over the epochs: {title}",
            partial(draw, column=column, title=title, factor=factor, scale=scale),
            size=(3.1, 2.5),
        )
        for name, (column, title, factor, scale) in wanted.items()
    )
    kinds = {
        "plain": "the paper's plain cross-entropy",
        "cost_sensitive": "the one weighted by what a wrong choice costs",
    }
    trained = listed([f"for {title}" for name, title in kinds.items() if name in shown])
    caption = (
        f"Phase 2, epoch by epoch, on {validation}: how often the addressing network selects the best network, "
        f"and its regret (loss of the selected network minus loss of the best), {trained}."
    )
    return Figure(caption, panels)
