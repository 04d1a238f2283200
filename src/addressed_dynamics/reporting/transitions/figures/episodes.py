"""How predictions run beside the truth: one step ahead along an episode, and in rollouts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from addressed_dynamics.episodes.transitions import Dimension
from addressed_dynamics.evaluation.transitions.physics import SIMULATIONS
from addressed_dynamics.features.transitions.spec import Angle
from addressed_dynamics.reporting.common.blocks import Chart, Line, View
from addressed_dynamics.reporting.common.charts import numbers
from addressed_dynamics.reporting.common.figures.style import OWN, TRUTH, thinned, with_unit
from addressed_dynamics.reporting.common.reading import Columns
from addressed_dynamics.reporting.transitions.results import Arrays
from addressed_dynamics.reporting.transitions.rollout_tables import group_title

MOST_STEPS = 200
"""Steps of an episode that a chart shows one step ahead."""
MOST_PLACES = 400
"""Steps of a rollout that a chart keeps."""
Course = Float[np.ndarray, " step"]


def one_step_prediction(arrays: Arrays, dimensions: Sequence[Dimension], angles: Sequence[Angle] = ()) -> Chart:
    """Return predictions beside the truth along the longest held-out episode, and their errors.

    Args:
        arrays: what was predicted.
        dimensions: what the columns of the states mean.
        angles: angles that the states give by cosine and sine, which are shown too.
    """
    episodes, lengths = np.unique(arrays.episode, return_counts=True)
    rows = np.flatnonzero(arrays.episode == episodes[lengths.argmax()])[:MOST_STEPS]
    courses = [
        (each.name, each.unit, arrays.next_observation[rows, index], arrays.predicted[rows, index])
        for index, each in enumerate(dimensions)
    ]
    courses += [(angle.name, "rad", *_turns(arrays, rows, dimensions, angle)) for angle in angles]
    views = [
        view
        for name, unit, truth, predicted in courses
        for view in _course_and_error((name,), with_unit(name, unit), tuple(range(len(rows))), truth, predicted)
    ]
    turned = " Angles come from cosine and sine by atan2 and run on beyond a full turn." * bool(angles)
    caption = (
        f"One step ahead along the longest held-out episode (its first {len(rows)} steps): the true next state, and "
        f"what the addressed ensemble predicts for it from the true state before; or the absolute error.{turned}"
    )
    alternative = "States along an episode, true and predicted one step ahead, and the absolute errors"
    return Chart("one-step", caption, alternative, "step", tuple(views), ("Dimension", "Show"))


def _turns(
    arrays: Arrays, rows: Int[np.ndarray, " step"], dimensions: Sequence[Dimension], angle: Angle
) -> tuple[Course, Course]:
    """Return the true and the predicted course of an angle in rad, without the jumps from pi to -pi."""
    names = [dimension.name for dimension in dimensions]
    cosine, sine = names.index(angle.cosine), names.index(angle.sine)
    truth, predicted = (
        np.arctan2(states[rows, sine].astype(np.float64), states[rows, cosine])
        for states in (arrays.next_observation, arrays.predicted)
    )
    course = np.unwrap(truth)
    return course, course + np.remainder(predicted - truth + np.pi, 2 * np.pi) - np.pi


def rollouts(arrays: Arrays, dimensions: Sequence[Dimension], truth: Literal["environment", "recorded"]) -> Chart:
    """Return the true and the predicted course of rollouts, one of each group that was told apart."""
    steps = arrays.rollout_true.shape[1]
    kept = thinned(steps, MOST_PLACES)
    titles = [_GROUPS.get(group, f"from {group_title(group)}") for group in arrays.rollout_group.tolist()]
    views = [
        view
        for episode, title in enumerate(titles)
        for index, each in enumerate(dimensions)
        for view in _course_and_error(
            (title, each.name),
            with_unit(each.name, each.unit),
            tuple(kept.tolist()),
            arrays.rollout_true[episode, kept, index],
            arrays.rollout_predicted[episode, kept, index],
            titles=(truth, "addressed ensemble"),
        )
    ]
    which = "One rollout of each kind, the middle one" if len(titles) > 1 else "The middle one"
    caption = (
        f"Free-running rollouts of {steps - 1:,} steps: the addressed ensemble sees the true first state and the "
        f"actions, and from then on only its own predictions. {which} in the order of recording."
    )
    alternative = "States in rollouts, true and predicted, and the absolute errors"
    return Chart("rollout", caption, alternative, "step", tuple(views), ("Rollout", "Dimension", "Show"))


_GROUPS = {"all": "the middle one", "no_wall": "without wall contact", "wall": "with wall contact"}
"""Title of a rollout that stands for its group, where it is not a segment of the recording."""


def _course_and_error(
    choice: tuple[str, ...],
    label: str,
    places: tuple[float, ...],
    truth: Course,
    predicted: Course,
    titles: tuple[str, str] = ("truth", "prediction"),
) -> tuple[View, View]:
    error = numbers(np.abs(predicted.astype(np.float64) - truth).tolist())
    both = (
        Line(titles[1], OWN, numbers(predicted.tolist())),
        Line(titles[0], TRUTH, numbers(truth.tolist()), style="thick"),
    )
    return (
        View((*choice, "course"), label, places, both, logarithmic=False),
        View((*choice, "error"), f"error of {label}", places, (Line("error", OWN, error),)),
    )


def first_of_each(horizon: Mapping[str, Columns]) -> dict[str, Columns]:
    """Return the addressed ensemble and one of each baseline: what a figure of curves has room for."""
    shown: dict[str, Columns] = {}
    seen: set[str] = set()
    for name, columns in horizon.items():
        kind = name.partition("/seed-")[0]
        model = name not in SIMULATIONS
        if model and kind not in seen and (kind == "ensemble/argmax" or not kind.startswith("ensemble/")):
            seen.add(kind)
            shown[name] = columns
    return shown
