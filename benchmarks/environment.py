"""What a step of 1,024 copies of a learned environment costs, against Gymnasium's of the true one."""

import gymnasium
import numpy as np
import torch
from measuring import median_ratio, print_table, take_turns
from trust import network, transitions

from addressed_dynamics.base.torch_runtime import prepare_torch
from addressed_dynamics.envs import LEARNED
from addressed_dynamics.evaluation.transitions.calibration import calibrate
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.starting import starts_of
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.sources.transitions.params import FeatureParams

COPIES = 1024
ROUNDS = 15
TARGET = 10.0
"""Times faster than the true environment that a learned one should be."""


def main() -> None:
    """Print times of a step, and how many times faster than the true environment it is."""
    prepare_torch(threads=1)
    train, validation = transitions(200, 0), transitions(20, 1)
    features = fit_features(train, FeatureParams(target="change"))
    model, partner = network(features, 0), network(features, 1)
    trust = calibrate(model, partner, Points.of(train, features), Points.of(validation, features), steps=50)
    trusted = AddressedDynamics(features, model.ensemble, model.addressing, trust=trust)
    options = {
        "learned": {"trust": False},
        "learned, with trust": {"trust": True},
        "learned, exact": {"trust": False, "exact": True},
    }
    environments = {
        name: gymnasium.make_vec(LEARNED, COPIES, model=trusted, starts=starts_of(train, 1), **each)
        for name, each in options.items()
    }
    environments["true"] = gymnasium.make_vec("MountainCar-v0", COPIES, vectorization_mode="sync")
    for each in environments.values():
        each.reset(seed=0)
    actions = np.random.default_rng(0).integers(0, 3, COPIES)
    state, taken = torch.from_numpy(train.observation[:COPIES]), torch.from_numpy(actions)
    contestants = {name: lambda each=each: each.step(actions) for name, each in environments.items()}
    contestants["the model alone"] = lambda: model.step(state, taken, None)
    readings = take_turns(contestants, rounds=ROUNDS, calls=3)
    rows = []
    for name in (*options, "the model alone"):
        ratio = median_ratio(readings["true"].cpu, readings[name].cpu)
        times = [f"{1e3 * min(readings[each].cpu):.2f} ms" for each in ("true", name)]
        rows.append([name, *times, f"{ratio:.1f}", f"{TARGET:g}" if name == "learned" else ""])
    print_table([f"a step of {COPIES:,} copies", "the true one", "this", "times faster", "at least"], rows)


if __name__ == "__main__":
    main()
