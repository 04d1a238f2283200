"""Which network serves which part of the gait cycle."""

from __future__ import annotations

import numpy as np

from addressed_dynamics.evaluation.motion.records import Addressing, PhaseUse
from addressed_dynamics.reporting.common.blocks import Chart, Line, View
from addressed_dynamics.reporting.common.charts import MOST_SHOWN, numbers
from addressed_dynamics.reporting.common.figures.style import member_colour
from addressed_dynamics.reporting.common.numbers import percent

TITLES = {"train": "training frames", "test": "held-out clips"}
"""What each split is called."""


def phase_shares(found: Addressing, *, paper: bool) -> Chart:
    """Return the share of each network around the gait cycle, for every gait."""
    views = tuple(
        View((TITLES[name], use.gait), "share of the frames, %", *_shares(use), logarithmic=False)
        for name, split in (("train", found.train), ("test", found.test))
        for use in split.gaits
    )
    above = found.test.all.information_share > found.test.all.chance_share_p95
    holds = "holds" if above else "does not hold"
    claim = f"The paper's claim, that addressing finds the phase by itself, {holds} on these data." * paper
    caption = (
        "Which network is selected over the phase of the gait cycle (0: right foot strikes), without any network being "
        "given the phase. Lines that change with the phase say that the networks have divided the gait cycle among "
        "them; level ones, that they have not. Over all gaits the phase explains "
        f"{percent(found.train.all.information_share)} of the choice on training frames, where chance gives "
        f"{percent(found.train.all.chance_share)}, and {percent(found.test.all.information_share)} on held-out clips, "
        f"where chance gives {percent(found.test.all.chance_share)} and in one case of 20 more than "
        f"{percent(found.test.all.chance_share_p95)}. {claim}"
    )
    alternative = "Share of each network over the phase of the gait cycle, for every gait"
    label = "phase of the gait cycle, 0 to 1"
    return Chart("phase", caption, alternative, label, views, ("Frames", "Gait"))


def _shares(use: PhaseUse) -> tuple[tuple[float, ...], tuple[Line, ...]]:
    """Return the middles of the intervals of the phase, and the share of each network in them."""
    counts = np.array(use.counts, np.float64)
    total = counts.sum(axis=0)
    shares = np.divide(100 * counts, total, out=np.full_like(counts, np.nan), where=total > 0)
    middles = (np.arange(counts.shape[1]) + 0.5) / counts.shape[1]
    lines = tuple(
        Line(f"network {k + 1}", member_colour(k), numbers(row.tolist()), shown=k < MOST_SHOWN)
        for k, row in enumerate(shares)
    )
    return tuple(middles.tolist()), lines
