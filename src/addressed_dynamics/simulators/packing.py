"""What is delivered of an experiment's models, as a folder of its own."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.files import atomic_path, write_json
from addressed_dynamics.networks.files import read_index
from addressed_dynamics.simulators import rewards, starts
from addressed_dynamics.simulators.calibrated import FOLDER, INDEX
from addressed_dynamics.simulators.delivery import ENSEMBLE, Delivered, Origin, Parts, find_parts, write_delivered

Loaded = TypeVar("Loaded")


def pack(models: Path, target: Path) -> None:
    """Write a folder of models with the one that is delivered alone, which appears whole or not at all.

    It loads as the whole one does. If there is a trust in the model, that is there, too, with the second model that it
    is held against; and so are the states that a learned environment starts in, and who says its reward and end.

    Args:
        models: an experiment's models.
        target: the folder to write; one that is there is replaced.

    Raises:
        ModelError: a file is missing or damaged.
    """
    parts = find_parts(models, None, None, None)
    assert parts.origin is not None
    trust = _trust_in(models, parts)
    packed = [parts]
    if trust is not None:
        second = read_index(models / FOLDER / trust["folder"], "trust.json")["partner"]
        packed.append(find_parts(models, second["candidate"], second["seed"], second["variant"]))
    with atomic_path(target) as folder:
        folder.mkdir(parents=True)
        for network in {each for part in packed for each in (part.network, part.addressing) if each is not None}:
            shutil.copytree(network, folder / network.relative_to(models))
        _write_indices(folder, [part.origin for part in packed if part.origin is not None])
        origin = parts.origin
        write_delivered(folder, Delivered(origin.seed, origin.variant, parts.mode, candidate=origin.candidate))
        (folder / FOLDER).mkdir()
        missing = None if trust else "none was calibrated for the model that is delivered"
        index = {"format": 1, "models": [trust] if trust else [], "missing": missing}
        if trust is not None:
            shutil.copytree(models / FOLDER / trust["folder"], folder / FOLDER / trust["folder"])
        write_json(folder / FOLDER / INDEX, index)
        for whole in (starts.FOLDER, rewards.FOLDER):
            if (models / whole).is_dir():
                shutil.copytree(models / whole, folder / whole)


def packed(models: Path, load: Callable[[Path], Loaded], target: Path) -> Loaded:
    """Write what `pack` does, and return what `load` makes of it.

    Raises:
        ModelError: as in `pack`, or it cannot be loaded.
    """
    pack(models, target)
    return load(target)


def _trust_in(models: Path, parts: Parts) -> dict[str, Any] | None:
    """Return what the index of trusts has of a model; None if none was calibrated."""
    if parts.origin is None or not (models / FOLDER).is_dir():
        return None
    wanted = {**asdict(parts.origin), "mode": parts.mode or "argmax"}
    try:
        entries = [dict(each) for each in read_index(models / FOLDER, INDEX)["models"]]
        return next((each for each in entries if wanted.items() <= each.items()), None)
    except (KeyError, TypeError, ValueError) as error:
        message = f"{models / FOLDER / INDEX}: incomplete or malformed ({error}); 'dvc repro' writes it anew"
        raise ModelError(message) from error


def _write_indices(folder: Path, origins: list[Origin]) -> None:
    """Write which models are in a folder, in the form of the trainings."""
    addressed = {str(each.seed): each.variant for each in origins if each.candidate == ENSEMBLE}
    if addressed:
        index = {"format": 1, "delivered": addressed, "variants": sorted({each or "" for each in addressed.values()})}
        write_json(folder / "addressing" / "addressing.json", index)
    trained = [f"{each.candidate}/seed-{each.seed}" for each in origins if each.candidate != ENSEMBLE]
    if trained:
        write_json(folder / "baselines" / "baselines.json", {"format": 1, "trained": trained, "pair": []})
