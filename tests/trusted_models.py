"""A model whose errors are known: a straight line through noisy data, with a second one from other noise."""

from functools import cache
from pathlib import Path

import numpy as np
import torch
from learning import drive

from addressed_dynamics.base.files import write_json
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, SpaceSpec, Transitions
from addressed_dynamics.evaluation.transitions.calibration import calibrate
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.networks.files import SavedNetwork, save_network
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.calibrated import Calibrated, write_trust
from addressed_dynamics.simulators.delivery import Delivered, Origin, write_delivered
from addressed_dynamics.simulators.trust import Trust, save_trust
from addressed_dynamics.sources.transitions.params import FeatureParams

NOISE = 0.1
"""Standard deviation of what no model can know, in both dimensions."""
SPACES = SpaceSpec(
    observation=(Dimension("position", "m", -np.inf, np.inf), Dimension("speed", "m/s", -np.inf, np.inf)),
    action=ContinuousAction((Dimension("thrust", "N", -1.0, 1.0),)),
    step_seconds=0.1,
)


def drifting(episodes: int, seed: int, *, length: int = 40, gain: float = 0.5, scale: float = 1.0) -> Transitions:
    """Episodes of x' = 0.9 x + gain u + noise in both dimensions, from starts of a standard deviation of `scale`."""
    generator = np.random.default_rng(seed)
    states = np.empty((episodes, length + 1, 2), np.float32)
    thrust = generator.uniform(-1.0, 1.0, (episodes, length, 1)).astype(np.float32)
    states[:, 0] = scale * generator.standard_normal((episodes, 2))
    for step in range(length):
        noise = NOISE * generator.standard_normal((episodes, 2))
        states[:, step + 1] = 0.9 * states[:, step] + gain * thrust[:, step] + noise
    rows = episodes * length
    last = np.tile(np.arange(length) == length - 1, episodes)
    return Transitions(
        spec=SPACES,
        episode=np.repeat(np.arange(episodes), length),
        step=np.tile(np.arange(length, dtype=np.int32), episodes),
        time_ns=np.arange(rows, dtype=np.int64) * 100_000_000,
        observation=states[:, :-1].reshape(rows, 2),
        action=thrust.reshape(rows, 1),
        reward=np.zeros(rows, np.float32),
        next_observation=states[:, 1:].reshape(rows, 2),
        terminated=np.zeros(rows, bool),
        truncated=last,
    )


def linear_pair(
    features: FeatureSpec, train: Transitions, validation: Transitions, steps: int
) -> tuple[AddressedDynamics, AddressedDynamics, Trust]:
    """Return the lines through either half of the episodes, and what was calibrated for rollouts of so many steps."""
    half = train.episode < len(np.unique(train.episode)) // 2
    model, partner = linear_model(features, train.select(half)), linear_model(features, train.select(~half))
    trust = calibrate(model, partner, Points.of(train, features), Points.of(validation, features), steps=steps)
    return model, partner, trust


def linear_model(features: FeatureSpec, data: Transitions) -> AddressedDynamics:
    """Return the least-squares line through some transitions as a model."""
    points = Points.of(data, features)
    x = points.x(features).double()
    y = features.encode_target(torch.from_numpy(points.observation), torch.from_numpy(points.next_observation)).double()
    solution = torch.linalg.lstsq(torch.cat([x, torch.ones(len(x), 1).double()], dim=1), y).solution.float()
    network = StackedMLP(1, (features.inputs, features.outputs), "relu").requires_grad_(requires_grad=False)
    network.weights[0].copy_(solution[:-1].unsqueeze(0))
    network.biases[0].copy_(solution[-1].view(1, 1, -1))
    return AddressedDynamics(features, network)


@cache
def trusted_model(history: int = 1) -> tuple[AddressedDynamics, AddressedDynamics, Trust]:
    """Return a model, the second one and what was calibrated on validation episodes."""
    train, validation = drifting(80, 0), drifting(40, 1)
    features = fit_features(train, FeatureParams(history=history))
    model, partner, trust = linear_pair(features, train, validation, steps=30)
    return AddressedDynamics(features, model.ensemble, trust=trust), partner, trust


def write_models(folder: Path) -> Path:
    """Write two models and the trust in one of them."""
    return write_pair(folder, *trusted_model())


def write_mountaincar(root: Path) -> tuple[Path, Transitions]:
    """Write two models of a car to where a pipeline in `root` has MountainCar's; return that and what they learned."""
    train, validation = drive((30,) * 12), drive((30,) * 8, seed=1)
    pair = linear_pair(fit_features(train, FeatureParams()), train, validation, steps=10)
    folder = write_pair(root / "data" / "models" / "mountaincar", *pair)
    write_delivered(folder, Delivered(0, None, "argmax", candidate="total_parameters"))
    return folder, train


def write_pair(folder: Path, model: AddressedDynamics, partner: AddressedDynamics, trust: Trust) -> Path:
    """Write two models, and the trust in the first."""
    keys = ["total_parameters/seed-0", "total_parameters/seed-1"]
    for key, each in zip(keys, (model, partner), strict=True):
        save_network(folder / "baselines" / key / "network", SavedNetwork(each.ensemble, each.features, {}))
    write_json(folder / "baselines" / "baselines.json", {"format": 1, "trained": keys, "pair": []})
    second = {"candidate": "total_parameters", "seed": 1, "variant": None, "mode": None}
    write_trust(
        folder,
        [Calibrated(Origin("total_parameters", 0), "argmax", lambda place: save_trust(place, trust, second))],
        None,
    )
    return folder
