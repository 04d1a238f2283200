"""Train what the ensemble is compared with: single networks, and ensembles with other bins, each addressed in turn."""

from functools import partial
from pathlib import Path

from addressed_dynamics.files import atomic_path, write_json
from addressed_dynamics.models.files import SavedNetwork, save_network
from addressed_dynamics.models.stacked import StackedMLP
from addressed_dynamics.params import load_params
from addressed_dynamics.tracking import Run
from addressed_dynamics.training.addressing import train_addressing
from addressed_dynamics.training.baselines import ABLATIONS, baseline_params
from addressed_dynamics.training.ensemble import evaluate_profiles, train_ensemble
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.losses import reported_loss
from addressed_dynamics.training.runtime import prepare_torch
from pipeline.common import checkpoints_dir, models_dir, reports_dir, run_stage
from pipeline.training import (
    Stage,
    TrackedJob,
    load_training_data,
    parameters_of,
    remove_checkpoints,
    resumable,
    train_tracked,
    write_curves,
)


def main(experiment: str, params_file: Path) -> None:
    """Train the baselines of `experiment`."""
    sections = load_params(params_file, experiment)
    params = sections.baselines
    prepare_torch(threads=1)
    data = load_training_data(experiment, sections.features)
    recipes = {name: baseline_params(name, sections.ensemble, params, data.train) for name in params.train}
    keys = {f"{name}/seed-{seed}": (name, seed) for seed in params.seeds for name in params.train}
    loss = reported_loss(sections.ensemble.loss)
    unit = data.features.loss_unit(loss)
    checkpoints = checkpoints_dir(experiment)
    jobs = dict[str, TrackedJob]()
    for key, (name, seed) in keys.items():
        training = partial(train_ensemble, data.train, data.validation, recipes[name], seed=seed, loss_unit=unit,
                           binning=ABLATIONS.get(name, "equal"))  # fmt: skip
        recipe = {"baseline": name, "seed": seed, "recipe": recipes[name].model_dump(mode="json")}
        jobs[key] = resumable(training, f"{experiment} baseline {name} seed={seed}", recipe, checkpoints, *data.tensors)
    results, ablated = dict[str, dict[str, float]](), dict[str, StackedMLP]()
    stage = Stage("train_baselines", experiment, params_file, params.processes)
    with atomic_path(models_dir(experiment) / "baselines") as folder:

        def finish(key: str, epoch: Epoch, run: Run) -> None:
            save_network(folder / key / "network", SavedNetwork(epoch.network, data.features, {"training": key}))
            run.write_run_id(folder / key / "network")
            results[key] = {**epoch.metrics, "parameters": parameters_of(epoch.network), "updates": epoch.updates}
            if keys[key][0] in ABLATIONS:
                ablated[key] = epoch.network

        def finish_addressing(key: str, epoch: Epoch, run: Run) -> None:
            save_network(folder / key / "addressing", SavedNetwork(epoch.network, data.features, {"training": key}))
            run.write_run_id(folder / key / "addressing")
            results[key] |= {f"addressing/{name}": value for name, value in epoch.metrics.items()}

        rows = train_tracked(stage, jobs, finish)
        addressing_jobs = dict[str, TrackedJob]()
        for key, network in ablated.items():
            name, seed = keys[key]
            on_train, on_validation = (
                evaluate_profiles(network, part, loss) * unit for part in (data.train, data.validation)
            )
            training = partial(train_addressing, data.train, on_train, data.validation, on_validation,
                               params.addressing, seed=seed, variant="plain")  # fmt: skip
            recipe = {"baseline": name, "seed": seed, "recipe": params.addressing.model_dump(mode="json")}
            title = f"{experiment} baseline {name} addressing seed={seed}"
            addressing_jobs[key] = resumable(
                training, title, recipe, checkpoints, *data.tensors, on_train, on_validation
            )
        train_tracked(stage, addressing_jobs, finish_addressing)
        write_json(folder / "baselines.json", {"format": 1, "trained": list(jobs)})
    write_json(reports_dir(experiment) / "baselines.json", {key: results[key] for key in jobs})
    write_curves(reports_dir(experiment) / "baselines.csv", rows)
    remove_checkpoints(jobs)
    remove_checkpoints(addressing_jobs)


if __name__ == "__main__":
    run_stage(main)
