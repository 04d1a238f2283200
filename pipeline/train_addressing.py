"""Phase 2: train the networks that pick a subnetwork for each input, for every seed and variant."""

from pathlib import Path

from addressed_dynamics.base.params.experiments import load_params
from addressed_dynamics.base.torch_runtime import prepare_torch
from addressed_dynamics.networks.files import load_network
from pipeline.addressings import train_addressings, trained_ensembles
from pipeline.common import run_stage
from pipeline.environment_training import load_training_data
from pipeline.training import Stage


def main(experiment: str, params_file: Path) -> None:
    """Train the addressing networks of `experiment`."""
    params = load_params(params_file, experiment).addressing
    prepare_torch(threads=1)
    ensembles = {seed: load_network(folder) for seed, folder in trained_ensembles(experiment).items()}
    data = load_training_data(experiment, next(iter(ensembles.values())).features)
    stage = Stage("train_addressing", experiment, params_file, params.processes)
    train_addressings(stage, data, ensembles, params, {"addressing": params.model_dump(mode="json")})


if __name__ == "__main__":
    run_stage(main)
