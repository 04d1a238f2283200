"""Phase 2 for every seed and variant, of environments and of motion alike."""

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from addressed_dynamics.base.files import atomic_path, write_json
from addressed_dynamics.base.params.training import AddressingParams, AddressingTraining
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.networks.files import SavedNetwork, read_index, save_network
from addressed_dynamics.tracking import Run
from addressed_dynamics.training.addressing import confusion_matrix, train_addressing
from addressed_dynamics.training.ensemble import evaluate_profiles
from addressed_dynamics.training.epochs import Epoch, updates_per_epoch
from addressed_dynamics.training.estimates import seconds_per_update
from addressed_dynamics.training.losses import reported_loss
from pipeline.common import checkpoints_dir, models_dir, reports_dir
from pipeline.training import (
    Features,
    Stage,
    TrackedJob,
    TrainingData,
    remove_checkpoints,
    resumable,
    train_tracked,
    write_curves,
)


def trained_ensembles(experiment: str) -> dict[int, Path]:
    """Return the folder of the ensemble of every seed."""
    folder = models_dir(experiment) / "ensemble"
    return {seed: folder / f"seed-{seed}" for seed in read_index(folder, "ensemble.json")["seeds"]}


def train_addressings(
    stage: Stage,
    data: TrainingData[Features],
    ensembles: Mapping[int, SavedNetwork[Features]],
    params: AddressingParams,
    recipe: Mapping[str, Any],
) -> None:
    """Train the addressing networks of an experiment and write its folder `addressing`, metrics and curves.

    Args:
        stage: what is run.
        data: what they may see.
        ensembles: by seed, what they address.
        params: how they are trained.
        recipe: all sections that the training depends on beside the ensemble, JSON-compatible.
    """
    experiment, members = stage.experiment, next(iter(ensembles.values())).stack.members
    seconds = addressing_seconds(data, members, params)
    jobs, profiles = dict[str, TrackedJob](), dict[str, Tensor]()
    for seed, ensemble in ensembles.items():
        loss = reported_loss(ensemble.notes["params"]["ensemble"]["loss"])
        unit = data.features.loss_unit(loss)
        on_train, on_validation = (
            evaluate_profiles(ensemble.stack, part, loss) * unit for part in (data.train, data.validation)
        )
        training = partial(
            train_addressing, data.train, on_train, data.validation, on_validation, params, seed=seed,
            augment=data.augment,
        )  # fmt: skip
        for variant in params.variants:
            name = f"seed-{seed}/{variant}"
            profiles[name] = on_validation
            jobs[name] = resumable(
                partial(training, variant=variant),
                f"{experiment} addressing {variant} lr={params.optimiser.learning_rate:g} seed={seed}",
                {**recipe, "seed": seed, "variant": variant},
                checkpoints_dir(experiment),
                *data.tensors,
                on_train,
                on_validation,
                seconds=seconds,
            )
    results = dict[str, dict[str, Any]]()
    with atomic_path(models_dir(experiment) / "addressing") as folder:

        def finish(name: str, epoch: Epoch, run: Run) -> None:
            notes = {"params": params.model_dump(mode="json"), "training": name}
            save_network(folder / name, SavedNetwork(epoch.network, data.features, notes))
            run.write_run_id(folder / name)
            confusion = confusion_matrix(epoch.network, data.validation, profiles[name])
            results[name] = {**epoch.metrics, "confusion": confusion}

        rows = train_tracked(stage, jobs, finish)
        delivered = {str(seed): deliver(seed, params.deliver, params.variants, results) for seed in ensembles}
        index = {"format": 1, "delivered": delivered, "variants": list(params.variants)}
        write_json(folder / "addressing.json", index)
    report = {"delivered": delivered, "validation": {name: results[name] for name in jobs}}
    write_json(reports_dir(experiment) / "addressing.json", report)
    write_curves(reports_dir(experiment) / "addressing.csv", rows)
    remove_checkpoints(jobs)


def deliver(seed: int, choice: str, variants: tuple[str, ...], results: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the variant to deliver: the one asked for, or the one with the lowest regret on validation samples."""
    if choice != "best":
        return choice
    return min(variants, key=lambda variant: results[f"seed-{seed}/{variant}"]["regret/mean"])


def addressing_seconds(data: TrainingData[Features], members: int, params: AddressingTraining) -> float:
    """Return about how long one addressing network trains."""
    brief = params.model_copy(update={"epochs": 2})

    def training(samples: Samples) -> Iterator[Epoch]:
        profiles = torch.rand(len(samples), members, generator=torch.Generator().manual_seed(0))
        return train_addressing(
            samples, profiles, samples, profiles, brief, seed=0, variant="plain", augment=data.augment
        )

    each = seconds_per_update(
        training, inputs=data.features.inputs, outputs=data.features.outputs, members=1, batch_size=params.batch_size
    )
    return each * params.epochs * updates_per_epoch(len(data.train), 1, params.batch_size)
