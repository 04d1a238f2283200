"""How losses and addressing outputs are spread for each member (Figs. 10 and 11 of the paper)."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure as Canvas

from addressed_dynamics.evaluation.common.records import Specialisation, Specialisations
from addressed_dynamics.reporting.common.blocks import Figure
from addressed_dynamics.reporting.common.figures.specialisation import OF_STATES, Words, both_splits, splits
from addressed_dynamics.reporting.common.figures.style import logarithmic, member_colour
from addressed_dynamics.reporting.common.numbers import percent, scientific

SURE = 0.95
"""From this output on the addressing network counts as sure of a network."""


def loss_histograms(found: Specialisations, words: Words = OF_STATES) -> Figure:
    """Draw how the losses of each member on its own samples are spread (Fig. 10)."""
    tall = 0.8 + max(0.36 * len(found.test.addressed), 1.4)
    what = "Histogram of the losses of each network on its own points"
    reach = [reduce(each.loss_edges[place] for _, each in splits(found)) for place, reduce in ((0, min), (-1, max))]
    panels = both_splits(found, "losses", what, partial(_draw_losses, reach=reach), height=tall, words=words)
    caption = (
        "Losses of each network on the points for which it is selected (Fig. 10 of the paper), in ten intervals of "
        "equal width on the logarithmic axis; heights are shares of the network's own points, on one scale in each "
        f"picture. The first interval also holds smaller losses. {_spread(found, words)}"
    )
    return Figure(caption, panels)


def output_histograms(found: Specialisations, words: Words = OF_STATES) -> Figure:
    """Draw how the addressing network's outputs are spread for each member (Fig. 11)."""
    columns = _columns(len(found.test.addressed))
    rows = -(-len(found.test.addressed) // columns)
    what = "Histogram of the outputs of the addressing network for each network"
    panels = both_splits(found, "outputs", what, _draw_outputs, height=1.1 + 1.25 * rows, words=words)
    sure = {name: _share_sure(each) for name, each in splits(found)}
    caption = (
        "Outputs of the addressing network after the softmax (Fig. 11 of the paper): for each network the number of "
        "points, logarithmic, by the output that they give it. Outputs near 0 and 1 are sure choices, those between "
        f"them doubtful ones. One network has an output of at least {SURE:g} on {percent(sure['train'])} of the "
        f"training points and {percent(sure['test'])} of the held-out ones."
    )
    return Figure(caption, panels)


def _draw_losses(canvas: Canvas, found: Specialisation, title: str, reach: list[float]) -> None:
    strips = np.atleast_1d(canvas.subplots(len(found.addressed), 1, sharex=True, sharey=True))
    edges = np.array(found.loss_edges)
    for k, (axes, counts, own) in enumerate(zip(strips, found.loss_counts, found.addressed, strict=True)):
        heights = np.array(counts) / max(own, 1)
        axes.bar(edges[:-1], heights, np.diff(edges), align="edge", color=member_colour(k), edgecolor="white", lw=0.5)
        axes.set(xlim=reach, yticks=[])
        axes.set_axisbelow(True)
        axes.set_ylabel(f"network {k + 1}", rotation=0, ha="right", va="center", fontsize=8)
        axes.spines["left"].set_visible(False)
        logarithmic(axes, "x")
    strips[0].set_title(title)
    strips[-1].set_xlabel("loss")


def _draw_outputs(canvas: Canvas, found: Specialisation, title: str) -> None:
    columns = _columns(len(found.addressed))
    rows = -(-len(found.addressed) // columns)
    grid = np.atleast_1d(canvas.subplots(rows, columns, sharex=True, sharey=True)).ravel()
    edges = np.array(found.output_edges)
    for k, (axes, counts) in enumerate(zip(grid, found.output_counts, strict=False)):
        axes.bar(edges[:-1], counts, np.diff(edges), align="edge", color=member_colour(k))
        axes.set_title(f"network {k + 1}", fontsize=8)
        axes.set_axisbelow(True)
        axes.set(xlim=(0, 1), ylim=(0.7, 2 * found.samples), yscale="log")
        axes.set_xticks([0, 0.5, 1], ["0", "0.5", "1"])
        logarithmic(axes, "y")
    for axes in grid[len(found.addressed) :]:
        axes.set_axis_off()
    canvas.suptitle(title, x=0.01, ha="left", fontsize=9.5)
    canvas.supxlabel("output for the network", fontsize=9)
    canvas.supylabel("points", fontsize=9)


def _columns(members: int) -> int:
    return members if members < 4 else 2 if members == 4 else 4


def _spread(found: Specialisations, words: Words) -> str:
    """Say where most of the held-out losses lie."""
    edges, counts = found.test.loss_edges, np.array(found.test.loss_counts).sum(axis=0)
    place = int(counts.argmax())
    share = percent(float(counts[place] / found.test.samples), 0)
    return (
        f"On {words.held_out} the fullest interval, {scientific(edges[place])} to {scientific(edges[place + 1])}, "
        f"holds {share} of the points."
    )


def _share_sure(found: Specialisation) -> float:
    edges = np.array(found.output_edges[:-1])
    sure = np.array(found.output_counts)[:, edges > SURE - 1e-9].sum()
    return min(float(sure / found.samples), 1.0)
