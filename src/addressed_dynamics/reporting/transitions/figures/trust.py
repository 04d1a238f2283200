"""What trust is worth, and where it is high and low."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from addressed_dynamics.episodes.transitions import Dimension
from addressed_dynamics.evaluation.transitions.trust_records import RiskRecord
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.reporting.common.blocks import Chart, Figure, Line, View
from addressed_dynamics.reporting.common.charts import numbers
from addressed_dynamics.reporting.common.figures.style import OWN, REACHED, panel, with_unit
from addressed_dynamics.reporting.transitions.results import Arrays


def risk_curve(risk: tuple[RiskRecord, ...]) -> Chart | None:
    """Return the mean error of the predictions that are trusted most; None if there are none, or none has an error."""
    if not risk or risk[-1].risk <= 0:
        return None
    of_all = risk[-1].risk
    lines = (
        Line("by trust", OWN, numbers([100 * each.risk / of_all for each in risk])),
        Line("best order", REACHED, numbers([100 * each.oracle / of_all for each in risk]), style="dashed"),
    )
    kept = tuple(100 * each.coverage for each in risk)
    caption = (
        "What trust is worth: the mean error of the predictions that are trusted most, against how many of them are "
        "kept. The further the solid line is below the thin one, a random order, the more it helps to leave out what "
        "is not trusted; no trust can do better than the dashed line, which knows the errors."
    )
    alternative = "Mean error of the predictions that are kept, against the share that is kept, by trust and at best"
    view = View((), "mean error, % of that of all", kept, lines, logarithmic=False, level=100.0)
    return Chart("trust-risk", caption, alternative, "predictions kept, %", (view,))


def trust_map(arrays: Arrays, features: FeatureSpec) -> Figure | None:
    """Draw the mean trust over two dimensions of the state; None without a map."""
    image, edges = arrays.trust_map, arrays.trust_map_edges
    if image is None or edges is None:
        return None
    first, second = map_dimensions(features)

    def draw(axes: Axes) -> None:
        axes.grid(visible=False)
        mesh = axes.pcolormesh(*edges, np.ma.masked_invalid(image), cmap="viridis", vmin=0, vmax=1, rasterized=True)
        axes.figure.colorbar(mesh, ax=axes, label="trust").outline.set_visible(False)
        axes.set(xlabel=with_unit(first.name, first.unit), ylabel=with_unit(second.name, second.unit))

    caption = (
        "Where the model trusts itself: mean trust of the test transitions in a grid of "
        f"{image.shape[1]} × {image.shape[0]} cells. Near 0: where it knows least, and more data "
        "would help first. Blank: no test data."
    )
    alternative = f"Map of the mean trust over {first.name} and {second.name}"
    return Figure(caption, (panel("trust-map", alternative, draw),))


def map_dimensions(features: FeatureSpec) -> tuple[Dimension, Dimension]:
    """Return the two dimensions of the map: the first two angles, and without them the first two of the state."""
    if len(features.angles) > 1:
        first, second = (Dimension(angle.name, "rad", -np.pi, np.pi) for angle in features.angles[:2])
    else:
        first, second = features.spaces.observation[:2]
    return first, second
