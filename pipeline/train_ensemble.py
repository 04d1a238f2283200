"""Phase 1: train the subnetworks, each on its bin of Algorithm 1, from every seed."""

from addressed_dynamics.base.kinds import supplied
from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.base.torch_runtime import prepare_torch
from pipeline.stage import Call, figures_dir, median_of, run_stage, tables_dir, training_processes
from pipeline.trainings import Stage, train_ensembles


def main(call: Call) -> str:
    """Train the ensembles of an experiment; return what came out."""
    sections, kind = load_experiment(call.params_file, call.experiment, call.kind), supplied("features", call.kind)
    prepare_torch(threads=1)
    data = kind.load_training_data(tables_dir(call.experiment), sections, sections.features)
    recipe = {name: getattr(sections, name).model_dump(mode="json") for name in ("features", "ensemble")}
    stage = Stage("train_ensemble", call.experiment, call.params_file, training_processes())
    results = train_ensembles(stage, data, sections.ensemble, recipe)
    loss = median_of(results, "loss/validation")
    epochs = f"{'at most ' if sections.ensemble.early_stopping else ''}{sections.ensemble.epochs} epochs"
    return f"validation loss {loss} after {epochs}; {figures_dir(call.experiment, 'ensemble')}"


if __name__ == "__main__":
    run_stage(main)
