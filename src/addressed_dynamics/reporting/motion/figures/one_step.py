"""How models predict motion one step ahead: joint by joint, and over time (Fig. 7 of the paper)."""

from __future__ import annotations

from functools import partial

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from addressed_dynamics.episodes.layout import FRAME_RATE
from addressed_dynamics.evaluation.motion.records import MotionEvaluation
from addressed_dynamics.evaluation.motion.suite import SHOWN_JOINTS
from addressed_dynamics.reporting.common.blocks import Figure
from addressed_dynamics.reporting.common.figures.style import logarithmic, panel, picture, positive
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


def frames_over_time(evaluation: MotionEvaluation, arrays: MotionArrays) -> Figure:
    """Draw hips and head along a held-out clip, true and predicted one step ahead, with the errors (Fig. 7)."""
    shown = main_models(evaluation, arrays.frames)
    steps = np.arange(len(arrays.true))

    def draw(canvas: Canvas, joint: str, axis: int, what: str) -> None:
        place = SHOWN_JOINTS.index(joint)
        upper, lower = canvas.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        truth: Course = arrays.true[:, place, axis]
        upper.plot(steps, truth, color="#bdbdbd", linewidth=4, label="truth", solid_capstyle="round")
        for group, name in reversed(shown.items()):
            title, colour = model_style(group)
            predicted: Course = arrays.frames[name][:, place, axis]
            upper.plot(steps, predicted, color=colour, linewidth=0.9, label=title)
            error = positive(np.abs(predicted.astype(np.float64) - truth))
            lower.plot(steps, np.maximum(error, 1e-3), color=colour, linewidth=0.7)
        upper.set(ylabel="cm", title=f"{joint}, {what}")
        lower.set(ylabel="error (cm)", xlabel=f"frame ({FRAME_RATE} in a second)")
        logarithmic(lower, "y")
        handles, titles = upper.get_legend_handles_labels()
        order = [0, *range(len(titles) - 1, 0, -1)]
        canvas.legend(
            [handles[k] for k in order], [titles[k] for k in order], loc="outside lower center", ncols=2, fontsize=7.5
        )

    panels = tuple(
        picture(
            f"frames-{joint.lower()}-{'xyz'[axis]}",
            f"{joint}, {what}, along a held-out clip: true and predicted one step ahead, and the absolute errors",
            partial(draw, joint=joint, axis=axis, what=what),
            size=(4.6, 4.3),
        )
        for joint, axis, what in COORDINATES
    )
    few = "" if len(steps) >= 1000 else ", as no held-out stretch is longer"
    caption = (
        f"Hips and head over {len(steps):,} frames of a held-out clip{few} (Fig. 7 of the paper), in the frame of the "
        "root, one step ahead: every prediction starts from the true frame before. Errors below 0.001 cm are drawn at "
        "it."
    )
    return Figure(caption, panels)
