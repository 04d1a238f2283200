"""The closed loop: what happens over time, the way from above, and the scores."""

from __future__ import annotations

from statistics import median
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from addressed_dynamics.episodes.layout import FRAME_RATE
from addressed_dynamics.evaluation.motion.closed_loop.commands import Script, standard_script
from addressed_dynamics.evaluation.motion.records import MotionEvaluation
from addressed_dynamics.reporting.common.blocks import Chart, Figure, Line, View
from addressed_dynamics.reporting.common.charts import numbers
from addressed_dynamics.reporting.common.figures.style import TRUTH, panel
from addressed_dynamics.reporting.motion.comparison import score_of
from addressed_dynamics.reporting.motion.loop_tables import score_words
from addressed_dynamics.reporting.motion.models import main_models, model_style
from addressed_dynamics.reporting.motion.results import Loop, MotionArrays
from addressed_dynamics.reporting.motion.targets import expected_limb_speed

WINDOW = 30
"""Frames over which limbs, feet and bones are averaged in the chart: their figures swing with every step."""
MOST_FRAMES = 300
"""Frames that the chart over time keeps."""
COURSES = (
    ("speed", "speed, cm/s", 1.0),
    ("facing_error", "facing error, degrees", 1.0),
    ("limb_speed", "speed of the limbs, cm/s", 1.0),
    ("slowest_foot_speed", "speed of the slowest foot, cm/s", 1.0),
    ("bone_drift", "bone drift, %", 100.0),
)
"""What is drawn over time: a field of `Loop`, its label with its unit, and a factor."""


def over_time(evaluation: MotionEvaluation, arrays: MotionArrays, other: str | None) -> Chart:
    """Return how the main models follow the test script.

    Args:
        evaluation: what was measured.
        arrays: what each model did.
        other: the group that stands beside ours at first; None for none.
    """
    shown = main_models(evaluation, arrays.loops)
    own = arrays.loops[evaluation.own_name]
    kept = np.unique(np.linspace(0, len(own.speed) - 1, min(len(own.speed), MOST_FRAMES)).round().astype(np.int64))
    seconds = tuple((kept / FRAME_RATE).tolist())
    views = []
    for name, label, factor in COURSES:
        lines = [
            Line(
                model_style(group)[0], model_style(group)[1],
                numbers((factor * _course(arrays.loops[model], name)[kept]).tolist()),
                shown=group in (evaluation.own_group, other),
            )
            for group, model in shown.items()
        ]  # fmt: skip
        if name == "speed":
            lines.append(Line("command", TRUTH, numbers(own.commanded_speed[kept].tolist()), style="thick"))
        views.append(View((label.partition(",")[0],), label, seconds, tuple(lines), logarithmic=False))
    expected = expected_limb_speed(evaluation)
    recorded = f", where recorded limbs move at {expected:.0f} cm/s" if expected else ""
    caption = f"The closed loop under the test script{recorded}; a line that ends is a run that has died."
    alternative = "Speed, facing error, limbs, slowest foot and bone drift in the closed loop over time"
    return Chart("loop-over-time", caption, alternative, "seconds", tuple(views), ("Course of",))


def paths(evaluation: MotionEvaluation, arrays: MotionArrays) -> Figure:
    """Draw the way of the main models from above."""
    shown = main_models(evaluation, arrays.loops)
    own = arrays.loops[evaluation.own_name]

    def draw(axes: Axes) -> None:
        asked = np.cumsum(own.commanded_velocity, axis=0)
        _path(axes, asked, color=TRUTH, linewidth=4, label="command, followed at once")
        for group, name in reversed(shown.items()):
            title, colour = model_style(group)
            loop = arrays.loops[name]
            _path(axes, loop.root_position[: int(loop.living.sum()) + 1], color=colour, linewidth=1.1, label=title)
        axes.set(xlabel="to the right (m)", ylabel="ahead (m)", aspect="equal")
        axes.set_adjustable("datalim")
        handles, titles = axes.get_legend_handles_labels()
        order = [0, *range(len(titles) - 1, 0, -1)]
        axes.legend(
            [handles[k] for k in order], [titles[k] for k in order], loc="lower left", bbox_to_anchor=(-0.12, 1),
            ncols=2, fontsize=7.5, columnspacing=1.0, borderaxespad=0.2,
        )  # fmt: skip

    caption = (
        "The way from above over the whole script, beside that of a character that would follow every command at once; "
        "later errors are also those of headings before."
    )
    alternative = "The way of each model from above, and that of the commands"
    return Figure(caption, (panel("loop-paths", alternative, draw, size=(4.6, 4.4)),))


def scores(evaluation: MotionEvaluation) -> Chart:
    """Return the scores of all models, from every seed."""
    ordered = sorted(evaluation.models.items(), key=lambda item: -median(map(score_of, item[1])))
    lines = tuple(
        Line(model_style(group)[0], model_style(group)[1], numbers([score_of(each) for each in candidates]))
        for group, candidates in ordered
    )
    dots = "a dot for each seed" if max(map(len, evaluation.models.values())) > 1 else "one seed of each"
    caption = f"Scores under the test script, {dots}. {score_words(evaluation.own.closed_loop)}"
    view = View((), "score in the closed loop", (), lines, logarithmic=False)
    return Chart("loop-scores", caption, "Scores of all models in the closed loop", "", (view,), form="ranges")


def told(loop: Loop) -> Script | None:
    """Return the script that was followed, if it is the standard one."""
    script = standard_script()
    return script if len(script) == len(loop.joint_position) else None


def _course(loop: Loop, name: str) -> Float[np.ndarray, " step"]:
    values = np.asarray(getattr(loop, name), np.float64)
    if name not in {"speed", "facing_error"}:
        kernel = np.ones(min(WINDOW, len(values)))
        values = np.convolve(values, kernel, mode="same") / np.convolve(np.ones_like(values), kernel, mode="same")
    return np.where(loop.living, values, np.nan)


def _path(axes: Axes, points: Float[np.ndarray, "time 2"], **style: Any) -> None:
    # Seen from above, with what is ahead upwards, what is to the left has a positive x.
    axes.plot(-points[:, 0] / 100, points[:, 1] / 100, solid_capstyle="round", **style)
