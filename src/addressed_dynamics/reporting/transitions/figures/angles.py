"""Fig. 6: the angle from a noisy cosine and sine, and which way to it is the better."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.reporting.common.blocks import Chart, Line, View
from addressed_dynamics.reporting.common.charts import numbers
from addressed_dynamics.reporting.common.figures.style import FAINT, OWN, TRUTH
from addressed_dynamics.reporting.common.numbers import percent, scientific, significant
from addressed_dynamics.reporting.transitions.angle_study import (
    FORMS,
    Noise,
    Values,
    circle,
    errors,
    noises,
    root_mean_square,
)

SMALL = 1e-3
"""Size of the noise where the error is drawn against the angle."""
SIZES = (1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 2e-1, 3e-1, 5e-1)
"""Sizes of the noise: standard deviations of what is added to a cosine or a sine."""
BEST = ("weighted", "atan2")
"""Forms that are compared in all cases."""
NOISES = {
    "independent": ("independent noise in cosine and sine", "independent", False, tuple(FORMS)),
    "clipped": ("independent noise, values cut off at ±1", "independent", True, BEST),
    "one": ("noise in the cosine alone", "one", False, BEST),
    "radial": ("radial noise: both scaled alike", "radial", False, tuple(FORMS)),
}
"""Title, noise, whether values are clipped, and the forms that are drawn, for each case."""
_BINS = 72
_STYLES: dict[str, tuple[str, str, Literal["line", "dashed", "thick"]]] = {
    "arccos": ("arccos alone", "#b3468c", "line"),
    "arcsin": ("arcsin alone", "#e6a000", "line"),
    "printed": ("weighted, as printed", FAINT, "line"),
    "weighted": ("weighted", TRUTH, "thick"),
    "atan2": ("atan2", OWN, "line"),
}
_SHOWN = ("printed", "weighted", "atan2")
"""Forms that are shown at first."""
_CASES = {"independent": OWN, "clipped": "#b3468c", "one": "#e6a000"}
"""Cases in which the two best forms are compared, with their colours."""
Study = dict[str, dict[str, Float64[np.ndarray, " size"]]]
"""Root mean square errors in rad by case and form, for each of `SIZES`."""


def angle_forms(used: str) -> Chart:
    """Return the error of each way from cosine and sine to the angle, and say which is the better.

    Args:
        used: the one of `FORMS` that the models of the report use.
    """
    angle = circle()
    noise = noises(angle)
    study = _study(angle, noise)
    by_angle = {
        form: np.sqrt((errors(form, angle, noise["independent"], SMALL) ** 2).reshape(_BINS, -1).mean(axis=1))
        for form in FORMS
    }
    middles: Values = angle.reshape(_BINS, -1).mean(axis=1)

    degrees = tuple(np.degrees(middles).tolist())
    sizes = tuple(SIZES)
    views = [
        View(("against the angle",), f"error at a noise of {scientific(SMALL, 1)}, rad", degrees, _lines(by_angle)),
        *(
            View((f"against the size: {NOISES[case][0]}",), "error, rad", sizes, _lines(study[case]))
            for case in ("independent", "radial")
        ),
        View(
            ("weighted beyond atan2",),
            "error of the weighted angle beyond that of atan2, %",
            sizes,
            tuple(
                Line(NOISES[case][0], colour, numbers((100 * _excess(study[case])).tolist()))
                for case, colour in _CASES.items()
            ),
            logarithmic=False,
        ),
    ]
    alternative = "Error of each form of the angle against the true angle and against the size of the noise"
    caption = f"{_caption(study)} The models here use {_STYLES[used][0]}."
    return Chart("angles", caption, alternative, "true angle in degrees, or size of the noise", tuple(views), ("Show",))


def _study(angle: Values, noise: Mapping[str, Noise]) -> Study:
    return {
        case: {
            form: np.array(
                [root_mean_square(errors(form, angle, noise[kind], size, clipped=clipped)) for size in SIZES]
            )
            for form in forms
        }
        for case, (_, kind, clipped, forms) in NOISES.items()
    }


def _lines(errors_of: Mapping[str, Float64[np.ndarray, " place"]]) -> tuple[Line, ...]:
    """Return a line for each form; what does not err beyond rounding has no place on a logarithmic axis."""
    return tuple(
        Line(*_STYLES[form][:2], numbers(values.tolist()), style=_STYLES[form][2], shown=form in _SHOWN)
        for form, values in errors_of.items()
        if values.max() > 1e-12
    )


def _excess(errors_of: dict[str, Float64[np.ndarray, " size"]]) -> Float64[np.ndarray, " size"]:
    """Return by what share of atan2's error the weighted angle's is larger."""
    excess: Float64[np.ndarray, " size"] = errors_of["weighted"] / errors_of["atan2"] - 1
    return excess


def _caption(study: Study) -> str:
    small, large = SIZES.index(SMALL), SIZES.index(0.1)
    independent, radial = study["independent"], study["radial"]["weighted"]
    excess = {case: _excess(study[case]) for case in _CASES}
    printed = independent["printed"][small] / independent["atan2"][small] - 1
    return (
        "The angle from a noisy cosine and sine (Section 3.3): root mean square error over the whole circle, for the "
        "arccosine and the arcsine alone, for their weighted mean with the weight as the paper prints it (mirrored "
        "into every quadrant, since as printed it is an angle in the first alone), for the weighted mean that holds "
        f"everywhere, and for atan2. Noise of {scientific(SMALL, 1)}: atan2 errs by "
        f"{scientific(float(independent['atan2'][small]))} rad, the weighted angle by "
        f"{_compared(float(excess['independent'][small]))}, the printed form by {percent(float(printed), 0)} more, the "
        f"arccosine alone by {significant(float(independent['arccos'][small] / independent['atan2'][small]), 2)} times "
        f"as much. To first order the two best are the same; at 0.1 the weighted angle's error is "
        f"{_compared(float(excess['independent'][large]))}. Noise that scales both alike does not reach atan2 at all; "
        f"of it the weighted angle errs by {percent(float(radial[small] / SMALL))} at {scientific(SMALL, 1)} and by "
        f"{percent(float(radial[large]) / SIZES[large], 0)} at 0.1. {_where_weighted_wins(excess)}"
    )


def _compared(excess: float) -> str:
    """Say by how much one error is larger than another."""
    if abs(excess) < 5e-4:
        return f"the same to {percent(5e-4, 2)}"
    return f"{percent(abs(excess))} {'more' if excess > 0 else 'less'}"


def _where_weighted_wins(excess: dict[str, Float64[np.ndarray, " size"]]) -> str:
    """Say where the weighted angle is clearly the better one, by more than half a per cent."""
    wins = {case: np.array(SIZES)[values < -5e-3] for case, values in excess.items()}
    places = [
        f"{NOISES[case][0]} from a size of {sizes.min():g} on (by up to {percent(-float(excess[case].min()))})"
        for case, sizes in wins.items()
        if sizes.size
    ]
    ahead = min(float(values[: SIZES.index(0.1) + 1].min()) for values in excess.values())
    summary = "Up to a noise of 0.1, atan2 is nowhere the worse of the two. " * (ahead > -5e-4)
    if not places:
        return f"{summary}Nowhere is the weighted angle better by half a per cent."
    return f"{summary}The weighted angle is better by half a per cent or more only with {' and '.join(places)}."
