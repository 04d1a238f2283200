"""A step of a learned model beside the same step in libraries for model-based learning, in turns, in one run.

`python benchmarks/peers_prediction.py [--packages FOLDER]` with torchrl (its `WorldModelWrapper`) and mbrl-lib (its
`OneDTransitionRewardModel` of a deterministic `GaussianMLP`) installed, or in a folder of packages that is searched
last; one that is not there is named and left out. All have networks of 128-128 for MountainCar: here two members and
an addressing network of 128-128-64 that chooses one, in mbrl-lib an ensemble of two of which every state keeps to one,
in torchrl one network and a linear reward, which its wrapper asks for. Weights are random: what a step costs does not
depend on them.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable

import numpy as np
import torch
from measuring import median_ratio, print_table, take_turns
from prediction import mountain_car, predict_of, products_of, some

from addressed_dynamics.base.torch_runtime import prepare_torch

ROUNDS = 40
BATCHES = (1, 64, 1024)
Step = Callable[[], object]


def main() -> None:
    """Print the microseconds of a step, and how often ours fits into each of the others."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--packages", help="folder in which packages are searched that are not installed")
    if folder := parser.parse_args().packages:
        sys.path.append(folder)
    prepare_torch(threads=1)
    model, rows, missing = mountain_car(), [], dict[str, str]()
    for batch in BATCHES:
        states, actions = some(model, batch, 1)
        contestants: dict[str, Step] = {
            "this": predict_of(model, batch),
            "matrix products of this": products_of(model, batch)["products"],
        }
        one_hot = np.eye(3, dtype=np.float32)[actions[:, 0]]
        for name, peer in {"torchrl": of_torchrl, "mbrl-lib": of_mbrl}.items():
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    contestants[name] = peer(states[:, 0], one_hot)
            except ImportError as error:
                missing[name] = str(error)
        readings = take_turns(contestants, rounds=ROUNDS, calls=max(1, 40 // batch))
        for name, each in readings.items():
            ratio = median_ratio(each.cpu, readings["this"].cpu)
            rows.append([f"{name}, B = {batch:,}", f"{1e6 * min(each.cpu):,.0f}", f"{ratio:.2f}"])
    print_table(["one thread", "us", "times this"], rows)
    for name, reason in missing.items():
        print(f"{name} is not installed ({reason}): not measured")


def of_torchrl(states: np.ndarray, actions: np.ndarray) -> Step:
    """Return a step of a world model of torchrl: transition and reward, on a tensordict that is made once."""
    from tensordict import TensorDict
    from tensordict.nn import TensorDictModule
    from torchrl.modules import MLP, WorldModelWrapper

    network = MLP(in_features=states.shape[1] + actions.shape[1], out_features=states.shape[1], num_cells=[128, 128])
    model = WorldModelWrapper(
        TensorDictModule(network, in_keys=["observation", "action"], out_keys=["next_observation"]),
        TensorDictModule(torch.nn.Linear(states.shape[1], 1), in_keys=["next_observation"], out_keys=["reward"]),
    )
    given = TensorDict(
        {"observation": torch.from_numpy(states), "action": torch.from_numpy(actions)}, batch_size=[len(states)]
    )

    def step() -> object:
        with torch.inference_mode():
            return model(given)

    return step


def of_mbrl(states: np.ndarray, actions: np.ndarray) -> Step:
    """Return a step of mbrl-lib's transition model, in which every state keeps to one network of the ensemble.

    It refuses batches whose size is no multiple of the ensemble's (0.2.0), so a single state is given twice.
    """
    from mbrl.models import GaussianMLP, OneDTransitionRewardModel

    if len(states) % 2:
        states, actions = states.repeat(2, axis=0), actions.repeat(2, axis=0)
    ensemble = GaussianMLP(
        states.shape[1] + actions.shape[1], states.shape[1], "cpu", num_layers=3, ensemble_size=2, hid_size=128,
        deterministic=True, propagation_method="fixed_model",
    )  # fmt: skip
    model = OneDTransitionRewardModel(ensemble, target_is_delta=True, normalize=False, learned_rewards=False)
    generator = torch.Generator().manual_seed(0)
    begin = model.reset(torch.from_numpy(states), rng=generator)
    given = torch.from_numpy(actions)

    def step() -> object:
        with torch.inference_mode():
            return model.sample(given, begin, deterministic=True, rng=generator)

    return step


if __name__ == "__main__":
    main()
