"""How models predict motion one step ahead: joint by joint, and over time (Fig. 7 of the paper)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from addressed_dynamics.episodes.layout import FRAME_RATE
from addressed_dynamics.evaluation.motion.records import MotionEvaluation
from addressed_dynamics.evaluation.motion.suite import SHOWN_JOINTS
from addressed_dynamics.reporting.common.blocks import Chart, Column, Line, Row, Table, View
from addressed_dynamics.reporting.common.charts import MOST_SHOWN, numbers
from addressed_dynamics.reporting.common.figures.style import TRUTH, thinned
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


def joint_errors(evaluation: MotionEvaluation) -> Table:
    """Return how far each joint, and its velocity, is from the truth on held-out clips."""
    shown = {model_style(group)[0]: evaluation.candidates[name] for group, name in main_models(evaluation).items()}
    columns = (
        Column("Joint", numeric=False),
        *(
            Column(title, f"error of the {quantity}, {unit}")
            for quantity, unit in (("position", "cm"), ("velocity", "cm/frame"))
            for title in shown
        ),
    )
    rows = [
        Row((
            each.joint,
            *(significant(getattr(candidate.test.joints[index], quantity))
              for quantity in ("position", "velocity")
              for candidate in shown.values()),
        ))
        for index, each in enumerate(evaluation.own.test.joints)
    ]  # fmt: skip
    joints = evaluation.own.test.joints
    worst, best = (reduce(joints, key=lambda each: each.position) for reduce in (max, min))
    caption = (
        f"Every joint one step ahead, mean over the {evaluation.own.test.rows:,} frames of held-out clips, in the "
        f"frame of the root: distance from where it was, and from its true velocity. Ours is worst at {worst.joint} "
        f"({significant(worst.position)} cm) and best at {best.joint} ({significant(best.position)} cm)."
    )
    return Table(caption, columns, tuple(rows))


def frames_over_time(evaluation: MotionEvaluation, arrays: MotionArrays, *, cited: str = "") -> Chart:
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
        f"Hips and head over {steps:,} frames of a held-out clip{few}{cited}, in the frame of the "
        "root, one step ahead: every prediction starts from the true frame before."
    )
    alternative = "Hips and head along a held-out clip, true and predicted one step ahead, and the absolute errors"
    label = f"frame ({FRAME_RATE} in a second)"
    return Chart("frames", caption, alternative, label, tuple(views), ("Joint", "Show"))
