"""How predictions run beside the truth: one step ahead along an episode, in rollouts, and against the horizon."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from addressed_dynamics.episodes.transitions import Dimension
from addressed_dynamics.evaluation.transitions.physics import SIMULATIONS
from addressed_dynamics.features.transitions.spec import Angle
from addressed_dynamics.reporting.common.blocks import Figure
from addressed_dynamics.reporting.common.figures.style import (
    OWN,
    logarithmic,
    member_colour,
    member_legend,
    model_style,
    panel,
    picture,
    positive,
    with_unit,
)
from addressed_dynamics.reporting.common.reading import Columns
from addressed_dynamics.reporting.transitions.results import Arrays
from addressed_dynamics.reporting.transitions.rollout_tables import group_title

MOST_STEPS = 200
"""Steps of an episode that a figure shows."""
Course = Float[np.ndarray, " step"]


def one_step_prediction(arrays: Arrays, dimensions: Sequence[Dimension], angles: Sequence[Angle] = ()) -> Figure:
    """Draw predictions beside the truth along the longest held-out episode, with the error and the network selected.

    Args:
        arrays: what was predicted.
        dimensions: what the columns of the states mean.
        angles: angles that the states give by cosine and sine, which are drawn too.
    """
    episodes, lengths = np.unique(arrays.episode, return_counts=True)
    rows = np.flatnonzero(arrays.episode == episodes[lengths.argmax()])[:MOST_STEPS]
    steps = np.arange(len(rows))
    chosen = arrays.chosen[rows]
    colours = [member_colour(member) for member in chosen]

    courses = [
        (each.name, each.unit, arrays.next_observation[rows, index], arrays.predicted[rows, index])
        for index, each in enumerate(dimensions)
    ]
    courses += [(angle.name, "rad", *_turns(arrays, rows, dimensions, angle)) for angle in angles]

    def draw(canvas: Canvas, name: str, unit: str, truth: Course, predicted: Course) -> None:
        upper, lower = canvas.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        upper.plot(steps, truth, color="#bdbdbd", linewidth=4, label="truth", solid_capstyle="round")
        upper.plot(steps, predicted, color=OWN, linewidth=1, label="prediction")
        upper.set_ylabel(with_unit(name, unit))
        upper.legend(loc="lower right", ncols=2, bbox_to_anchor=(1, 1), borderaxespad=0.2)
        error = positive(np.abs(predicted.astype(np.float64) - truth))
        # A prediction that is exact to the last bit has no place on a logarithmic axis.
        exact = np.abs(predicted - truth) == 0
        lower.scatter(steps[~exact], error[~exact], c=[c for c, e in zip(colours, exact, strict=True) if not e], s=5)
        lower.set(ylabel="error", xlabel="step")
        logarithmic(lower, "y")
        member_legend(canvas, sorted(set(chosen.tolist())), loc="outside lower center", ncols=4)

    panels = tuple(
        picture(
            f"one-step-{name}",
            f"{name} along an episode, true and predicted one step ahead, and the absolute error",
            partial(draw, name=name, unit=unit, truth=truth, predicted=predicted),
            size=(4.6, 3.8),
        )
        for name, unit, truth, predicted in courses
    )
    caption = (
        f"One step ahead along the longest held-out episode (its first {len(rows)} steps). Above: the true next "
        "state, and what the model predicts for it from the true state before. Below: the absolute error in the same "
        "unit, coloured by the network that the addressing network selects."
        f"{' Angles come from cosine and sine by atan2 and run on beyond a full turn.' * bool(angles)}"
    )
    return Figure(caption, panels)


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


def rollouts(arrays: Arrays, dimensions: Sequence[Dimension], truth: Literal["environment", "recorded"]) -> Figure:
    """Draw the true and the predicted course of rollouts, one of each group that was told apart."""
    steps = np.arange(arrays.rollout_true.shape[1])
    titles = [_GROUPS.get(group, f"from {group_title(group)}") for group in arrays.rollout_group.tolist()]

    def draw(axes: Axes, episode: int, index: int, dimension: Dimension) -> None:
        axes.plot(steps, arrays.rollout_true[episode, :, index], color="#bdbdbd", linewidth=3.5, label=truth)
        axes.plot(steps, arrays.rollout_predicted[episode, :, index], color=OWN, linewidth=0.9, label="model")
        axes.set(xlabel="step", ylabel=with_unit(dimension.name, dimension.unit), xlim=(0, steps[-1]))
        axes.legend(loc="lower right", ncols=2, bbox_to_anchor=(1, 1), borderaxespad=0.2)
        axes.set_title(titles[episode])

    panels = tuple(
        panel(
            f"rollout-{episode}-{dimension.name}",
            f"{dimension.name} in a rollout{f' {title}' * bool(title)}, true and predicted",
            partial(draw, episode=episode, index=index, dimension=dimension),
        )
        for episode, title in enumerate(titles)
        for index, dimension in enumerate(dimensions)
    )
    which = "One rollout of each kind, the middle one" if len(arrays.rollout_true) > 1 else "The middle one"
    caption = (
        f"Free-running rollouts of {steps[-1]:,} steps: the model sees the true first state and the actions, and from "
        f"then on only its own predictions. {which} in the order of recording."
    )
    return Figure(caption, panels)


_GROUPS = {"all": "", "no_wall": "without wall contact", "wall": "with wall contact"}
"""Title of a rollout that stands for its group, where it is not a segment of the recording."""


def error_against_horizon(horizon: Mapping[str, Columns], dimensions: Sequence[Dimension]) -> Figure:
    """Draw the squared error of rollouts against their length, for the addressed ensemble and one of each baseline."""
    shown = first_of_each(horizon)

    def draw(axes: Axes, dimension: Dimension) -> None:
        for name, columns in shown.items():
            title, colour = model_style(name, shown)
            low, middle, high = (_percentile(columns, dimension, share) for share in ("p10", "p50", "p90"))
            own = name == "ensemble/argmax"
            if own or name.startswith("total_parameters"):
                axes.fill_between(columns["horizon"], low, high, color=colour, alpha=0.13, linewidth=0)
            axes.plot(
                columns["horizon"], middle, color=colour, label=title, linewidth=1.8 if own else 1.1, zorder=3 + own
            )
        axes.set(xlabel="steps since the true state", ylabel=_squared(dimension), xlim=(0, None))
        logarithmic(axes, "y")
        axes.figure.legend(loc="outside lower center", ncols=2)

    panels = tuple(
        panel(
            f"horizon-{dimension.name}",
            f"Squared error of {dimension.name} in rollouts against the number of steps, for all models",
            partial(draw, dimension=dimension),
            size=(4.6, 4.0),
        )
        for dimension in dimensions
    )
    caption = (
        "Error against horizon in free-running rollouts: median over all rollouts (line) and 10th to 90th percentile "
        "(band, for the ensemble and the one network of as many parameters), in the units of the state. The addressed "
        "ensemble and one of each baseline."
    )
    return Figure(caption, panels)


def _squared(dimension: Dimension) -> str:
    unit = f"({dimension.unit})²" if "/" in dimension.unit else f"{dimension.unit}²" if dimension.unit else ""
    return f"squared error of the {dimension.name}{', ' * bool(unit)}{unit}"


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


def _percentile(columns: Columns, dimension: Dimension, share: str) -> Float[np.ndarray, " horizon"]:
    return positive(columns[f"{dimension.name}_{share}"])
