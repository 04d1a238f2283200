"""Phase 1 of a motion experiment: train the subnetworks, each on its bin of Algorithm 1, from every seed."""

from pathlib import Path

from addressed_dynamics.base.params.experiments import load_motion_params
from addressed_dynamics.base.torch_runtime import prepare_torch
from pipeline.common import run_stage
from pipeline.ensembles import train_ensembles
from pipeline.motion_training import load_motion_data
from pipeline.training import Stage


def main(experiment: str, params_file: Path) -> None:
    """Train the ensembles of `experiment`."""
    sections = load_motion_params(params_file, experiment)
    prepare_torch(threads=1)
    data = load_motion_data(experiment, sections.features, sections.augmentation)
    recipe = {
        name: getattr(sections, name).model_dump(mode="json") for name in ("features", "augmentation", "ensemble")
    }
    stage = Stage("train_motion_ensemble", experiment, params_file, sections.ensemble.processes)
    train_ensembles(stage, data, sections.ensemble, recipe)


if __name__ == "__main__":
    run_stage(main)
