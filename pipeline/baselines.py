"""The trainings of all baselines, and of the networks that address some of them."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import torch

from addressed_dynamics import tracking
from addressed_dynamics.base.files import atomic_path, write_json, write_rows
from addressed_dynamics.base.params.training import BlendedTraining
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.common.spool import beside
from addressed_dynamics.features.common.training_data import TrainingData
from addressed_dynamics.networks.files import SavedNetwork, save_network
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.tracking import Run
from addressed_dynamics.training.addressing import train_addressing
from addressed_dynamics.training.baselines import PAIR, Baseline
from addressed_dynamics.training.blended import BlendedEpoch, train_gated, train_phase_functioned
from addressed_dynamics.training.ensemble import evaluate_profiles
from addressed_dynamics.training.epochs import Epoch, updates_per_epoch
from addressed_dynamics.training.estimates import seconds_per_update
from addressed_dynamics.training.losses import reported_loss
from addressed_dynamics.training.references import reference_costs, reference_networks
from pipeline.stage import checkpoints_dir, figures_dir, models_dir, tables_dir
from pipeline.trainings import (
    Stage,
    TrackedJob,
    addressing_seconds,
    ensemble_job,
    ensemble_seconds,
    remove_checkpoints,
    resumable,
    scaled_profiles,
    train_tracked,
)

MODES = {"phase_functioned": "phase", "learned_blend": "blend"}
"""How networks are used that are not addressed by argmax."""


def train_baselines(
    stage: Stage,
    plan: Mapping[str, Baseline],
    data: Mapping[str, TrainingData[Any]],
    own: TrainingData[Any],
    seeds: tuple[int, ...],
) -> dict[str, dict[str, float]]:
    """Train all baselines and write their folder `baselines`, metrics and curves; return the metrics.

    Args:
        stage: what is run.
        plan: the baselines by name.
        data: what each may see.
        own: what the ensemble sees; the references are found in it.
        seeds: one of each is trained from each; the pair from the first alone.
    """
    experiment = stage.experiment
    keys = {f"{name}/seed-{seed}": (name, seed) for seed in seeds for name in plan if name != PAIR or seed == seeds[0]}
    jobs = {key: _job(stage, name, seed, plan[name], data[name]) for key, (name, seed) in keys.items()}
    results, networks = dict[str, dict[str, float]](), dict[str, StackedMLP]()
    with atomic_path(models_dir(experiment) / "baselines") as folder:

        def keep(key: str, part: str, network: StackedMLP, run: Run) -> None:
            name, _ = keys[key]
            notes = {"training": key, "params": _settings(plan[name]), "mode": MODES.get(name, "argmax")}
            save_network(folder / key / part, SavedNetwork(network, data[name].features, notes))
            run.log_output(folder / key / part)

        def finish(key: str, epoch: Epoch, run: Run) -> None:
            keep(key, "network", epoch.network, run)
            networks[key], total = epoch.network, epoch.network.parameters_total
            if isinstance(epoch, BlendedEpoch) and epoch.gate is not None:
                keep(key, "addressing", epoch.gate, run)
                total += epoch.gate.parameters_total
            costs = {"parameters": total, "updates": epoch.updates, "samples": epoch.samples}
            results[key] = {**epoch.metrics, **costs}

        def finish_addressing(key: str, epoch: Epoch, run: Run) -> None:
            keep(key, "addressing", epoch.network, run)
            results[key] |= {f"addressing/{name}": value for name, value in epoch.metrics.items()}

        rows = train_tracked(stage, jobs, finish)
        addressing_jobs = {
            key: _addressing_job(stage, name, seed, plan[name], data[name], networks[key])
            for key, (name, seed) in keys.items()
            if plan[name].addressing is not None
        }
        train_tracked(stage, addressing_jobs, finish_addressing)
        compared = [key for key, (name, _) in keys.items() if name != PAIR]
        pairs = [key for key in keys if key not in compared]
        for name, network in reference_networks(own):
            key = f"{name}/seed-{seeds[0]}"
            with tracking.run(stage=stage.name, experiment=experiment, name=f"{experiment} baseline {name}",
                              params={"baseline": name}, params_file=stage.params_file,
                              data=tables_dir(experiment)) as run:  # fmt: skip
                notes = {"training": key, "params": {}, "mode": "argmax"}
                save_network(folder / key / "network", SavedNetwork(network, own.features, notes))
                run.log_output(folder / key / "network")
                results[key] = _reference_metrics(name, network, own)
                run.log(results[key], step=0)
            compared.append(key)
        write_json(folder / "baselines.json", {"format": 1, "trained": compared, "pair": pairs})
    write_json(figures_dir(experiment, "baselines") / "baselines.json", {key: results[key] for key in compared})
    write_rows(figures_dir(experiment, "baselines") / "baselines.csv", rows)
    remove_checkpoints(jobs)
    remove_checkpoints(addressing_jobs)
    return results


def _reference_metrics(name: str, network: StackedMLP, data: TrainingData[Any]) -> dict[str, float]:
    """Return what is known of a network that was not trained, as if it had been."""
    unit = data.features.loss_unit("mse")
    parts = {part: each for part, each in (("train", data.train), ("validation", data.validation)) if len(each)}
    losses = {
        part: float(evaluate_profiles(network, each, "mse", make=beside(each)).mean()) * unit
        for part, each in parts.items()
    }
    parameters, _ = reference_costs(name, network.widths[0], network.widths[-1], data.last_frame)
    known = {"parameters": parameters, "samples": len(data.train) if parameters else 0}
    return {**{f"loss/{part}": loss for part, loss in losses.items()}, "updates": 0, **known}


def _settings(baseline: Baseline) -> dict[str, Any]:
    addressing = baseline.addressing.model_dump(mode="json") if baseline.addressing else None
    return {"ensemble": baseline.training.model_dump(mode="json"), "addressing": addressing}


def _job(stage: Stage, name: str, seed: int, baseline: Baseline, data: TrainingData[Any]) -> TrackedJob:
    params, title = baseline.training, f"{stage.experiment} baseline {name} seed={seed}"
    notes = {
        "baseline": name,
        "seed": seed,
        "recipe": params.model_dump(mode="json"),
        "updates": baseline.updates,
        "features": baseline.features.model_dump(mode="json"),
    }
    if isinstance(params, BlendedTraining):
        training = partial(_blended(baseline, params, data, seed), device=stage.device)
        seconds = _blended_seconds(baseline, params, data, stage.device)
        return resumable(training, title, notes, checkpoints_dir(stage.experiment), data, seconds=seconds)
    return ensemble_job(
        stage, data, params, seed, title, notes, seconds=ensemble_seconds(data, params, stage.device),
        binning=baseline.binning, updates=baseline.updates,
    )  # fmt: skip


def _blended(
    baseline: Baseline, params: BlendedTraining, data: TrainingData[Any], seed: int
) -> Callable[..., Iterator[Epoch]]:
    if not baseline.by_phase:
        return partial(train_gated, data.train, data.validation, params, seed=seed, augment=data.augment,
                       updates=baseline.updates)  # fmt: skip
    assert data.phases is not None
    train, validation = data.phases
    return partial(
        train_phase_functioned, data.train, train, data.validation, validation, params, seed=seed,
        updates=baseline.updates,
    )  # fmt: skip


def _blended_seconds(
    baseline: Baseline, params: BlendedTraining, data: TrainingData[Any], device: torch.device
) -> float:
    brief = params.model_copy(update={"epochs": 2})

    def training(samples: Samples) -> Iterator[Epoch]:
        phase = torch.linspace(0.0, 1.0, len(samples))
        if baseline.by_phase:
            return train_phase_functioned(samples, phase, samples, phase, brief, seed=0, device=device)
        return train_gated(samples, samples, brief, seed=0, augment=data.augment, device=device)

    features, size = data.features, params.batch_size
    each = seconds_per_update(
        training, inputs=features.inputs, outputs=features.outputs, members=1, batch_size=size, samples=len(data.train)
    )
    return each * params.epochs * updates_per_epoch(len(data.train), 1, size)


def _addressing_job(
    stage: Stage, name: str, seed: int, baseline: Baseline, data: TrainingData[Any], network: StackedMLP
) -> TrackedJob:
    params = baseline.addressing
    assert params is not None
    loss = reported_loss(baseline.training.loss)
    unit = data.features.loss_unit(loss)
    on_train, on_validation = scaled_profiles(network, data, loss, unit, f"profiles-{name}-{seed}", stage.device)
    training = partial(
        train_addressing, data.train, on_train, data.validation, on_validation, params, seed=seed, variant="plain",
        augment=data.augment, device=stage.device,
    )  # fmt: skip
    notes = {"baseline": name, "seed": seed, "recipe": params.model_dump(mode="json")}
    title, seconds = (
        f"{stage.experiment} baseline {name} addressing seed={seed}",
        addressing_seconds(data, network.members, params, stage.device),
    )
    return resumable(
        training, title, notes, checkpoints_dir(stage.experiment), data, on_train, on_validation, seconds=seconds
    )
