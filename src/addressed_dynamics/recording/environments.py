"""Environments, made as a params file says."""

from __future__ import annotations

from typing import Any

import gymnasium

import addressed_dynamics.envs  # noqa: F401 # registers the paper's environments
from addressed_dynamics.base.errors import RecordingError
from addressed_dynamics.base.params.recording import EnvironmentParams

Environment = gymnasium.Env[Any, Any]


def make_environment(params: EnvironmentParams) -> Environment:
    """Make the environment that `params` describe.

    Raises:
        RecordingError: Gymnasium does not know the identifier, the environment refuses the arguments, or a package is
            not installed that it needs.
    """
    try:
        return gymnasium.make(params.id, **params.kwargs)
    except gymnasium.error.DependencyNotInstalled as error:
        message = f"the environment '{params.id}' needs a package that is not installed ({error})"
        if "mujoco" in str(error).lower():
            message = f"the environment '{params.id}' needs MuJoCo: pip install 'addressed-dynamics[mujoco]'"
        raise RecordingError(message) from error
    except (gymnasium.error.Error, TypeError, ValueError) as error:
        reason = str(error).split("\n", maxsplit=1)[0]
        message = f"the environment '{params.id}' cannot be made with {params.kwargs}: {reason}"
        raise RecordingError(message) from error
