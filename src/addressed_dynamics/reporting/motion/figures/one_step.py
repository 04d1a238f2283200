"""How models predict motion one step ahead: joint by joint, and over time (Fig. 7 of the paper)."""

from __future__ import annotations

from functools import partial

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from addressed_dynamics.episodes.layout import FRAME_RATE
from addressed_dynamics.evaluation.motion.records import MotionEvaluation
from addressed_dynamics.evaluation.motion.suite import SHOWN_JOINTS
from addressed_dynamics.reporting.common.blocks import Chart, Figure, Line, View
from addressed_dynamics.reporting.common.charts import MOST_SHOWN, numbers
from addressed_dynamics.reporting.common.figures.style import TRUTH, logarithmic, panel, positive, thinned
from addressed_dynamics.reporting.common.numbers import significant
from addressed_dynamics.reporting.motion.models import main_models, model_style
from addressed_dynamics.reporting.motion.results import MotionArrays

COORDINATES = (
    ("Hips", 1, "height"),
    ("Head", 1, "height"),
    ("Head", 2, "ahead of the hips"),
    ("Head", 0, "left of the hips"),
)
"""What is drawn over time: joint, axis, and what it says; hips are at 0 along the others by definition."""
MOST_FRAMES = 400
"""Frames that the chart over time keeps."""
Course = Float[np.ndarray, " time"]


def joint_errors(evaluation: MotionEvaluation) -> Figure:
    """Draw how far each joint, and its velocity, is from the truth on held-out clips."""
    shown = main_models(evaluation)
    names = [each.joint for each in evaluation.own.test.joints]

    def draw(axes: Axes, quantity: str, label: str) -> None:
        for group, name in reversed(shown.items()):
            title, colour = model_style(group)
            values = [getattr(each, quantity) for each in evaluation.candidates[name].test.joints]
            axes.plot(positive(np.array(values)), range(len(values)), "o", markersize=4, color=colour, label=title)
        axes.set(xlabel=label, ylim=(len(names) - 0.4, -0.6))
        axes.set_yticks(range(len(names)), names, fontsize=7)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        logarithmic(axes, "x")
        handles, titles = axes.get_legend_handles_labels()
        axes.legend(
            handles[::-1], titles[::-1], loc="lower left", bbox_to_anchor=(-0.3, 1), borderaxespad=0.2, ncols=2,
            columnspacing=1.0, handletextpad=0.1, fontsize=7.5,
        )  # fmt: skip

    panels = tuple(
        panel(
            f"joints-{quantity}",
            f"Mean error of the {quantity} of every joint, one step ahead on held-out clips",
            partial(draw, quantity=quantity, label=f"error of the {quantity} ({unit})"),
            size=(4.6, 6.4),
        )
        for quantity, unit in (("position", "cm"), ("velocity", "cm/frame"))
    )
    joints = evaluation.own.test.joints
    worst, best = (reduce(joints, key=lambda each: each.position) for reduce in (max, min))
    caption = (
        f"Every joint one step ahead, mean over the {evaluation.own.test.rows:,} frames of held-out clips, in the "
        f"frame of the root: distance from where it was, and from its true velocity. Ours is worst at {worst.joint} "
        f"({significant(worst.position)} cm) and best at {best.joint} ({significant(best.position)} cm)."
    )
    return Figure(caption, panels)


def frames_over_time(evaluation: MotionEvaluation, arrays: MotionArrays) -> Chart:
    """Return hips and head along a held-out clip, true and predicted one step ahead, with the errors (Fig. 7)."""
    shown = main_models(evaluation, arrays.frames)
    steps = len(arrays.true)
    kept = thinned(steps, MOST_FRAMES)
    places = tuple(kept.tolist())
    views = []
    for joint, axis, what in COORDINATES:
        place = SHOWN_JOINTS.index(joint)
        truth: Course = arrays.true[kept, place, axis]
        courses = [Line("truth", TRUTH, numbers(truth.tolist()), style="thick")]
        errors = []
        for index, (group, name) in enumerate(shown.items()):
            title, colour = model_style(group)
            predicted: Course = arrays.frames[name][kept, place, axis]
            error = np.abs(predicted.astype(np.float64) - truth)
            courses.insert(index, Line(title, colour, numbers(predicted.tolist()), shown=index < MOST_SHOWN - 1))
            errors.append(Line(title, colour, numbers(error.tolist()), shown=index < MOST_SHOWN - 1))
        choice = f"{joint}, {what}"
        views += [
            View((choice, "course"), f"{choice}, cm", places, tuple(courses), logarithmic=False),
            View((choice, "error"), f"error of {choice}, cm", places, tuple(errors)),
        ]
    few = "" if steps >= 1000 else ", as no held-out stretch is longer"
    caption = (
        f"Hips and head over {steps:,} frames of a held-out clip{few} (Fig. 7 of the paper), in the frame of the "
        "root, one step ahead: every prediction starts from the true frame before."
    )
    alternative = "Hips and head along a held-out clip, true and predicted one step ahead, and the absolute errors"
    label = f"frame ({FRAME_RATE} in a second)"
    return Chart("frames", caption, alternative, label, tuple(views), ("Joint", "Show"))
