"""Phase 1: train the subnetworks, each on its bin of Algorithm 1, from every seed."""

from addressed_dynamics.base.kinds import supplied
from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.base.torch_runtime import computing_device, prepare_torch
from pipeline.choosing import choice_words, choose_members
from pipeline.stage import (
    Call,
    figures_dir,
    median_of,
    run_stage,
    tables_dir,
    training_processes,
    training_workers,
)
from pipeline.trainings import Stage, remove_checkpoints, train_ensembles, training_spool


def main(call: Call) -> str:
    """Train the ensembles of an experiment; return what came out."""
    sections, kind = load_experiment(call.params_file, call.experiment, call.kind), supplied("features", call.kind)
    prepare_torch(threads=1)
    device = computing_device()
    stage = Stage(
        "train_ensemble",
        call.experiment,
        call.params_file,
        training_processes(gpu=device.type != "cpu"),
        training_workers(),
        device=device,
    )
    spool = training_spool(call.experiment, "train_ensemble")
    data = kind.load_training_data(tables_dir(call.experiment), sections, sections.features, spool=spool)
    params, members, brief_jobs = choose_members(stage, data, sections.ensemble)
    choices = {**data.choices, **({"members": members} if members else {})}
    features = sections.features.model_dump(mode="json") | {name: each.chosen for name, each in data.choices.items()}
    recipe = {"features": features, "ensemble": params.model_dump(mode="json")}
    results = train_ensembles(stage, data, params, recipe, choices)
    remove_checkpoints(brief_jobs)
    data.discard()
    chosen = "".join(f"{choice_words(name, choice)} on validation samples; " for name, choice in choices.items())
    loss = median_of(results, "loss/validation")
    epochs = f"{'at most ' if params.early_stopping else ''}{params.epochs} epochs"
    return f"{chosen}validation loss {loss} after {epochs}; {figures_dir(call.experiment, 'ensemble')}"


if __name__ == "__main__":
    run_stage(main)
