"""Train what an ensemble of motion is compared with, with the same number of updates."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import torch

from addressed_dynamics.base.files import atomic_path, write_json
from addressed_dynamics.base.params.experiments import load_recipes
from addressed_dynamics.base.params.motion import BlendedTraining, MotionExperimentParams
from addressed_dynamics.base.torch_runtime import prepare_torch
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.common.training_data import TrainingData
from addressed_dynamics.features.motion.features import MotionFeatures
from addressed_dynamics.features.motion.kind import load_training_data
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.motion import MotionMode, MotionModel
from addressed_dynamics.tracking import Run
from addressed_dynamics.training.addressing import train_addressing
from addressed_dynamics.training.baselines import OTHER_RECIPE
from addressed_dynamics.training.blended import BlendedEpoch, train_gated, train_phase_functioned
from addressed_dynamics.training.ensemble import evaluate_profiles, train_ensemble
from addressed_dynamics.training.epochs import Epoch, updates_per_epoch
from addressed_dynamics.training.estimates import seconds_per_update
from addressed_dynamics.training.losses import reported_loss
from addressed_dynamics.training.motion_baselines import PFNN_FEATURES, blended_training, same_size, total_parameters
from pipeline.stage import Call, checkpoints_dir, figures_dir, models_dir, tables_dir, write_curves
from pipeline.trainings import (
    Stage,
    TrackedJob,
    addressing_seconds,
    ensemble_seconds,
    remove_checkpoints,
    resumable,
    train_tracked,
)


def train(call: Call) -> None:
    """Train the baselines of `experiment`."""
    experiment, tables = call.experiment, tables_dir(call.experiment)
    chosen, other = load_recipes(call.params_file, experiment, call.kind)
    params = chosen.baselines
    prepare_torch(threads=1)
    own = load_training_data(tables, chosen, chosen.features)
    data = {
        "phase_functioned": load_training_data(tables, chosen, PFNN_FEATURES, augmented=False),
        "other_recipe": load_training_data(tables, other, other.features),
    }
    names = {name: OTHER_RECIPE[chosen.recipe] if name == "other_recipe" else name for name in params.train}
    trained = {f"{names[name]}/seed-{seed}": (name, seed) for seed in params.seeds for name in params.train}
    jobs = {
        key: _job(experiment, key, name, seed, other if name == "other_recipe" else chosen, data.get(name, own))
        for key, (name, seed) in trained.items()
    }
    results, ensembles, runs = dict[str, dict[str, float]](), dict[str, StackedMLP](), dict[str, Run]()
    stage = Stage("train_baselines", experiment, call.params_file, params.processes)
    with atomic_path(models_dir(experiment) / "baselines") as folder:

        def finish(key: str, epoch: Epoch, run: Run) -> None:
            name, _ = trained[key]
            gate = epoch.gate if isinstance(epoch, BlendedEpoch) else None
            total = epoch.network.parameters_total + (gate.parameters_total if gate else 0)
            results[key] = {**epoch.metrics, "parameters": total, "updates": epoch.updates}
            if name == "other_recipe":
                ensembles[key], runs[key] = epoch.network, run
                return
            modes: dict[str, MotionMode] = {"phase_functioned": "phase", "learned_blend": "blend"}
            features = data.get(name, own).features
            MotionModel(features, epoch.network, gate, mode=modes.get(name, "argmax")).save(
                folder / key, {"training": key}
            )
            run.write_run_id(folder / key)

        def finish_addressing(key: str, epoch: Epoch, run: Run) -> None:
            MotionModel(data["other_recipe"].features, ensembles[key], epoch.network).save(
                folder / key, {"training": key}
            )
            run.write_run_id(folder / key)
            results[key] |= {f"addressing/{name}": value for name, value in epoch.metrics.items()}

        rows = train_tracked(stage, jobs, finish)
        addressings = {
            key: _addressing_job(experiment, key, trained[key][1], other, data["other_recipe"], network)
            for key, network in ensembles.items()
        }
        train_tracked(stage, addressings, finish_addressing)
        write_json(folder / "baselines.json", {"format": 1, "trained": list(trained)})
    write_json(figures_dir(experiment, "baselines") / "baselines.json", {key: results[key] for key in trained})
    write_curves(figures_dir(experiment, "baselines") / "baselines.csv", rows)
    remove_checkpoints(jobs)
    remove_checkpoints(addressings)


def _job(
    experiment: str,
    key: str,
    name: str,
    seed: int,
    sections: MotionExperimentParams,
    data: TrainingData[MotionFeatures],
) -> TrackedJob:
    ensemble, samples, features = sections.ensemble, len(data.train), data.features
    training: Callable[..., Iterator[Epoch]]
    settings: Mapping[str, Any]
    match name:
        case "phase_functioned":
            blended = blended_training(sections.baselines.phase_functioned, ensemble, samples)
            assert data.phases is not None
            phases = data.phases
            training = partial(
                train_phase_functioned, data.train, phases[0], data.validation, phases[1], blended, seed=seed
            )
            seconds = _blended_seconds(name, data, blended)
            settings = blended.model_dump(mode="json")
        case "learned_blend":
            blended = blended_training(sections.baselines.learned_blend, ensemble, samples)
            training = partial(train_gated, data.train, data.validation, blended, seed=seed, augment=data.augment)
            seconds = _blended_seconds(name, data, blended)
            settings = blended.model_dump(mode="json")
        case _:
            recipe = {
                "same_size": same_size(ensemble, samples),
                "total_parameters": total_parameters(ensemble, features.inputs, features.outputs, samples),
            }.get(name, ensemble)
            training = partial(
                train_ensemble, data.train, data.validation, recipe, seed=seed, augment=data.augment,
                loss_unit=features.loss_unit(reported_loss(recipe.loss)),
            )  # fmt: skip
            seconds = ensemble_seconds(data, recipe)
            settings = recipe.model_dump(mode="json")
    augmentation = sections.augmentation.model_dump(mode="json") if data.augment else None
    notes = {"baseline": name, "seed": seed, "recipe": settings, "augmentation": augmentation}
    return resumable(
        training,
        f"{experiment} baseline {key.replace('/seed-', ' seed=')}",
        notes,
        checkpoints_dir(experiment),
        *data.tensors,
        seconds=seconds,
    )


def _blended_seconds(name: str, data: TrainingData[MotionFeatures], params: BlendedTraining) -> float:
    brief = params.model_copy(update={"epochs": 2})

    def training(samples: Samples) -> Iterator[Epoch]:
        phase = torch.linspace(0.0, 1.0, len(samples))
        if name == "phase_functioned":
            return train_phase_functioned(samples, phase, samples, phase, brief, seed=0)
        return train_gated(samples, samples, brief, seed=0, augment=data.augment)

    features, size = data.features, params.batch_size
    each = seconds_per_update(training, inputs=features.inputs, outputs=features.outputs, members=1, batch_size=size)
    return each * params.epochs * updates_per_epoch(len(data.train), 1, size)


def _addressing_job(
    experiment: str,
    key: str,
    seed: int,
    sections: MotionExperimentParams,
    data: TrainingData[MotionFeatures],
    network: StackedMLP,
) -> TrackedJob:
    params, loss = sections.baselines.addressing, reported_loss(sections.ensemble.loss)
    on_train, on_validation = (evaluate_profiles(network, part, loss) for part in (data.train, data.validation))
    training = partial(
        train_addressing, data.train, on_train, data.validation, on_validation, params, seed=seed, variant="plain",
        augment=data.augment,
    )  # fmt: skip
    notes = {"baseline": key, "seed": seed, "recipe": params.model_dump(mode="json")}
    title = f"{experiment} baseline {key.replace('/seed-', ' addressing seed=')}"
    seconds = addressing_seconds(data, network.members, params)
    return resumable(
        training, title, notes, checkpoints_dir(experiment), *data.tensors, on_train, on_validation, seconds=seconds
    )
