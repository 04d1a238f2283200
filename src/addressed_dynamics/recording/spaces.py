"""What the numbers of a Gymnasium environment mean: its spaces as a `SpaceSpec`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete

from addressed_dynamics.base.errors import SpaceError
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, DiscreteAction, SpaceSpec

METADATA_KEY = "addressed_dynamics"
"""Key of an environment's metadata that holds its description, in the form that `addressed_dynamics.envs` explains."""

_HOPPER: dict[str, Any] = {
    "observation": (
        ("height", "m"),
        ("torso_angle", "rad"),
        ("thigh_angle", "rad"),
        ("leg_angle", "rad"),
        ("foot_angle", "rad"),
        ("forward_velocity", "m/s"),
        ("vertical_velocity", "m/s"),
        ("torso_velocity", "rad/s"),
        ("thigh_velocity", "rad/s"),
        ("leg_velocity", "rad/s"),
        ("foot_velocity", "rad/s"),
    ),
    # In units of the greatest torque, 200 N m.
    "action": (("thigh_torque", ""), ("leg_torque", ""), ("foot_torque", "")),
}

# Gymnasium's own environments do not name their dimensions. Acrobot and Pendulum render at another rate than they step.
_KNOWN: dict[str, dict[str, Any]] = {
    "MountainCar-v0": {
        "observation": (("position", "m"), ("velocity", "m/step")),
        "action": ("push_left", "no_push", "push_right"),
    },
    "MountainCarContinuous-v0": {
        "observation": (("position", "m"), ("velocity", "m/step")),
        "action": (("force", ""),),
    },
    "Acrobot-v1": {
        "observation": (
            ("cos_angle_1", ""),
            ("sin_angle_1", ""),
            ("cos_angle_2", ""),
            ("sin_angle_2", ""),
            ("velocity_1", "rad/s"),
            ("velocity_2", "rad/s"),
        ),
        "action": ("torque_negative", "no_torque", "torque_positive"),
        "step_seconds": 0.2,
    },
    "CartPole-v1": {
        "observation": (
            ("position", "m"),
            ("velocity", "m/s"),
            ("angle", "rad"),
            ("angular_velocity", "rad/s"),
        ),
        "action": ("push_left", "push_right"),
    },
    "Pendulum-v1": {
        "observation": (("cos_angle", ""), ("sin_angle", ""), ("angular_velocity", "rad/s")),
        "action": (("torque", "N m"),),
        "step_seconds": 0.05,
    },
    "Hopper-v4": _HOPPER,
    "Hopper-v5": _HOPPER,
}


def space_spec(env: gymnasium.Env[Any, Any]) -> SpaceSpec:
    """Return names, units and bounds of an environment's observations and actions, and the length of its step.

    Names and units come from `env.metadata["addressed_dynamics"]`, else from a table of Gymnasium's environments, else
    they are `observation_0`, `action_0` and so on. Arrays are flattened row by row. The step is taken from the same
    places, else from the metadata's `render_fps`, else it is one second.

    Raises:
        SpaceError: a space is of a kind that cannot be recorded, or the description does not fit it.
    """
    name = environment_name(env)
    described: Mapping[str, Any] = env.metadata.get(METADATA_KEY) or _KNOWN.get(name, {})
    frames_per_second = env.metadata.get("render_fps")
    step_seconds = described.get("step_seconds") or (1 / frames_per_second if frames_per_second else 1.0)
    observation = env.observation_space
    if not isinstance(observation, Box) or not _is_exact_in_float32(observation.dtype):
        message = f"{name}: observations should be a Box of floats or small integers, but their space is {observation}"
        raise SpaceError(message)
    return SpaceSpec(
        observation=_dimensions(name, "observation", observation, described.get("observation")),
        action=_action(name, env.action_space, described.get("action")),
        step_seconds=float(step_seconds),
    )


def check_single(env: Any) -> None:
    """Refuse what is not one environment.

    Raises:
        SpaceError: it is several of them, or something else.
    """
    if isinstance(env, gymnasium.vector.VectorEnv):
        message = (
            f"{type(env).__name__}: a recorder records one environment, but this is a vector of {env.num_envs}; wrap "
            "each of them: SyncVectorEnv([lambda: TransitionRecorder(make(...), path_0), …]), with a file for each"
        )
        raise SpaceError(message)
    if not isinstance(env, gymnasium.Env):
        message = f"a recorder records a gymnasium.Env, but this is a {type(env).__name__}; give an environment"
        raise SpaceError(message)


def environment_name(env: gymnasium.Env[Any, Any]) -> str:
    """Return the environment's Gymnasium identifier, or the name of its class if it has none."""
    return env.spec.id if env.spec is not None else type(env.unwrapped).__name__


def _is_exact_in_float32(dtype: np.dtype[Any]) -> bool:
    # float64 is rounded, as it is for every network; a large integer could be a count or an index and must not be.
    return dtype.kind == "f" or (dtype.kind in "iub" and dtype.itemsize <= 2)


def _action(
    name: str, space: gymnasium.Space[Any], described: Sequence[Any] | None
) -> DiscreteAction | ContinuousAction:
    if isinstance(space, Discrete) and space.start == 0:
        names = tuple(described or (f"action_{i}" for i in range(int(space.n))))
        _check_count(name, "action", len(names), int(space.n))
        return DiscreteAction(names)
    if isinstance(space, Box) and space.dtype.kind == "f":
        return ContinuousAction(_dimensions(name, "action", space, described))
    message = f"{name}: actions should be Discrete from 0 or a Box of floats, but their space is {space}"
    raise SpaceError(message)


def _dimensions(name: str, kind: str, space: Box, described: Sequence[tuple[str, str]] | None) -> tuple[Dimension, ...]:
    low, high = space.low.reshape(-1).tolist(), space.high.reshape(-1).tolist()
    labels = described or [(f"{kind}_{i}", "") for i in range(len(low))]
    _check_count(name, kind, len(labels), len(low))
    return tuple(
        Dimension(name=label, unit=unit, low=float(lowest), high=float(highest))
        for (label, unit), lowest, highest in zip(labels, low, high, strict=True)
    )


def _check_count(name: str, kind: str, described: int, actual: int) -> None:
    if described != actual:
        message = (
            f"{name}: metadata['{METADATA_KEY}']['{kind}'] describes {described} components, "
            f"but the {kind} space has {actual}; make them agree"
        )
        raise SpaceError(message)
