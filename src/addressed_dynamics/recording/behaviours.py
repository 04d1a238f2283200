"""Who acts in a segment of a recording plan, if it does not learn: policies for several environment copies at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import Env, Space, spaces
from jaxtyping import Float, Shaped

from addressed_dynamics.base.errors import RecordingError
from addressed_dynamics.base.params.recording import ConstantBehaviour, RandomBehaviour, SignBehaviour
from addressed_dynamics.recording.spaces import space_spec

Observations = Float[np.ndarray, "copy observation"]
Actions = Shaped[np.ndarray, "copy ..."]
Policy = Callable[[Observations], Actions]
"""From the observations of all copies to their actions."""


class HeldActions:
    """Random actions that each copy holds for a random number of steps.

    Holding is what makes random actions explore: 200 steps of MountainCar with a new random action every step never
    reach the goal; with actions held for 20 steps, one episode in eleven does (temporally extended exploration, see
    Dabney, Ostrovski and Barreto, ICLR 2021).

    Args:
        space: the space to draw from, uniformly; discrete, or a box with finite bounds.
        copies: number of environment copies.
        mean_hold_steps: mean of the geometric distribution of holding times, in steps.
        generator: source of the random numbers.

    Raises:
        RecordingError: nothing can be drawn uniformly from `space`.
    """

    def __init__(self, space: Space[Any], copies: int, mean_hold_steps: float, generator: np.random.Generator) -> None:
        self._draw = _uniform(space, copies, generator)
        self._mean_hold_steps = mean_hold_steps
        self._generator = generator
        self._held = self._draw()
        self._steps_left = np.zeros(copies, dtype=np.int64)

    def replace(self, actions: Actions, share: float) -> Actions:
        """Replace the actions of the copies that act at random in this step.

        Args:
            actions: what the copies would do by themselves.
            share: expected share of steps that are random, in 0..1.
        """
        # A copy that is free begins a hold of h steps with this probability, so that a share of all its steps is held.
        begin = share / (share + self._mean_hold_steps * (1.0 - share))
        copies = len(self._steps_left)
        beginning = (self._steps_left == 0) & (self._generator.random(copies) < begin)
        durations = self._generator.geometric(1.0 / self._mean_hold_steps, copies)
        drawn = self._draw()
        self._held[beginning] = drawn[beginning]
        self._steps_left = np.where(beginning, durations, self._steps_left)
        holding = self._steps_left > 0
        self._steps_left = np.maximum(self._steps_left - 1, 0)
        replaced = actions.copy()
        replaced[holding] = self._held[holding]
        return replaced


def random_policy(space: Space[Any], copies: int, mean_hold_steps: float, generator: np.random.Generator) -> Policy:
    """Return the policy of `HeldActions` at every step.

    Raises:
        RecordingError: nothing can be drawn uniformly from `space`.
    """
    random = HeldActions(space, copies, mean_hold_steps, generator)
    nothing = np.repeat(np.asarray(space.sample())[None], copies, axis=0)
    return lambda _: random.replace(nothing, share=1.0)


def constant_policy(space: Space[Any], copies: int, action: int | tuple[float, ...]) -> Policy:
    """Return the policy that takes `action` at every step.

    Raises:
        RecordingError: `action` is not in `space`.
    """
    actions = np.repeat(_value(space, action, "a constant action")[None], copies, axis=0)
    return lambda _: actions


def sign_policy(
    space: Space[Any], place: int, negative: int | tuple[float, ...], positive: int | tuple[float, ...]
) -> Policy:
    """Return the policy that takes `negative` where a component of the observation is below 0, else `positive`.

    Args:
        space: the space of the actions.
        place: number of the component, in the flattened observation.
        negative: an action.
        positive: an action.

    Raises:
        RecordingError: an action is not in `space`.
    """
    given = {"negative": negative, "positive": positive}
    actions = np.stack([_value(space, action, f"the action '{name}'") for name, action in given.items()])
    return lambda observations: actions[(observations.reshape(len(observations), -1)[:, place] >= 0).astype(np.intp)]


def unlearned_policy(
    behaviour: RandomBehaviour | ConstantBehaviour | SignBehaviour,
    environment: Env[Any, Any],
    copies: int,
    generator: np.random.Generator,
) -> Policy:
    """Return the policy that a section of a params file describes, for so many copies of an environment.

    Raises:
        RecordingError: the environment has no such actions, nothing can be drawn uniformly from them, or its
            observation has no dimension of the given name.
        SpaceError: the environment has spaces that cannot be recorded.
    """
    space = environment.action_space
    match behaviour:
        case RandomBehaviour(mean_hold_steps=mean_hold_steps):
            return random_policy(space, copies, mean_hold_steps, generator)
        case ConstantBehaviour(action=action):
            return constant_policy(space, copies, action)
        case SignBehaviour(dimension=dimension, negative=negative, positive=positive):
            names = space_spec(environment).observation_names
            if dimension not in names:
                message = f"expected 'dimension' to be one of {', '.join(names)}, found '{dimension}'"
                raise RecordingError(message)
            return sign_policy(space, names.index(dimension), negative, positive)


def _value(space: Space[Any], action: int | tuple[float, ...], what: str) -> Shaped[np.ndarray, ...]:
    """Return the given action as an array of the space."""
    value = np.asarray(action, dtype=space.dtype)
    if not space.contains(value.item() if isinstance(space, spaces.Discrete) and value.ndim == 0 else value):
        message = f"expected {what} in {space}, found {action}; change it in the params file"
        raise RecordingError(message)
    return value


def mostly(policy: Policy, random: HeldActions, share: float) -> Policy:
    """Return `policy` with a share of its actions replaced by random ones."""
    return lambda observations: random.replace(policy(observations), share)


def _uniform(space: Space[Any], copies: int, generator: np.random.Generator) -> Callable[[], Actions]:
    match space:
        case spaces.Discrete():
            first, count = int(space.start), int(space.n)
            return lambda: generator.integers(first, first + count, copies)
        case spaces.Box() if space.is_bounded("both"):
            low, high, dtype = space.low, space.high, space.dtype
            return lambda: generator.uniform(low, high, (copies, *low.shape)).astype(dtype)
        case _:
            message = f"random actions need a discrete or a bounded action space, but the environment has {space}"
            raise RecordingError(message)
