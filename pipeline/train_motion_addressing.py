"""Phase 2 of a motion experiment: train the networks that pick a subnetwork for each frame."""

from pathlib import Path

from addressed_dynamics.base.params.experiments import load_motion_params
from addressed_dynamics.base.torch_runtime import prepare_torch
from addressed_dynamics.networks.files import load_motion_network
from pipeline.addressings import train_addressings, trained_ensembles
from pipeline.common import run_stage
from pipeline.motion_training import load_motion_data
from pipeline.training import Stage


def main(experiment: str, params_file: Path) -> None:
    """Train the addressing networks of `experiment`."""
    sections = load_motion_params(params_file, experiment)
    params = sections.addressing
    prepare_torch(threads=1)
    ensembles = {seed: load_motion_network(folder) for seed, folder in trained_ensembles(experiment).items()}
    data = load_motion_data(experiment, next(iter(ensembles.values())).features, sections.augmentation)
    stage = Stage("train_motion_addressing", experiment, params_file, params.processes)
    recipe = {name: getattr(sections, name).model_dump(mode="json") for name in ("augmentation", "addressing")}
    train_addressings(stage, data, ensembles, params, recipe)


if __name__ == "__main__":
    run_stage(main)
