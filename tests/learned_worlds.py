"""Models to make environments of, with where to start in them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import VectorEnv
from learning import drive, sail, swing, untrained_model

import addressed_dynamics.envs
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.evaluation.transitions.starting import starts_of
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.modes import Mode
from addressed_dynamics.simulators.starts import Starts

LEARNED = addressed_dynamics.envs.LEARNED
WORLDS: dict[str, Callable[..., Transitions]] = {"car": drive, "arm": swing, "boat": sail}


@dataclass(frozen=True)
class Learned:
    """A model of random networks, and what it was made of."""

    train: Transitions
    model: AddressedDynamics
    starts: Starts

    @property
    def options(self) -> dict[str, Any]:
        """What an environment of it is made with."""
        return {"model": self.model, "starts": self.starts}


@cache
def learned(world: str, history: int = 1, mode: Mode = "argmax") -> Learned:
    train = WORLDS[world]((30, 20, 12))
    made = untrained_model(train, history=history)
    model = AddressedDynamics(made.features, made.ensemble, made.addressing, mode=mode)
    return Learned(train, model, starts_of(train, history))


def single(of: Learned, **options: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(LEARNED, **of.options, **options)


def many(of: Learned, number: int, **options: Any) -> VectorEnv[Any, Any, Any]:
    return gymnasium.make_vec(
        LEARNED, num_envs=number, vectorization_mode="vector_entry_point", **of.options, **options
    )


def ends_at(state: np.ndarray) -> np.ndarray:
    """An end that comes now and then in every world."""
    return np.sin(200.0 * state.sum(axis=1)) > 0.9


def far_out(state: np.ndarray, action: np.ndarray, next_state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A reward that depends on all three, and an end that comes now and then."""
    pushed = action if action.ndim == 1 else action.sum(axis=1)
    return state[:, 1] + 0.1 * pushed - next_state[:, 0], ends_at(next_state)
