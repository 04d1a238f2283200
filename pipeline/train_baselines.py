"""Train what the ensemble is compared with, with as many updates, and address what has members to choose from.

Beside them, if params ask for it, an ensemble of two is trained for a figure of its loss profiles; it is no candidate.
"""

from addressed_dynamics.base.kinds import supplied
from addressed_dynamics.base.params.experiments import load_recipes
from addressed_dynamics.base.torch_runtime import computing_device, prepare_torch
from addressed_dynamics.training.baselines import plan_baselines
from pipeline.baselines import train_baselines
from pipeline.stage import Call, figures_dir, run_stage, tables_dir, training_processes
from pipeline.trainings import Stage, trained_members, training_spool


def main(call: Call) -> str:
    """Train the baselines of an experiment; return what came out."""
    kind, tables = supplied("features", call.kind), tables_dir(call.experiment)
    chosen, other = load_recipes(call.params_file, call.experiment, call.kind)
    prepare_torch(threads=1)
    device = computing_device()
    stage = Stage(
        "train_baselines",
        call.experiment,
        call.params_file,
        training_processes(gpu=device.type != "cpu"),
        device=device,
    )
    spool = training_spool(call.experiment, "train_baselines")
    data = kind.load_training_data(tables, chosen, chosen.features, spool=spool)
    width, samples = data.features, len(data.train)
    members = chosen.ensemble.members
    if members == "auto":
        members = trained_members(call.experiment)
    plan = plan_baselines(chosen, other, members, width.inputs, width.outputs, samples, kind.PHASE_FEATURES)
    # Most are trained on what the ensemble is: it is read once.
    own = {
        name: data
        if each.features == chosen.features and each.sections is chosen and not each.by_phase
        else kind.load_training_data(tables, each.sections, each.features, augmented=not each.by_phase, spool=spool)
        for name, each in plan.items()
    }
    results = train_baselines(stage, plan, own, data, chosen.baselines.seeds)
    for each in (data, *own.values()):
        each.discard()
    figures = figures_dir(call.experiment, "baselines")
    return f"{len(results)} baselines are trained: {', '.join(results)}; {figures}"


if __name__ == "__main__":
    run_stage(main)
