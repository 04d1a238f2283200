"""Which network serves which part of the gait cycle."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from addressed_dynamics.evaluation.motion.records import Addressing, PhaseUse, SplitAddressing
from addressed_dynamics.reporting.common.blocks import Figure
from addressed_dynamics.reporting.common.figures.style import member_colour, member_legend, picture
from addressed_dynamics.reporting.common.numbers import percent

TITLES = {"train": "training frames", "test": "held-out clips"}
"""The splits, one below the other."""


def phase_shares(found: Addressing) -> Figure:
    """Draw the share of each network around the gait cycle, for every gait."""
    columns = max(len(found.train.gaits), len(found.test.gaits))

    def draw(canvas: Canvas, split: SplitAddressing, title: str) -> None:
        grid = np.atleast_1d(canvas.subplots(1, columns, sharey=True))
        for axes, use in zip(grid, split.gaits, strict=False):
            _draw_shares(axes, use)
            axes.set_title(f"{title}: {use.gait} ({use.rows:,} frames)", fontsize=8.5)
        for axes in grid[len(split.gaits) :]:
            axes.set_axis_off()
        grid[0].set_ylabel("share of the frames (%)")
        member_legend(canvas, list(range(found.members)), loc="outside lower center", ncols=found.members)

    splits = {"train": found.train, "test": found.test}
    panels = tuple(
        picture(
            f"phase-{name}",
            f"Share of each network over the phase of the gait cycle, for every gait, {TITLES[name]}",
            partial(draw, split=split, title=TITLES[name]),
            size=(9.4, 2.7),
        )
        for name, split in splits.items()
    )
    above = found.test.all.information_share > found.test.all.chance_share_p95
    caption = (
        "Which network is selected over the phase of the gait cycle (0: right foot strikes), without any network being "
        "given the phase. Bands that change with the phase say that the networks have divided the gait cycle among "
        "them; level bands, that they have not; white, that there are no frames. Over all gaits the phase explains "
        f"{percent(found.train.all.information_share)} of the choice on training frames, where chance gives "
        f"{percent(found.train.all.chance_share)}, and {percent(found.test.all.information_share)} on held-out clips, "
        f"where chance gives {percent(found.test.all.chance_share)} and in one case of 20 more than "
        f"{percent(found.test.all.chance_share_p95)}. The paper's claim, that addressing finds the phase by itself, "
        f"{'holds' if above else 'does not hold'} on these data."
    )
    return Figure(caption, panels)


def _draw_shares(axes: Axes, use: PhaseUse) -> None:
    counts = np.array(use.counts, np.float64)
    total = counts.sum(axis=0)
    edges = np.linspace(0.0, 1.0, counts.shape[1] + 1)
    base = np.zeros(counts.shape[1])
    for member, row in enumerate(counts):
        height = 100 * row / np.maximum(total, 1)
        axes.bar(edges[:-1], height, np.diff(edges), bottom=base, align="edge", color=member_colour(member), lw=0)
        base += height
    axes.set(xlim=(0, 1), ylim=(0, 100), xlabel="phase")
    axes.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "¼", "½", "¾", "1"])
    axes.grid(visible=False)
