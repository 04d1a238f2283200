"""What the training stages share: their data, and trainings that are tracked in MLflow while they run."""

import csv
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from torch import Tensor

from addressed_dynamics import tracking
from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.features.common.augmentation import Augment
from addressed_dynamics.features.common.samples import Samples, fingerprint
from addressed_dynamics.features.motion.features import MotionFeatures
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.estimates import all_done, in_words
from addressed_dynamics.training.jobs import Job, run_jobs
from pipeline.common import progress, say, tables_dir

Features = TypeVar("Features", FeatureSpec, MotionFeatures)


@dataclass(frozen=True)
class TrainingData(Generic[Features]):
    """The samples of an experiment, and how they were made."""

    features: Features
    """Normalisation and targets, from the training split alone."""
    train: Samples
    """Samples to train on."""
    validation: Samples
    """Samples to choose by."""
    augment: Augment | None = None
    """What is done to batches before a network sees them; None for nothing."""

    @property
    def tensors(self) -> tuple[Tensor, ...]:
        """Everything a training may see."""
        return self.train.x, self.train.y, self.validation.x, self.validation.y


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
    *tensors: Tensor,
    seconds: float = 0.0,
) -> TrackedJob:
    """Return `training` with a checkpoint in `folder` that belongs to its title, its params and these data alone."""
    checkpoint = Checkpoint.of(folder, title=title, params=params, data=fingerprint(*tensors))
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
        for name, epoch in run_jobs({name: tracked.job for name, tracked in jobs.items()}, processes=stage.processes):
            if name not in runs:
                runs[name] = stack.enter_context(
                    tracking.run(
                        stage=stage.name,
                        experiment=stage.experiment,
                        name=jobs[name].title,
                        params=jobs[name].params,
                        params_file=stage.params_file,
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


def write_curves(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows of curves as CSV; a column is empty where a row does not have it."""
    columns = dict.fromkeys(key for row in rows for key in row)
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(columns), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
