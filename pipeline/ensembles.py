"""Phase 1 for every seed, of environments and of motion alike."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from addressed_dynamics.base.files import atomic_path, write_json
from addressed_dynamics.base.params.training import EnsembleParams
from addressed_dynamics.features.common.samples import fingerprint
from addressed_dynamics.networks.files import SavedNetwork, save_network
from addressed_dynamics.tracking import Run
from addressed_dynamics.training.ensemble import train_ensemble
from addressed_dynamics.training.epochs import Epoch, updates_per_epoch
from addressed_dynamics.training.estimates import seconds_per_update
from addressed_dynamics.training.losses import reported_loss
from pipeline.common import checkpoints_dir, models_dir, reports_dir
from pipeline.training import Features, Stage, TrainingData, remove_checkpoints, resumable, train_tracked, write_curves


def train_ensembles(
    stage: Stage, data: TrainingData[Features], params: EnsembleParams, recipe: Mapping[str, Any]
) -> None:
    """Train the ensembles of an experiment and write its folder `ensemble`, metrics and curves.

    Args:
        stage: what is run.
        data: what they may see.
        params: how they are trained.
        recipe: all sections that the training depends on, JSON-compatible; kept with the networks.
    """
    experiment, unit = stage.experiment, data.features.loss_unit(reported_loss(params.loss))
    seconds = ensemble_seconds(data, params)
    jobs = {
        f"seed-{seed}": resumable(
            partial(
                train_ensemble, data.train, data.validation, params, seed=seed, loss_unit=unit, augment=data.augment
            ),
            f"{experiment} ensemble n={params.members} lr={params.optimiser.learning_rate:g} seed={seed}",
            {**recipe, "seed": seed},
            checkpoints_dir(experiment),
            *data.tensors,
            seconds=seconds,
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

        rows = train_tracked(stage, jobs, finish)
        write_json(folder / "ensemble.json", {"format": 1, "seeds": list(params.seeds)})
    write_json(reports_dir(experiment) / "ensemble.json", {name: results[name] for name in jobs})
    write_curves(reports_dir(experiment) / "ensemble.csv", rows)
    remove_checkpoints(jobs)


def ensemble_seconds(data: TrainingData[Features], params: EnsembleParams) -> float:
    """Return about how long one ensemble trains, a single network if it has one member."""
    brief = params.model_copy(update={"epochs": 2, "cluster_epochs": 1, "restart": False})
    each = seconds_per_update(
        lambda samples: train_ensemble(samples, samples, brief, seed=0, loss_unit=1.0, augment=data.augment),
        inputs=data.features.inputs,
        outputs=data.features.outputs,
        members=params.members,
        batch_size=params.batch_size,
    )
    return each * params.epochs * updates_per_epoch(len(data.train), params.members, params.batch_size)
