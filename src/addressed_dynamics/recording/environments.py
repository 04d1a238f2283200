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
        RecordingError: Gymnasium does not know the identifier, or the environment refuses the arguments.
    """
    try:
        return gymnasium.make(params.id, **params.kwargs)
    except (gymnasium.error.Error, TypeError, ValueError) as error:
        reason = str(error).split("\n", maxsplit=1)[0]
        message = f"the environment '{params.id}' cannot be made with {params.kwargs}: {reason}"
        raise RecordingError(message) from error
