"""Ours beside PFNN as people who move: films for the report, and a scene for viewers of logs."""

from __future__ import annotations

from pathlib import Path

from addressed_dynamics.episodes.layout import FRAME_RATE
from addressed_dynamics.evaluation.motion.records import MotionEvaluation
from addressed_dynamics.reporting.common.blocks import Figure, Panel
from addressed_dynamics.reporting.motion.actors import Actor
from addressed_dynamics.reporting.motion.animation.skeleton import SECONDS, skeleton_film
from addressed_dynamics.reporting.motion.figures.closed_loop import told
from addressed_dynamics.reporting.motion.models import main_models, model_style
from addressed_dynamics.reporting.motion.results import MotionArrays
from addressed_dynamics.reporting.motion.scene_log import write_scene

WINDOWS = {"walk": (7.0, "walk, turn left, walk"), "jog": (34.5, "jog, turn left, jog")}
"""Films of the standard script by name: their first second, and what happens in them."""
APART = 1.5
"""How far apart the two are drawn in the scene, in m."""


def films(evaluation: MotionEvaluation, arrays: MotionArrays) -> Figure:
    """Draw ours beside PFNN, or beside what else there is, while they are told to walk, turn and jog."""
    own = arrays.loops[evaluation.own_name]
    windows = {"start": (0.0, "")} if told(own) is None else WINDOWS
    panels = tuple(_film(evaluation, arrays, name, *window) for name, window in windows.items())
    beside = [model_style(group)[0] for group in list(main_models(evaluation, arrays.loops))[1:2]]
    also = f", beside the same commands given to: {beside[0]}" if beside else ""
    times = " and ".join(f"{start:g} to {start + SECONDS:g} s" for start, _ in windows.values())
    caption = (
        f"The closed loop from {times} of the test script, as fast as it happened{also}. Both live on their own "
        "predictions and are drawn in the middle of a picture of their own. Orange: the command; green: feet that the "
        "model says touch the ground."
    )
    return Figure(caption, panels)


def write_motion_scene(path: Path, evaluation: MotionEvaluation, arrays: MotionArrays) -> None:
    """Write the whole closed loop of both as a scene that viewers of MCAP logs play.

    Raises:
        ReportError: a position is not finite.
    """
    actors = _actors(evaluation, arrays, 0, len(arrays.loops[evaluation.own_name].joint_position))
    write_scene(path, actors, arrays.loops[evaluation.own_name].commanded_velocity, apart=APART)


def _film(evaluation: MotionEvaluation, arrays: MotionArrays, name: str, start: float, title: str) -> Panel:
    first = round(start * FRAME_RATE)
    last = first + round(SECONDS * FRAME_RATE)
    commands = arrays.loops[evaluation.own_name].commanded_velocity[first:last]
    return skeleton_film(f"animation-{name}", title, _actors(evaluation, arrays, first, last), commands)


def _actors(evaluation: MotionEvaluation, arrays: MotionArrays, first: int, last: int) -> list[Actor]:
    shown = list(main_models(evaluation, arrays.loops).items())[:2]
    return [
        Actor(
            model_style(group)[0],
            arrays.loops[name].joint_position[first:last],
            arrays.loops[name].contact[first:last],
        )
        for group, name in shown
    ]
