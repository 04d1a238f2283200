"""The animations of a report: those of its rollouts whose states someone can see."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from addressed_dynamics.episodes.transitions import DiscreteAction, SpaceSpec
from addressed_dynamics.reporting.common.animation.film import SECONDS, film
from addressed_dynamics.reporting.common.animation.scenes import Scene
from addressed_dynamics.reporting.common.blocks import Figure
from addressed_dynamics.reporting.transitions.animation.acrobot import ACROBOT
from addressed_dynamics.reporting.transitions.animation.mountain_car import MOUNTAIN_CAR
from addressed_dynamics.reporting.transitions.results import Arrays
from addressed_dynamics.reporting.transitions.rollout_tables import group_title

SCENES = (MOUNTAIN_CAR, ACROBOT)
"""What can be drawn."""


def animations(arrays: Arrays, spaces: SpaceSpec) -> Figure | None:
    """Draw a film of a rollout of each group; None if the states are not those of a known environment."""
    scene = scene_of(spaces)
    if scene is None or not len(arrays.rollout_true):
        return None
    columns = [spaces.observation_names.index(name) for name in scene.dimensions]
    groups, first = np.unique(arrays.rollout_group, return_index=True)
    panels = tuple(
        film(
            f"animation-{group}",
            "" if group == "all" else group_title(group),
            scene,
            arrays.rollout_true[row][:, columns].astype(np.float64),
            arrays.rollout_predicted[row][:, columns].astype(np.float64),
            _directions(arrays, row, scene),
            spaces.step_seconds,
        )
        for row, group in sorted(zip(first.tolist(), groups.tolist(), strict=True))
    )
    longest = (arrays.rollout_true.shape[1] - 1) * spaces.step_seconds
    which = f"The first {SECONDS:.0f} s of the rollouts" if longest > SECONDS else "Rollouts"
    arrow = "; an arrow shows the action, which is the same on both sides" * (arrays.rollout_actions is not None)
    caption = (
        f"{which}, as fast as they happened{arrow}. Grey is what really happened, blue what the model makes of "
        f"the first state and the actions alone; behind the blue, the truth is there again in light grey, and above "
        f"it stands {scene.error_title}."
    )
    return Figure(caption, panels)


def scene_of(spaces: SpaceSpec) -> Scene | None:
    """Return how to draw the states of `spaces`, by the names of their dimensions and actions; None if unknown."""
    known = (
        scene
        for scene in SCENES
        if set(scene.dimensions) <= set(spaces.observation_names)
        and isinstance(spaces.action, DiscreteAction)
        and spaces.action.names == scene.actions
    )
    return next(known, None)


def _directions(arrays: Arrays, row: int, scene: Scene) -> Int[np.ndarray, " step"] | None:
    """Return the actions of a rollout as -1, 0 and 1."""
    return None if arrays.rollout_actions is None else arrays.rollout_actions[row] - len(scene.actions) // 2
