"""Simulators that planners are tried in: a double integrator, a counter with a history, a walk on integers."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float

from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, DiscreteAction, SpaceSpec
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics

STEP = 0.1
"""Seconds."""
A = np.array([[1.0, STEP], [0.0, 1.0]])
B = np.array([[STEP**2 / 2], [STEP]])
"""The double integrator: x' = A x + B u."""


def linear_simulator(
    weights: Float[np.ndarray, "input observation"],
    action: DiscreteAction | ContinuousAction,
    history: int = 1,
    exogenous: Sequence[Dimension] = (),
) -> AddressedDynamics:
    """Return a model whose next state is the inputs (states, actions, exogenous; frame by frame) times `weights`."""
    inputs, states = weights.shape
    frame = inputs // history
    names = tuple(Dimension(f"x{index}", "m", -np.inf, np.inf) for index in range(states))
    features = FeatureSpec(
        spaces=SpaceSpec(names, action, STEP, tuple(exogenous)),
        history=history,
        history_weight=1.0,
        target="absolute",
        angles=(),
        angle_from="atan2",
        velocity="predicted",
        input_mean=(0.0,) * frame,
        input_deviation=(1.0,) * frame,
        scale=(1.0,) * states,
        target_mean=(0.0,) * states,
        target_deviation=1.0,
    )
    network = StackedMLP(1, (inputs, states), "relu").requires_grad_(requires_grad=False)
    network.weights[0].copy_(torch.from_numpy(weights)[None])
    return AddressedDynamics(features, network)


def double_integrator(low: float = -3.0, high: float = 3.0) -> AddressedDynamics:
    """Return a mass on a line: position and speed, pushed by an acceleration within bounds."""
    push = ContinuousAction((Dimension("push", "m/s²", low, high),))
    return linear_simulator(np.concatenate([A.T, B.T]), push)


def walk(moves: Sequence[float]) -> AddressedDynamics:
    """Return a walker on a line, whose discrete actions move it by so much."""
    weights = np.array([[1.0], *([move] for move in moves)])
    return linear_simulator(weights, DiscreteAction(tuple(f"move_{index}" for index in range(len(moves)))))


def delayed_walk() -> AddressedDynamics:
    """Return a walker of two frames: an action of -1, 0 or 1 moves it a step after it was taken."""
    weights = np.array([[0.0], [-1.0], [0.0], [1.0], [1.0], [0.0], [0.0], [0.0]])
    return linear_simulator(weights, DiscreteAction(("back", "stay", "on")), history=2)
