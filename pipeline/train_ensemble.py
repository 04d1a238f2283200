"""Phase 1: train the subnetworks, each on its bin of Algorithm 1, from every seed."""

from pathlib import Path

from addressed_dynamics.base.params.experiments import load_params
from addressed_dynamics.base.torch_runtime import prepare_torch
from pipeline.common import run_stage
from pipeline.ensembles import train_ensembles
from pipeline.environment_training import load_training_data
from pipeline.training import Stage


def main(experiment: str, params_file: Path) -> None:
    """Train the ensembles of `experiment`."""
    sections = load_params(params_file, experiment)
    prepare_torch(threads=1)
    data = load_training_data(experiment, sections.features)
    recipe = {name: getattr(sections, name).model_dump(mode="json") for name in ("features", "ensemble")}
    stage = Stage("train_ensemble", experiment, params_file, sections.ensemble.processes)
    train_ensembles(stage, data, sections.ensemble, recipe)


if __name__ == "__main__":
    run_stage(main)
