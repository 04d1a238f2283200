"""How losses and addressing outputs are spread for each member (Figs. 10 and 11 of the paper)."""

from __future__ import annotations

import numpy as np

from addressed_dynamics.evaluation.common.records import Specialisation, Specialisations
from addressed_dynamics.reporting.common.blocks import Chart, Line, View
from addressed_dynamics.reporting.common.charts import MOST_SHOWN, numbers
from addressed_dynamics.reporting.common.figures.specialisation import OF_STATES, Words, splits
from addressed_dynamics.reporting.common.figures.style import member_colour
from addressed_dynamics.reporting.common.numbers import percent, scientific

SURE = 0.95
"""From this output on the addressing network counts as sure of a network."""


def loss_histograms(found: Specialisations, words: Words = OF_STATES) -> Chart:
    """Return how the losses of each member on its own samples are spread (Fig. 10)."""
    views = []
    for name, each in splits(found):
        edges = np.array(each.loss_edges)
        shares = [
            100 * np.array(counts) / max(own, 1) for counts, own in zip(each.loss_counts, each.addressed, strict=True)
        ]
        lines = tuple(_line(k, share.tolist()) for k, share in enumerate(shares))
        middles = tuple(np.sqrt(edges[:-1] * edges[1:]).tolist())
        views.append(
            View((words.title(name),), "share of the network's own points, %", middles, lines, logarithmic=False)
        )
    caption = (
        f"Losses of each network on the points for which it is selected{words.cited(10)}, in ten intervals of "
        "equal width on the logarithmic axis, each at its middle; the first also holds smaller losses. "
        f"{_spread(found, words)}"
    )
    alternative = "Shares of the losses of each network on its own points, by interval"
    return Chart("specialisation-losses", caption, alternative, "loss", tuple(views), ("Points",), logarithmic=True)


def output_histograms(found: Specialisations, words: Words = OF_STATES) -> Chart:
    """Return how the addressing network's outputs are spread for each member (Fig. 11)."""
    views = []
    for name, each in splits(found):
        edges = np.array(each.output_edges)
        lines = tuple(_line(k, list(counts)) for k, counts in enumerate(each.output_counts))
        views.append(View((words.title(name),), "points", tuple(((edges[:-1] + edges[1:]) / 2).tolist()), lines))
    sure = {name: _share_sure(each) for name, each in splits(found)}
    caption = (
        f"Outputs of the addressing network after the softmax{words.cited(11)}: for each network the number of "
        "points, logarithmic, by the output that they give it. Outputs near 0 and 1 are sure choices, those between "
        f"them doubtful ones. One network has an output of at least {SURE:g} on {percent(sure['train'])} of the "
        f"training points and {percent(sure['test'])} of the held-out ones."
    )
    alternative = "Number of points by the output of the addressing network, for each network"
    return Chart("specialisation-outputs", caption, alternative, "output for the network", tuple(views), ("Points",))


def _line(member: int, values: list[float]) -> Line:
    return Line(f"network {member + 1}", member_colour(member), numbers(values), shown=member < MOST_SHOWN)


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
