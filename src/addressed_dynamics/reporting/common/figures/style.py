"""The house style of all figures: colours, sizes, and how a drawing becomes a picture of always the same bytes."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import FuncFormatter, LogFormatter, NullFormatter, NullLocator
from PIL import Image

from addressed_dynamics.reporting.common.blocks import Panel

INK = "#222222"
"""Text."""
FAINT = "#8c8c8c"
"""What stands back."""
TRUTH = "#bdbdbd"
"""What really happened."""
OWN = "#0072b2"
"""The addressed ensemble, in charts and in films."""
ACTION, REACHED = "#d55e00", "#009e73"
"""What is asked for (an action, a command), and what is reached or touched."""
MEMBERS = ("#332288", "#ddaa33", "#44aa99", "#cc6677", "#88ccee", "#882255", "#117733", "#aa4499")
"""One colour for each member, of which no model has one; after Paul Tol, whom colour-blind readers can follow."""
MODELS = {
    "ensemble/argmax": ("addressed ensemble", OWN),
    "total_parameters": ("one large network", "#b3468c"),
    "same_size": ("one network, as large as a member", "#66a61e"),
    "wide": ("one wide network", "#e6a000"),
    "unequal_bins": ("without equal bins", "#56b4e9"),
    "random_bins": ("random bins", "#a6761d"),
    "persistence": ("nothing changes", "#4d4d4d"),
    "last_change": ("the last change goes on", "#b07d62"),
    "linear": ("linear least squares", "#8a7a00"),
    "linear_frame": ("linear, last frame", "#c2b95a"),
    "paper_recipe": ("the paper's recipe", "#7b3294"),
    "default_recipe": ("the default recipe", "#7b3294"),
}
"""Short title and colour of each model; one that is not here is drawn under its own name."""
OTHER_MODELS = ("#e7298a", "#1b7f79", "#8c510a", "#5e4fa2", "#3f7f00")
"""Colours of the models that have none of their own, in their order."""
HALF = (4.6, 3.2)
"""Size in hundreds of CSS pixels of a picture of which two stand side by side."""
THIRD = (3.1, 2.7)
"""The same for three."""
ERROR_FLOOR = 1e-16
"""Errors below it are drawn at it: a logarithm needs a positive number."""

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_CSS_DPI = 100
_PIXEL_RATIO = 2
_COLOURS = 128
_RC = {
    "axes.edgecolor": FAINT,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 9,
    "axes.linewidth": 0.7,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 9.5,
    "figure.constrained_layout.use": True,
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "legend.labelcolor": INK,
    "lines.linewidth": 1.4,
    "text.color": INK,
    "xtick.color": FAINT,
    "xtick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.color": FAINT,
    "ytick.labelcolor": INK,
    "ytick.labelsize": 8,
}


def panel(
    name: str,
    alternative: str,
    draw: Callable[[Axes], object],
    *,
    size: tuple[float, float] = HALF,
) -> Panel:
    """Draw a picture with one pair of axes."""
    return picture(name, alternative, lambda canvas: draw(canvas.subplots()), size=size)


def picture(
    name: str,
    alternative: str,
    draw: Callable[[Canvas], object],
    *,
    size: tuple[float, float] = HALF,
) -> Panel:
    """Draw a picture; `draw` makes the axes."""
    with mpl.rc_context(_RC):
        canvas = Canvas(figsize=size, dpi=_CSS_DPI * _PIXEL_RATIO)
        agg = FigureCanvasAgg(canvas)
        draw(canvas)
        for axes in canvas.axes:
            _label_plainly(axes)
        agg.draw()
        buffer = io.BytesIO()
        # `savefig` would lay out and draw everything twice, and in 16 million colours, of which a picture needs few.
        drawn = Image.fromarray(np.ascontiguousarray(np.asarray(agg.buffer_rgba())[..., :3]))
        drawn.quantize(_COLOURS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(buffer, "PNG")
    width, height = (round(side * _CSS_DPI) for side in size)
    return Panel(name, alternative, buffer.getvalue(), width, height)


def _label_plainly(axes: Axes) -> None:
    """Write powers of ten as text: matplotlib sets them as formulas, which takes a fifth of a report's time."""
    for axis in (axes.xaxis, axes.yaxis):
        if isinstance(axis.get_major_formatter(), LogFormatter):
            axis.set_major_formatter(FuncFormatter(_power_of_ten))
        if isinstance(axis.get_minor_formatter(), LogFormatter):
            axis.set_minor_formatter(NullFormatter())


def _power_of_ten(value: float, _position: int | None) -> str:
    """Return a label such as 10⁻⁶; nothing for what is no power of ten."""
    exponent = round(math.log10(value)) if value > 0 else None
    if exponent is None or not math.isclose(value, 10.0**exponent):
        return ""
    return f"10{str(exponent).translate(_SUPERSCRIPT)}"


def member_colour(member: int) -> str:
    """Return the colour of a member."""
    return MEMBERS[member % len(MEMBERS)]


def model_style(name: str, among: Iterable[str] = ()) -> tuple[str, str]:
    """Return title and colour of a model such as `wide/seed-0`.

    Args:
        name: the model's name.
        among: names of all models that are drawn beside it: one without a colour of its own gets its colour by its
            place among them.
    """
    key = name.partition("/seed-")[0]
    keys = dict.fromkeys(each.partition("/seed-")[0] for each in (*among, name))
    others = [each for each in keys if each not in MODELS and not each.startswith("ensemble/")]
    colour = OTHER_MODELS[others.index(key) % len(OTHER_MODELS)] if key in others else OWN
    return MODELS.get(key, (key.replace("_", " "), colour))


def positive(errors: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Return errors that a logarithmic axis can show."""
    shown: Float[np.ndarray, "*shape"] = np.maximum(errors, ERROR_FLOOR)
    return shown


def logarithmic(axes: Axes, *which: str) -> None:
    """Make axes (`x`, `y`) logarithmic, with whole powers of ten as the only ticks, at least two of them."""
    for letter in which:
        axes.set(**{f"{letter}scale": "log"})
        low, high = getattr(axes, f"get_{letter}lim")()
        if high / low < 100:
            axes.set(**{f"{letter}lim": (10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(high)))})
        getattr(axes, f"{letter}axis").set_minor_locator(NullLocator())


def thinned(samples: int, most: int) -> Int[np.ndarray, " row"]:
    """Return at most so many rows, evenly spread, so that a picture stays readable and small."""
    return np.unique(np.linspace(0, samples - 1, min(samples, most)).astype(np.int64))


def with_unit(name: str, unit: str) -> str:
    """Return the label of an axis."""
    return f"{name.replace('_', ' ')} ({unit})" if unit else name.replace("_", " ")


def member_legend(owner: Axes | Canvas, members: list[int], **options: Any) -> None:
    """Explain the members' colours with dots."""
    handles = [
        mpl.lines.Line2D([], [], linestyle="", marker="o", markersize=4.5, color=member_colour(k)) for k in members
    ]
    owner.legend(handles, [f"network {k + 1}" for k in members], handletextpad=0.2, **options)
