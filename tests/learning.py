"""What tests of models and training share: a small world with a wall in it, its samples, small params and models."""

from collections.abc import Sequence

import numpy as np
import torch
from builders import CAR

from addressed_dynamics.base.params.sections import OptimiserParams
from addressed_dynamics.base.params.training import AddressingTraining, EnsembleParams
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, DiscreteAction, SpaceSpec, Transitions
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.sources.transitions.params import FeatureParams

ARM = SpaceSpec(
    observation=(Dimension("angle", "rad", -np.inf, np.inf), Dimension("speed", "rad/s", -8.0, 8.0)),
    action=ContinuousAction((Dimension("torque", "N m", -2.0, 2.0), Dimension("brake", "", 0.0, 1.0))),
    step_seconds=0.05,
)
"""A world with an unbounded dimension and continuous actions."""
BOAT = SpaceSpec(
    observation=(Dimension("position", "m", -np.inf, np.inf), Dimension("speed", "m/s", -np.inf, np.inf)),
    action=ContinuousAction((Dimension("thrust", "N", -1.0, 1.0),)),
    step_seconds=0.1,
    exogenous=(Dimension("wind", "m/s", -2.0, 2.0),),
)
"""A world with an exogenous input."""

CHANGE = FeatureParams(target="change")
OPTIMISER = OptimiserParams(learning_rate=1e-2, betas=(0.9, 0.99), final_share=0.1)
ENSEMBLE = EnsembleParams(
    seeds=(0,), members=2, hidden=(16, 16), activation="relu", loss="mse", optimiser=OPTIMISER, batch_size=8, epochs=6,
    cluster_epochs=4,
)  # fmt: skip
ADDRESSING = AddressingTraining(
    hidden=(16,), heads=(), activation="relu", optimiser=OPTIMISER, batch_size=8, epochs=5, tie_share=0.5
)


def drive(lengths: Sequence[int] = (40, 60, 50), seed: int = 0) -> Transitions:
    """Episodes of a car on MountainCar's track under random pushes, which often meets the left wall."""
    generator = np.random.default_rng(seed)
    actions = generator.integers(0, 3, sum(lengths))
    before, after = np.empty((2, sum(lengths), 2), dtype=np.float32)
    ends = np.cumsum(lengths) - 1
    for row in range(sum(lengths)):
        if row == 0 or row - 1 in ends:
            state = np.array([generator.uniform(-1.2, 0.5), generator.uniform(-0.07, 0.07)], dtype=np.float32)
        before[row] = state
        velocity = np.clip(state[1] + (actions[row] - 1) * 0.001 - np.cos(3 * state[0]) * 0.0025, -0.07, 0.07)
        position = np.clip(state[0] + velocity, -1.2, 0.6)
        state = np.array([position, 0.0 if position <= -1.2 else velocity], dtype=np.float32)
        after[row] = state
    return _transitions(CAR, lengths, before, actions, after)


def swing(lengths: Sequence[int] = (30, 20), seed: int = 0) -> Transitions:
    """Episodes of random numbers in the world with continuous actions."""
    generator = np.random.default_rng(seed)
    total = sum(lengths)
    states = generator.standard_normal((total + 1, 2)).astype(np.float32)
    actions = generator.uniform(-2.0, 2.0, (total, 2)).astype(np.float32)
    return _transitions(ARM, lengths, states[:-1], actions, states[1:])


def sail(lengths: Sequence[int] = (30, 20), seed: int = 0) -> Transitions:
    """Episodes of a boat under random thrust in a wind that is another in every step: without it, a riddle."""
    generator = np.random.default_rng(seed)
    total = sum(lengths)
    thrust, wind = generator.uniform(-1.0, 1.0, (2, total, 1)).astype(np.float32) * np.float32([[[1.0]], [[2.0]]])
    before, after = np.empty((2, total, 2), dtype=np.float32)
    starts = {0, *np.cumsum(lengths)[:-1].tolist()}
    for row in range(total):
        if row in starts:
            state = generator.uniform(-1.0, 1.0, 2).astype(np.float32)
        before[row] = state
        speed = 0.9 * state[1] + 0.1 * thrust[row, 0] + 0.3 * wind[row, 0]
        state = np.array([state[0] + 0.1 * speed, speed], dtype=np.float32)
        after[row] = state
    return _transitions(BOAT, lengths, before, thrust, after, wind)


def car_samples() -> tuple[FeatureSpec, Samples, Samples]:
    """Features of the car, and its samples to train on and to validate with."""
    train = drive((20,) * 10)
    features = fit_features(train, CHANGE)
    return features, features.samples(train), features.samples(drive((15,) * 4, seed=1))


def untrained_model(
    world: Transitions, members: int = 3, *, seed: int = 0, target: str = "change", history: int = 1
) -> AddressedDynamics:
    """A model of random networks that fits `world`."""
    features = fit_features(world, FeatureParams.model_validate({"target": target, "history": history}))
    generator = torch.Generator().manual_seed(seed)
    ensemble = StackedMLP(members, (features.inputs, 16, 8, features.outputs), "tanh", generator)
    addressing = StackedMLP(1, (features.inputs, 12, members), "relu", generator) if members > 1 else None
    for network in (ensemble, addressing):
        if network is not None:
            network.requires_grad_(False)
    return AddressedDynamics(features, ensemble, addressing)


def _transitions(
    spec: SpaceSpec,
    lengths: Sequence[int],
    before: np.ndarray,
    actions: np.ndarray,
    after: np.ndarray,
    exogenous: np.ndarray | None = None,
) -> Transitions:
    total, ends = sum(lengths), np.cumsum(lengths) - 1
    truncated = np.zeros(total, dtype=bool)
    truncated[ends] = True
    return Transitions(
        spec=spec,
        episode=np.repeat(np.arange(len(lengths)), lengths),
        step=np.concatenate([np.arange(length, dtype=np.int32) for length in lengths]),
        time_ns=np.round(np.arange(total) * spec.step_seconds * 1e9).astype(np.int64),
        observation=before,
        action=actions if isinstance(spec.action, DiscreteAction) else actions.astype(np.float32),
        reward=np.full(total, -1.0, dtype=np.float32),
        next_observation=after,
        terminated=np.zeros(total, dtype=bool),
        truncated=truncated,
        exogenous=np.empty((total, 0), dtype=np.float32) if exogenous is None else exogenous,
    )
