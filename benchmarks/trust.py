"""What trust costs: intervals, trust and a rollout with both, against the same without."""

import numpy as np
import torch
from measuring import median_ratio, print_table, take_turns

from addressed_dynamics.base.torch_runtime import prepare_torch
from addressed_dynamics.episodes.transitions import Dimension, DiscreteAction, SpaceSpec, Transitions
from addressed_dynamics.evaluation.transitions.calibration import calibrate
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.sources.transitions.params import FeatureParams

ROUNDS = 15
TARGET = 3.0
"""Times the cost of `predict` that trust may take."""
SPACES = SpaceSpec(
    observation=(Dimension("position", "m", -1.2, 0.6), Dimension("velocity", "m/s", -0.07, 0.07)),
    action=DiscreteAction(("left", "none", "right")),
    step_seconds=1 / 30,
)


def transitions(episodes: int, seed: int, *, length: int = 100) -> Transitions:
    """Return states as MountainCar has them, in random order: what a model costs does not depend on them."""
    generator, rows = np.random.default_rng(seed), episodes * length
    states = generator.uniform([-1.2, -0.07], [0.6, 0.07], (rows + 1, 2)).astype(np.float32)
    return Transitions(
        spec=SPACES,
        episode=np.repeat(np.arange(episodes), length),
        step=np.tile(np.arange(length, dtype=np.int32), episodes),
        time_ns=np.arange(rows, dtype=np.int64) * 33_333_333,
        observation=states[:-1],
        action=generator.integers(0, 3, rows),
        reward=np.zeros(rows, np.float32),
        next_observation=states[1:],
        terminated=np.zeros(rows, bool),
        truncated=np.tile(np.arange(length) == length - 1, episodes),
    )


def network(features: FeatureSpec, seed: int) -> AddressedDynamics:
    """Return an ensemble as MountainCar's at the quick scale, untrained."""
    generator = torch.Generator().manual_seed(seed)
    ensemble = StackedMLP(2, (features.inputs, 128, 128, features.outputs), "relu", generator)
    addressing = StackedMLP(1, (features.inputs, 128, 128, 64, 2), "relu", generator)
    for each in (ensemble, addressing):
        each.requires_grad_(requires_grad=False)
    return AddressedDynamics(features, ensemble, addressing)


def main() -> None:
    """Print times and ratios for batches of several sizes."""
    prepare_torch(threads=1)
    train, validation = transitions(200, 0), transitions(20, 1)
    features = fit_features(train, FeatureParams())
    model, partner = network(features, 0), network(features, 1)
    trust = calibrate(model, partner, Points.of(train, features), Points.of(validation, features), steps=50)
    trusted = AddressedDynamics(features, model.ensemble, model.addressing, trust=trust)
    rows = []
    for batch in (1, 64, 1024):
        state, action = train.observation[:batch], train.action[:batch]
        plan = np.ones((batch, 20), dtype=np.int64)
        contestants = {
            "predict": lambda state=state, action=action: trusted.predict(state, action),
            "trust": lambda state=state, action=action: trusted.trust(state, action),
            "interval": lambda state=state, action=action: trusted.interval(state, action),
            "rollout of 20": lambda state=state, plan=plan: trusted.rollout(state, plan),
            "with trust": lambda state=state, plan=plan: trusted.rollout(state, plan, with_trust=True),
        }
        readings = take_turns(contestants, rounds=ROUNDS, calls=max(2, 200 // batch))
        for name, floor in (("trust", "predict"), ("interval", "predict"), ("with trust", "rollout of 20")):
            ratio = median_ratio(readings[name].wall, readings[floor].wall)
            times = [f"{1e6 * min(readings[each].wall):,.0f} us" for each in (floor, name)]
            rows.append([f"{name}, B = {batch:,}", *times, f"{ratio:.2f}", f"{TARGET:g}"])
    print_table(["with trust", "without", "with", "ratio", "at most"], rows)


if __name__ == "__main__":
    main()
