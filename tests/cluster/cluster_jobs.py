"""What the workers of the cluster are given to do; they import it by this name."""

import os
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

from learning import ENSEMBLE, car_samples

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.ensemble import train_ensemble
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.shares import Shares


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
