"""Train what the ensemble is compared with: single networks, and ensembles with other bins, each addressed in turn.

Beside them, if params ask for it, an ensemble of two is trained for a figure of its loss profiles; it is no candidate.
"""

from functools import partial
from typing import Any

from addressed_dynamics.base.files import atomic_path, write_json
from addressed_dynamics.base.params.experiments import load_recipes
from addressed_dynamics.base.torch_runtime import prepare_torch
from addressed_dynamics.features.common.training_data import TrainingData
from addressed_dynamics.features.transitions.kind import load_training_data
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.networks.files import SavedNetwork, save_network
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.tracking import Run
from addressed_dynamics.training.addressing import train_addressing
from addressed_dynamics.training.baselines import ONCE, PAIR, Baseline, plan_baselines
from addressed_dynamics.training.ensemble import evaluate_profiles, train_ensemble
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.losses import reported_loss
from pipeline.stage import Call, checkpoints_dir, figures_dir, models_dir, tables_dir, write_curves
from pipeline.trainings import (
    Stage,
    TrackedJob,
    remove_checkpoints,
    resumable,
    train_tracked,
)


def train(call: Call) -> None:
    """Train the baselines of `experiment`."""
    experiment = call.experiment
    chosen, other = load_recipes(call.params_file, experiment, call.kind)
    params = chosen.baselines
    prepare_torch(threads=1)
    data = {chosen.features: load_training_data(tables_dir(experiment), chosen, chosen.features)}
    samples = data[chosen.features].train
    plan = plan_baselines(chosen, other, samples.x.shape[1], samples.y.shape[1], len(samples))
    for each in plan.values():
        if each.features not in data:
            data[each.features] = load_training_data(tables_dir(experiment), chosen, each.features)
    keys = {f"{name}/seed-{seed}": (name, seed) for seed in params.seeds for name in plan
            if name not in ONCE or seed == params.seeds[0]}  # fmt: skip
    jobs = {
        key: _ensemble_job(experiment, name, seed, plan[name], data[plan[name].features])
        for key, (name, seed) in keys.items()
    }
    results, networks = dict[str, dict[str, float]](), dict[str, StackedMLP]()
    stage = Stage("train_baselines", experiment, call.params_file, params.processes)
    with atomic_path(models_dir(experiment) / "baselines") as folder:

        def keep(key: str, part: str, epoch: Epoch, run: Run) -> None:
            baseline = plan[keys[key][0]]
            notes = {"training": key, "params": _settings(baseline)}
            save_network(folder / key / part, SavedNetwork(epoch.network, data[baseline.features].features, notes))
            run.write_run_id(folder / key / part)

        def finish(key: str, epoch: Epoch, run: Run) -> None:
            keep(key, "network", epoch, run)
            networks[key] = epoch.network
            total = epoch.network.parameters_total
            results[key] = {**epoch.metrics, "parameters": total, "updates": epoch.updates}

        def finish_addressing(key: str, epoch: Epoch, run: Run) -> None:
            keep(key, "addressing", epoch, run)
            results[key] |= {f"addressing/{name}": value for name, value in epoch.metrics.items()}

        rows = train_tracked(stage, jobs, finish)
        addressing_jobs = {
            key: _addressing_job(experiment, name, seed, plan[name], data[plan[name].features], networks[key])
            for key, (name, seed) in keys.items()
            if plan[name].addressing is not None
        }
        train_tracked(stage, addressing_jobs, finish_addressing)
        compared = [key for key, (name, _) in keys.items() if name != PAIR]
        pairs = [key for key in keys if key not in compared]
        write_json(folder / "baselines.json", {"format": 1, "trained": compared, "pair": pairs})
    write_json(figures_dir(experiment, "baselines") / "baselines.json", {key: results[key] for key in compared})
    write_curves(figures_dir(experiment, "baselines") / "baselines.csv", rows)
    remove_checkpoints(jobs)
    remove_checkpoints(addressing_jobs)


def _settings(baseline: Baseline) -> dict[str, Any]:
    addressing = baseline.addressing.model_dump(mode="json") if baseline.addressing else None
    return {"ensemble": baseline.ensemble.model_dump(mode="json"), "addressing": addressing}


def _ensemble_job(
    experiment: str, name: str, seed: int, baseline: Baseline, data: TrainingData[FeatureSpec]
) -> TrackedJob:
    unit = data.features.loss_unit(reported_loss(baseline.ensemble.loss))
    training = partial(train_ensemble, data.train, data.validation, baseline.ensemble, seed=seed, loss_unit=unit,
                       binning=baseline.binning)  # fmt: skip
    recipe = {"baseline": name, "seed": seed, "recipe": baseline.ensemble.model_dump(mode="json")}
    title = f"{experiment} baseline {name} seed={seed}"
    return resumable(training, title, recipe, checkpoints_dir(experiment), *data.tensors)


def _addressing_job(
    experiment: str, name: str, seed: int, baseline: Baseline, data: TrainingData[FeatureSpec], network: StackedMLP
) -> TrackedJob:
    loss = reported_loss(baseline.ensemble.loss)
    unit = data.features.loss_unit(loss)
    on_train, on_validation = (evaluate_profiles(network, part, loss) * unit for part in (data.train, data.validation))
    assert baseline.addressing is not None
    training = partial(train_addressing, data.train, on_train, data.validation, on_validation, baseline.addressing,
                       seed=seed, variant="plain")  # fmt: skip
    recipe = {"baseline": name, "seed": seed, "recipe": baseline.addressing.model_dump(mode="json")}
    title = f"{experiment} baseline {name} addressing seed={seed}"
    return resumable(training, title, recipe, checkpoints_dir(experiment), *data.tensors, on_train, on_validation)
