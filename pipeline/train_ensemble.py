"""Phase 1: train the subnetworks, each on its bin of Algorithm 1, from every seed."""

from functools import partial
from pathlib import Path

from addressed_dynamics.features.samples import fingerprint
from addressed_dynamics.files import atomic_path, write_json
from addressed_dynamics.models.files import SavedNetwork, save_network
from addressed_dynamics.params import load_params
from addressed_dynamics.tracking import Run
from addressed_dynamics.training.ensemble import train_ensemble
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.losses import reported_loss
from addressed_dynamics.training.runtime import prepare_torch
from pipeline.common import checkpoints_dir, models_dir, reports_dir, run_stage
from pipeline.training import Stage, load_training_data, remove_checkpoints, resumable, train_tracked, write_curves


def main(experiment: str, params_file: Path) -> None:
    """Train the ensembles of `experiment`."""
    sections = load_params(params_file, experiment)
    params = sections.ensemble
    prepare_torch(threads=1)
    data = load_training_data(experiment, sections.features)
    recipe = {"features": sections.features.model_dump(mode="json"), "ensemble": params.model_dump(mode="json")}
    unit = data.features.loss_unit(reported_loss(params.loss))
    jobs = {
        f"seed-{seed}": resumable(
            partial(train_ensemble, data.train, data.validation, params, seed=seed, loss_unit=unit),
            f"{experiment} ensemble n={params.members} lr={params.optimiser.learning_rate:g} seed={seed}",
            {**recipe, "seed": seed},
            checkpoints_dir(experiment),
            *data.tensors,
        )
        for seed in params.seeds
    }
    results = dict[str, dict[str, float]]()
    with atomic_path(models_dir(experiment) / "ensemble") as folder:

        def finish(name: str, epoch: Epoch, run: Run) -> None:
            notes = {"params": recipe, "training": name, "data": fingerprint(*data.tensors)}
            save_network(folder / name, SavedNetwork(epoch.network, data.features, notes))
            run.write_run_id(folder / name)
            results[name] = epoch.metrics

        stage = Stage("train_ensemble", experiment, params_file, params.processes)
        rows = train_tracked(stage, jobs, finish)
        write_json(folder / "ensemble.json", {"format": 1, "seeds": list(params.seeds)})
    write_json(reports_dir(experiment) / "ensemble.json", {name: results[name] for name in jobs})
    write_curves(reports_dir(experiment) / "ensemble.csv", rows)
    remove_checkpoints(jobs)


if __name__ == "__main__":
    run_stage(main)
