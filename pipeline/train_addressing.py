"""Phase 2: train the networks that pick a subnetwork for each input, for every seed and variant."""

from addressed_dynamics.base.kinds import supplied
from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.base.torch_runtime import computing_device, prepare_torch
from addressed_dynamics.networks.files import load_any_network
from pipeline.stage import Call, figures_dir, median_of, run_stage, tables_dir, training_processes
from pipeline.trainings import Stage, train_addressings, trained_ensembles, training_spool


def main(call: Call) -> str:
    """Train the addressing networks of an experiment; return what came out."""
    sections, kind = load_experiment(call.params_file, call.experiment, call.kind), supplied("features", call.kind)
    prepare_torch(threads=1)
    device = computing_device()
    stage = Stage(
        "train_addressing",
        call.experiment,
        call.params_file,
        training_processes(gpu=device.type != "cpu"),
        device=device,
    )
    ensembles = {seed: load_any_network(folder) for seed, folder in trained_ensembles(call.experiment).items()}
    features = next(iter(ensembles.values())).features
    spool = training_spool(call.experiment, "train_addressing")
    data = kind.load_training_data(tables_dir(call.experiment), sections, features, spool=spool)
    recipe = {name: getattr(sections, name).model_dump(mode="json") for name in ("features", "addressing")}
    results = train_addressings(stage, data, ensembles, sections.addressing, recipe)
    data.discard()
    share = median_of(results, "agreement")
    return f"the best network is chosen in {share} of the cases; {figures_dir(call.experiment, 'addressing')}"


if __name__ == "__main__":
    run_stage(main)
