"""What the workers of the cluster are given to do; they import it by this name."""

import os
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

from learning import ENSEMBLE, car_samples

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.importing import importer
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.sources.transitions import conversion
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.ensemble import train_ensemble
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.shares import Shares

FIRST_TRIED = ".tried.partial"
"""A file that says that a worker was killed; it goes with what killed workers leave."""


def squared(number: int) -> tuple[int, int]:
    """Return the square, and who computed it."""
    return number * number, os.getpid()


def lost_once(place: Path) -> str:
    """Be killed the first time; say the second time that it was."""
    if not place.exists():
        place.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return f"begun anew in {socket.gethostname()}"


def always_lost(_: int) -> None:
    """Be killed every time."""
    os.kill(os.getpid(), signal.SIGKILL)


def converted_once_lost(job: conversion._Job) -> conversion._Figures:
    """Convert a log; be killed the first time, with half of a table written."""
    lost = job.target.parent / FIRST_TRIED
    if not lost.exists():
        lost.touch()
        half = job.target / "train" / f".{job.log.stem}.parquet.1.partial"
        half.parent.mkdir(parents=True, exist_ok=True)
        half.write_bytes(b"PAR1")
        os.kill(os.getpid(), signal.SIGKILL)
    return conversion._convert(job)


def imported_once_lost(given: Agreement, job: importer._Job) -> importer._Attempt:
    """Import a recording; be killed the first time, with half of a log written."""
    lost = job.folder / FIRST_TRIED
    if not lost.exists():
        lost.touch()
        half = job.folder / f".{job.first:04d}.1.partial"
        half.mkdir()
        (half / "log.mcap.partial").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return importer._attempt(given, job)


def failing(_: int) -> None:
    """Raise an error of the project."""
    message = "the training loss is not finite any more"
    raise TrainingError(message)


def trained(
    seed: int, folder: Path, deadly_epoch: int | None = None, slow: float = 0.0, shares: int = 1, deadly_rank: int = 0
) -> Iterator[Epoch]:
    """Train a small ensemble with a checkpoint; be killed once after an epoch, if one is given.

    If several do so together, it is the one of `deadly_rank` that is killed.
    """
    _, train, validation = car_samples()
    checkpoint = Checkpoint(folder / f"{seed}.safetensors")
    died = folder / f"{seed}.died"
    params = ENSEMBLE.model_copy(update={"shares": shares})
    for epoch in train_ensemble(train, validation, params, seed=seed, loss_unit=1.0, checkpoint=checkpoint):
        yield epoch
        with (folder / "workers").open("a", encoding="utf-8") as log:
            log.write(f"{seed} {os.getpid()} {epoch.index}\n")
        time.sleep(slow)
        rank = Shares.here(shares).rank
        if epoch.index == deadly_epoch and rank == deadly_rank and not died.exists():
            died.touch()
            os.kill(os.getpid(), signal.SIGKILL)
