"""What a learned environment is told from outside: reward and end of a step, and exogenous inputs, as functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.simulators.rewards import NOBODY, LearnedTask


@dataclass(frozen=True)
class Told:
    """A function of the user's."""

    name: str
    """What it is called in `info` and in errors: `module:function`."""
    call: Callable[..., Any]


def told(given: Callable[..., Any] | str, what: str) -> Told:
    """Return a function that is given as itself or as `module:function`.

    Args:
        given: the function.
        what: what it says, for errors.

    Raises:
        ModelError: there is no such function.
    """
    if callable(given):
        home = getattr(given, "__module__", type(given).__module__)
        return Told(f"{home}:{getattr(given, '__qualname__', type(given).__qualname__)}", given)
    if not isinstance(given, str) or given.count(":") != 1:
        message = f"{what} should be a function, or its name as 'module:function', but is {given!r}"
        raise ModelError(message)
    module, _, name = given.partition(":")
    try:
        function = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        message = f"{what}: there is no function '{given}' ({error})"
        raise ModelError(message) from error
    if not callable(function):
        message = f"{what}: '{given}' is no function, but a {type(function).__name__}"
        raise ModelError(message)
    return Told(given, function)


def sources(task: Told | LearnedTask | None) -> tuple[str, str]:
    """Return who says reward and end, by name."""
    if isinstance(task, LearnedTask):
        return task.sources
    return (NOBODY, NOBODY) if task is None else (task.name, task.name)


def reward_and_end(
    task: Told | LearnedTask | None,
    state: Float32[np.ndarray, "copy observation"],
    action: np.ndarray,
    next_state: Float32[np.ndarray, "copy observation"],
    exogenous: Float32[np.ndarray, "copy exogenous"],
) -> tuple[Float64[np.ndarray, " copy"], Bool[np.ndarray, " copy"]]:
    """Return rewards, and which steps end an episode inside the task; zeros and none if nobody says.

    Raises:
        ModelError: the function raises, answers in another form, or with a reward that is not finite.
    """
    number = len(state)
    if task is None:
        return np.zeros(number), np.zeros(number, bool)
    if isinstance(task, LearnedTask):
        return task(state, action, next_state, exogenous)
    found = _called(task, "reward function", state.copy(), action.copy(), next_state.copy())
    if not isinstance(found, tuple) or len(found) != 2:
        message = f"the reward function '{task.name}' should return (reward, terminated), but returned {found!r:.80}"
        raise ModelError(message)
    reward = _numbers(task, "reward function", "rewards", found[0], (number,))
    ends = np.asarray(found[1])
    if ends.dtype != np.bool_ or ends.shape not in ((), (number,)):
        message = (
            f"the reward function '{task.name}' should say in {number} booleans which steps end an episode, but said "
            f"so in {ends.dtype} of shape {ends.shape}"
        )
        raise ModelError(message)
    return reward.astype(np.float64), np.array(np.broadcast_to(ends, number))


def exogenous_at(function: Told, step: Int64[np.ndarray, " copy"], width: int) -> Float32[np.ndarray, "copy exogenous"]:
    """Return the exogenous inputs during steps.

    Raises:
        ModelError: the function raises, or answers in another form or with numbers that are not finite.
    """
    found = _called(function, "function of exogenous inputs", step.copy())
    return _numbers(function, "function of exogenous inputs", "values", found, (len(step), width)).astype(np.float32)


def _called(function: Told, what: str, *arguments: np.ndarray) -> Any:
    try:
        return function.call(*arguments)
    except Exception as error:
        reason = str(error).split("\n", maxsplit=1)[0]
        message = f"the {what} '{function.name}' raised {type(error).__name__}: {reason}"
        raise ModelError(message) from error


def _numbers(function: Told, what: str, values: str, found: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return finite numbers of a shape, or of one that is the same for all copies."""
    try:
        numbers = np.asarray(found, np.float64)
    except (TypeError, ValueError) as error:
        message = f"the {what} '{function.name}' should return {values} that are numbers, but {error}"
        raise ModelError(message) from error
    if numbers.shape not in (shape, shape[1:]):
        message = (
            f"the {what} '{function.name}' should return {values} of shape {shape}, one row a copy, but they have "
            f"{numbers.shape}"
        )
        raise ModelError(message)
    whole = np.array(np.broadcast_to(numbers, shape))
    if not np.isfinite(whole).all():
        copy = int(np.argwhere(~np.isfinite(whole))[0][0])
        message = f"the {what} '{function.name}' returned {values} that are not finite: {whole[copy]} for copy {copy}"
        raise ModelError(message)
    return whole
