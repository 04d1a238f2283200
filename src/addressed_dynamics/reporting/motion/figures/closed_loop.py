"""The closed loop: what happens over time, the way from above, and the scores."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

from addressed_dynamics.episodes.layout import FRAME_RATE
from addressed_dynamics.evaluation.motion.closed_loop.commands import Kind, Script, standard_script
from addressed_dynamics.evaluation.motion.records import MotionEvaluation
from addressed_dynamics.reporting.common.blocks import Figure
from addressed_dynamics.reporting.common.figures.style import FAINT, panel, picture
from addressed_dynamics.reporting.motion.comparison import score_of
from addressed_dynamics.reporting.motion.loop_tables import score_words
from addressed_dynamics.reporting.motion.models import main_models, model_style
from addressed_dynamics.reporting.motion.results import Loop, MotionArrays
from addressed_dynamics.reporting.motion.targets import expected_limb_speed

WINDOW = 30
"""Frames over which limbs, feet and bones are averaged in the picture: their figures swing with every step."""
COURSES = (
    ("speed", "speed\n(cm/s)", 1.0, None),
    ("facing_error", "facing error\n(degrees)", 1.0, 60.0),
    ("limb_speed", "limbs\n(cm/s)", 1.0, 150.0),
    ("slowest_foot_speed", "slowest foot\n(cm/s)", 1.0, 150.0),
    ("bone_drift", "bone drift\n(%)", 100.0, 15.0),
)
"""What is drawn over time: a field of `Loop`, its label, factor, and the highest value that is shown."""
_SHADES: dict[Kind, str] = {
    "stand": "#ffffff",
    "walk": "#f1f5f9",
    "walk_turn": "#dfe9f2",
    "jog": "#f8f1e7",
    "jog_turn": "#f1e2cc",
}


def over_time(evaluation: MotionEvaluation, arrays: MotionArrays) -> Figure:
    """Draw how the main models follow the test script, frame by frame."""
    shown = main_models(evaluation, arrays.loops)
    own = arrays.loops[evaluation.own_name]
    script = told(own)

    def draw(canvas: Canvas) -> None:
        strips: Sequence[Axes] = canvas.subplots(len(COURSES), 1, sharex=True, height_ratios=(1.5, 1, 1, 1, 1))
        seconds = np.arange(len(own.speed)) / FRAME_RATE
        strips[0].plot(seconds, own.commanded_speed, color="#bdbdbd", linewidth=4, label="command")
        for axes, (name, label, factor, most) in zip(strips, COURSES, strict=True):
            for group, model in reversed(shown.items()):
                title, colour = model_style(group)
                axes.plot(seconds, factor * _course(arrays.loops[model], name), color=colour, lw=1, label=title)
            axes.set(ylabel=label, xlim=(0, seconds[-1]))
            axes.set_ylim(0, most and min(most, 1.05 * axes.get_ylim()[1]))
            axes.grid(visible=False, axis="x")
            _shade(axes, script)
        strips[-1].set_xlabel("time (s)")
        handles, titles = strips[0].get_legend_handles_labels()
        order = [0, *range(len(titles) - 1, 0, -1)]
        canvas.legend([handles[k] for k in order], [titles[k] for k in order], loc="outside upper center", ncols=5)

    whole = picture(
        "loop-over-time",
        "Speed, facing error, speed of limbs and of the slowest foot, and bone drift in the closed loop over time",
        draw,
        size=(9.4, 7.4),
    )
    expected = expected_limb_speed(evaluation)
    recorded = f" (recorded ones, in the gaits asked for: {expected:.0f} cm/s)" if expected else ""
    caption = (
        "The closed loop under the test script. Speed of the root over half a second beside the command; angle "
        f"between where it faces and the command; mean speed of the limbs{recorded}; speed along the ground of the "
        "slowest heel or toe, which is near 0 where something stands still; mean share by which bones are too long or "
        f"too short. Limbs, feet and bones are averaged over {WINDOW / FRAME_RATE:g} s. Ground: white, told to stand; "
        "blue, to walk, darker in turns; sand, to jog, darker in turns. A line that ends is a run that has died; "
        "values beyond a strip are cut off."
    )
    return Figure(caption, (whole,))


def paths_and_scores(evaluation: MotionEvaluation, arrays: MotionArrays) -> Figure:
    """Draw the way of the main models from above, and the scores of all."""
    shown = main_models(evaluation, arrays.loops)
    own = arrays.loops[evaluation.own_name]

    def paths(axes: Axes) -> None:
        asked = np.cumsum(own.commanded_velocity, axis=0)
        _path(axes, asked, color="#bdbdbd", linewidth=4, label="command, followed at once")
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

    def scores(axes: Axes) -> None:
        ordered = sorted(evaluation.models.items(), key=lambda item: -median(map(score_of, item[1])))
        for place, (group, candidates) in enumerate(ordered):
            _, colour = model_style(group)
            values = [score_of(each) for each in candidates]
            axes.plot([0, median(values)], [place, place], color=colour, linewidth=1, alpha=0.4)
            axes.plot(values, [place] * len(values), "o", color=colour, markersize=6, clip_on=False)
            axes.text(median(values) + 0.03, place, f"{median(values):.2f}", va="center", fontsize=8)
        axes.set(xlim=(0, 1.08), ylim=(len(ordered) - 0.4, -0.6), xlabel="score in the closed loop")
        axes.set_yticks(range(len(ordered)), [model_style(group)[0] for group, _ in ordered])
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        axes.grid(visible=False, axis="y")

    seeds = max(map(len, evaluation.models.values()))
    dots = "a dot for each seed, the number is their median" if seeds > 1 else "one seed of each"
    caption = (
        "Left: the way from above over the whole script, beside that of a character that would follow every command at "
        f"once; later errors are also those of headings before. Right: scores under the test script, {dots}. "
        f"{score_words(evaluation.own.closed_loop)}"
    )
    panels = (
        panel("loop-paths", "The way of each model from above, and that of the commands", paths, size=(4.6, 4.4)),
        panel("loop-scores", "Scores of all models in the closed loop", scores, size=(4.6, 4.4)),
    )
    return Figure(caption, panels)


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


def _shade(axes: Axes, script: Script | None) -> None:
    if script is None:
        return
    changes = np.flatnonzero(np.diff(script.segment, prepend=-1))
    for begin, end in zip(changes, np.append(changes[1:], len(script)), strict=True):
        kind = script.segments[script.segment[begin]].kind
        axes.axvspan(begin / FRAME_RATE, end / FRAME_RATE, color=_SHADES[kind], zorder=0, linewidth=0)
        axes.axvline(begin / FRAME_RATE, color=FAINT, linewidth=0.3, zorder=0)
