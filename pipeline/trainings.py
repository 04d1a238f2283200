"""The one body of the three trainings: resumable, and tracked in MLflow while they run."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from addressed_dynamics import tracking
from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.files import atomic_path, write_json, write_rows
from addressed_dynamics.base.memory import memory_for_samples
from addressed_dynamics.base.params.training import AddressingParams, AddressingTraining, EnsembleParams
from addressed_dynamics.base.torch_runtime import CPU
from addressed_dynamics.features.common.samples import Samples, fingerprint
from addressed_dynamics.features.common.spool import Spool, beside, release
from addressed_dynamics.features.common.training_data import Choice, Features, TrainingData
from addressed_dynamics.networks.files import SavedNetwork, read_index, save_network
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.tracking import Run
from addressed_dynamics.training.addressing import confusion_matrix, train_addressing
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.ensemble import check_enough, profiles_on, train_ensemble
from addressed_dynamics.training.epochs import Epoch, updates_per_epoch
from addressed_dynamics.training.estimates import all_done, in_words, seconds_per_update
from addressed_dynamics.training.jobs import Job, run_jobs
from addressed_dynamics.training.losses import reported_loss
from pipeline.stage import checkpoints_dir, figures_dir, models_dir, progress, say, tables_dir

NOTHING_TO_CHOOSE = {"hidden": (), "heads": (), "epochs": 1, "variants": ("plain",), "deliver": "plain"}
"""How the addressing network of a single subnetwork is trained: there is one, as for any ensemble, but the smallest."""


@dataclass(frozen=True)
class TrackedJob:
    """A training with what MLflow should show of it."""

    job: Job
    """The training."""
    title: str
    """Name of its run."""
    params: Mapping[str, Any]
    """What it depends on, but for the data."""
    checkpoint: Checkpoint
    """Where it keeps its state while it runs."""
    seconds: float
    """About how long it takes, from its beginning; 0 if nobody has measured."""


def resumable(
    training: Callable[..., Iterator[Epoch]],
    title: str,
    params: Mapping[str, Any],
    folder: Path,
    data: TrainingData[Any],
    *profiles: Tensor,
    seconds: float = 0.0,
) -> TrackedJob:
    """Return `training` with a checkpoint in `folder` that belongs to its title, its params and these data alone."""
    known = [data.fingerprint, fingerprint(*profiles)] if profiles else data.fingerprint
    checkpoint = Checkpoint.of(folder, title=title, params=params, data=known)
    return TrackedJob(partial(training, checkpoint=checkpoint), title, params, checkpoint, seconds)


@dataclass(frozen=True)
class Stage:
    """What the runs of a stage have in common."""

    name: str
    """Name of the stage."""
    experiment: str
    """Name of the experiment."""
    params_file: Path
    """Where the params come from."""
    processes: int
    """Trainings at the same time."""
    workers: int = 1
    """Workers of a cluster that do each of them together."""
    device: torch.device = CPU
    """What they compute on."""


def training_spool(experiment: str, stage: str) -> Spool:
    """Return where a stage puts the samples of a split that is larger than memory: beside its checkpoints.

    That is half of the memory that is free, or what the environment variable `ADDRESSED_DYNAMICS_MEMORY` says: no
    param, because what comes out does not depend on it.

    Raises:
        ParamsError: the variable is no size.
    """
    return Spool(checkpoints_dir(experiment) / stage, memory_for_samples())


def train_tracked(
    stage: Stage, jobs: Mapping[str, TrackedJob], finish: Callable[[str, Epoch, tracking.Run], None]
) -> list[dict[str, Any]]:
    """Run the trainings, log every epoch, and call `finish(name, last epoch, run)` when one ends.

    Returns:
        One row for each training and epoch, in their order: `training`, `epoch` and the metrics.
    """
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in jobs}
    if seconds := all_done((job.seconds for job in jobs.values()), stage.processes):
        trainings = "1 training" if len(jobs) == 1 else f"{len(jobs)} trainings, {stage.processes} at a time"
        say(f"{stage.name}: {trainings}, about {in_words(seconds)} from the beginning; goes on where it was cut off")
    with ExitStack() as stack:
        runs = dict[str, tracking.Run]()
        bar = stack.enter_context(progress(stage.name, "epoch"))
        todo = {name: tracked.job for name, tracked in jobs.items()}
        for name, epoch in run_jobs(todo, processes=stage.processes, workers=stage.workers):
            if name not in runs:
                runs[name] = stack.enter_context(
                    tracking.run(
                        stage=stage.name,
                        experiment=stage.experiment,
                        name=jobs[name].title,
                        params=jobs[name].params,
                        params_file=stage.params_file,
                        data=tables_dir(stage.experiment),
                    )
                )
                runs[name].log_dataset(stage.experiment, tables_dir(stage.experiment))
            runs[name].log(epoch.metrics, step=epoch.index)
            rows[name].append({"training": name, "epoch": epoch.index, **epoch.metrics})
            bar.update()
            bar.set_postfix_str(f"{name} {epoch.metrics['loss/train']:.2e}", refresh=False)
            if epoch.last:
                finish(name, epoch, runs[name])
    return [row for name in jobs for row in rows[name]]


def remove_checkpoints(jobs: Mapping[str, TrackedJob]) -> None:
    """Delete what the trainings kept; call it when all that a stage writes is in its place."""
    for job in jobs.values():
        job.checkpoint.remove()


def train_ensembles(
    stage: Stage,
    data: TrainingData[Features],
    params: EnsembleParams,
    recipe: Mapping[str, Any],
    choices: Mapping[str, Choice] | None = None,
) -> dict[str, dict[str, float]]:
    """Train the ensembles of an experiment and write its folder `ensemble`, metrics and curves; return the metrics.

    Args:
        stage: what is run.
        data: what they may see.
        params: how they are trained.
        recipe: all sections that the training depends on, JSON-compatible; kept with the networks.
        choices: what was chosen on validation samples before, by key; kept with the metrics.
    """
    experiment = stage.experiment
    seconds = ensemble_seconds(data, params, stage.device)
    title = f"{experiment} ensemble n={params.members} lr={params.optimiser.learning_rate:g}"
    jobs = {
        f"seed-{seed}": ensemble_job(
            stage, data, params, seed, f"{title} seed={seed}", {**recipe, "seed": seed}, seconds=seconds
        )
        for seed in params.seeds
    }
    results = dict[str, dict[str, float]]()
    with atomic_path(models_dir(experiment) / "ensemble") as folder:

        def finish(name: str, epoch: Epoch, run: Run) -> None:
            notes = {"params": recipe, "training": name, "data": data.fingerprint}
            save_network(folder / name, SavedNetwork(epoch.network, data.features, notes))
            run.log_output(folder / name)
            results[name] = epoch.metrics

        rows = train_tracked(stage, jobs, finish)
        write_json(folder / "ensemble.json", {"format": 1, "seeds": list(params.seeds), "members": params.members})
    dropped = {"dropped": {split: asdict(each) for split, each in data.dropped.items()}}
    chosen = {"choices": {name: asdict(each) for name, each in choices.items()}} if choices else {}
    figures = {name: results[name] for name in jobs} | dropped | chosen
    write_json(figures_dir(experiment, "ensemble") / "ensemble.json", figures)
    write_rows(figures_dir(experiment, "ensemble") / "ensemble.csv", rows)
    remove_checkpoints(jobs)
    return results


def ensemble_job(
    stage: Stage,
    data: TrainingData[Features],
    params: EnsembleParams,
    seed: int,
    title: str,
    settings: Mapping[str, Any],
    *,
    seconds: float,
    **more: Any,
) -> TrackedJob:
    """Return the training of one ensemble, or of a single network; `more` goes to `train_ensemble`."""
    training = partial(
        train_ensemble, data.train, data.validation, params, seed=seed, augment=data.augment, device=stage.device,
        loss_unit=data.features.loss_unit(reported_loss(params.loss)), **more,
    )  # fmt: skip
    return resumable(training, title, settings, checkpoints_dir(stage.experiment), data, seconds=seconds)


def ensemble_seconds(data: TrainingData[Features], params: EnsembleParams, device: torch.device) -> float:
    """Return about how long one ensemble trains, a single network if it has one member.

    Raises:
        TrainingError: there are too few samples; what is timed would be made up of more.
    """
    check_enough(data.train, data.validation, params.members)
    brief = params.model_copy(update={"epochs": 2, "cluster_epochs": 1, "restart": False})

    def training(samples: Samples) -> Iterator[Epoch]:
        # Networks can go on from their own predictions in real episodes alone.
        some = samples if params.horizon == 1 else data.train.first(len(samples))
        return train_ensemble(some, some, brief, seed=0, loss_unit=1.0, augment=data.augment, device=device)

    each = seconds_per_update(
        training,
        inputs=data.features.inputs,
        outputs=data.features.outputs,
        members=params.members,
        batch_size=params.batch_size,
        samples=len(data.train),
    )
    return each * params.epochs * updates_per_epoch(len(data.train), params.members, params.batch_size)


def trained_ensembles(experiment: str) -> dict[int, Path]:
    """Return the folder of the ensemble of every seed."""
    folder = models_dir(experiment) / "ensemble"
    return {seed: folder / f"seed-{seed}" for seed in read_index(folder, "ensemble.json")["seeds"]}


def trained_members(experiment: str) -> int:
    """Return the number of subnetworks that the ensembles of an experiment have.

    Raises:
        ModelError: there are none, or they are of a version that does not say it.
    """
    folder = models_dir(experiment) / "ensemble"
    index = read_index(folder, "ensemble.json")
    if "members" not in index:
        message = f"{folder / 'ensemble.json'}: it does not say how many subnetworks it has; run train_ensemble again"
        raise ModelError(message)
    return int(index["members"])


def train_addressings(
    stage: Stage,
    data: TrainingData[Features],
    ensembles: Mapping[int, SavedNetwork[Features]],
    params: AddressingParams,
    recipe: Mapping[str, Any],
) -> dict[str, dict[str, Any]]:
    """Train the addressing networks of an experiment and write its folder `addressing`, metrics and curves.

    Args:
        stage: what is run.
        data: what they may see.
        ensembles: by seed, what they address.
        params: how they are trained.
        recipe: all sections that the training depends on beside the ensemble, JSON-compatible.

    Returns:
        The metrics of each.
    """
    experiment, members = stage.experiment, next(iter(ensembles.values())).stack.members
    if members == 1:
        params = params.model_copy(update=NOTHING_TO_CHOOSE)
    seconds = addressing_seconds(data, members, params, stage.device)
    jobs, profiles = dict[str, TrackedJob](), dict[str, Tensor]()
    for seed, ensemble in ensembles.items():
        loss = reported_loss(ensemble.notes["params"]["ensemble"]["loss"])
        unit = data.features.loss_unit(loss)
        on_train, on_validation = scaled_profiles(ensemble.stack, data, loss, unit, f"profiles-{seed}", stage.device)
        training = partial(
            train_addressing, data.train, on_train, data.validation, on_validation, params, seed=seed,
            augment=data.augment, device=stage.device,
        )  # fmt: skip
        for variant in params.variants:
            name = f"seed-{seed}/{variant}"
            profiles[name] = on_validation
            jobs[name] = resumable(
                partial(training, variant=variant),
                f"{experiment} addressing {variant} lr={params.optimiser.learning_rate:g} seed={seed}",
                {**recipe, "seed": seed, "variant": variant},
                checkpoints_dir(experiment),
                data,
                on_train,
                on_validation,
                seconds=seconds,
            )
    results = dict[str, dict[str, Any]]()
    with atomic_path(models_dir(experiment) / "addressing") as folder:

        def finish(name: str, epoch: Epoch, run: Run) -> None:
            notes = {"params": params.model_dump(mode="json"), "training": name}
            save_network(folder / name, SavedNetwork(epoch.network, data.features, notes))
            run.log_output(folder / name)
            confusion = confusion_matrix(epoch.network, data.validation, profiles[name])
            results[name] = {**epoch.metrics, "confusion": confusion}

        rows = train_tracked(stage, jobs, finish)
        delivered = {str(seed): deliver(seed, params.deliver, params.variants, results) for seed in ensembles}
        index = {"format": 1, "delivered": delivered, "variants": list(params.variants)}
        write_json(folder / "addressing.json", index)
    report = {"delivered": delivered, "validation": {name: results[name] for name in jobs}}
    write_json(figures_dir(experiment, "addressing") / "addressing.json", report)
    write_rows(figures_dir(experiment, "addressing") / "addressing.csv", rows)
    remove_checkpoints(jobs)
    return results


def scaled_profiles(
    stack: StackedMLP, data: TrainingData[Any], loss: str, unit: float, name: str, device: torch.device
) -> tuple[Tensor, Tensor]:
    """Return the loss profiles of all training and validation samples, times `unit`.

    They are evaluated on the device. Those of samples that are larger than memory lie beside them, under this name.
    """
    on_train, on_validation = (
        profiles_on(device, stack, part, loss, make=beside(part, name)).mul_(unit)
        for part in (data.train, data.validation)
    )
    release(on_train, on_validation)
    return on_train, on_validation


def deliver(seed: int, choice: str, variants: tuple[str, ...], results: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the variant to deliver: the one asked for, or the one with the lowest regret on validation samples."""
    if choice != "best":
        return choice
    return min(variants, key=lambda variant: results[f"seed-{seed}/{variant}"]["regret/mean"])


def addressing_seconds(
    data: TrainingData[Features], members: int, params: AddressingTraining, device: torch.device
) -> float:
    """Return about how long one addressing network trains."""
    brief = params.model_copy(update={"epochs": 2})

    def training(samples: Samples) -> Iterator[Epoch]:
        profiles = torch.rand(len(samples), members, generator=torch.Generator().manual_seed(0))
        return train_addressing(
            samples, profiles, samples, profiles, brief, seed=0, variant="plain", augment=data.augment, device=device
        )

    each = seconds_per_update(
        training, inputs=data.features.inputs, outputs=data.features.outputs, members=1, batch_size=params.batch_size,
        samples=len(data.train),
    )  # fmt: skip
    return each * params.epochs * updates_per_epoch(len(data.train), 1, params.batch_size)
