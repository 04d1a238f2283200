"""What is delivered of an experiment's models, and where each of them is in its folder."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.files import write_json
from addressed_dynamics.networks.files import addressed_folders, read_index

FILE = "delivered.json"
"""Name of the file in a folder of models; the evaluation writes it."""
ENSEMBLE = "ensemble"
"""Name of the candidate that is no baseline."""


@dataclass(frozen=True)
class Delivered:
    """Which of the trained ensembles is delivered, and how it is used."""

    seed: int
    """The seed that it was trained from."""
    variant: str | None
    """Its addressing network; None for the one that training chose."""
    mode: str
    """How the outputs of the addressing network are used."""


@dataclass(frozen=True)
class Parts:
    """Where the networks of one model are."""

    network: Path
    """Folder of what predicts."""
    addressing: Path | None
    """Folder of what addresses it; None if there is nothing to choose."""
    mode: str | None
    """How it is delivered; None if that was not asked for."""


def write_delivered(folder: Path, delivered: Delivered) -> None:
    """Write delivered.json into a folder of models."""
    write_json(folder / FILE, {"format": 1, **asdict(delivered)})


def read_delivered(folder: Path) -> Delivered:
    """Read delivered.json of a folder of models.

    Raises:
        ModelError: it is missing or damaged.
    """
    if not (folder / FILE).is_file():
        message = (
            f"{folder / FILE}: missing, so nobody knows which of the models is delivered; evaluation writes it: "
            f"'dvc repro evaluate@{folder.name}', or load one by its 'seed'"
        )
        raise ModelError(message)
    try:
        read = read_index(folder, FILE)
        variant = read["variant"]
        return Delivered(int(read["seed"]), None if variant is None else str(variant), str(read["mode"]))
    except (KeyError, TypeError, ValueError) as error:
        message = (
            f"{folder / FILE}: incomplete or malformed ({error}); 'dvc repro evaluate@{folder.name}' writes it anew"
        )
        raise ModelError(message) from error


def find_parts(folder: Path, candidate: str | None, seed: int | None, variant: str | None) -> Parts:
    """Return where a model is in a folder of models: the delivered one if nothing is asked for.

    Args:
        folder: what the training stages wrote.
        candidate: `ensemble`, or the name of a baseline; None for the ensemble.
        seed: which of the trained seeds; None for the delivered one, or for a baseline's first.
        variant: which addressing network of the ensemble; None for the delivered one, or the one that training chose.

    Raises:
        ModelError: a file is missing or damaged, or there is no such candidate, seed or variant.
    """
    if not folder.is_dir():
        message = f"{folder}: no such model folder; 'dvc repro' trains it, 'dvc checkout' brings it back"
        raise ModelError(message)
    if candidate in (None, ENSEMBLE):
        if seed is not None:
            return Parts(*addressed_folders(folder, seed, variant), None)
        delivered = read_delivered(folder)
        return Parts(*addressed_folders(folder, delivered.seed, variant or delivered.variant), delivered.mode)
    if variant is not None:
        message = f"{folder}: variants are those of the ensemble's addressing network; '{candidate}' has none"
        raise ModelError(message)
    trained = _trained_baselines(folder / "baselines")
    seeds = [each for name, each in trained if name == candidate]
    if not seeds:
        names = ", ".join(dict.fromkeys([ENSEMBLE, *(name for name, _ in trained)]))
        message = f"{folder}: there is no candidate '{candidate}' (candidates there: {names})"
        raise ModelError(message)
    if seed is not None and seed not in seeds:
        message = (
            f"{folder}: '{candidate}' was not trained from seed {seed} (seeds there: {', '.join(map(str, seeds))})"
        )
        raise ModelError(message)
    return parts_in(folder / "baselines" / f"{candidate}/seed-{seeds[0] if seed is None else seed}")


def _trained_baselines(folder: Path) -> list[tuple[str, int]]:
    """Return name and seed of every baseline in the order of training."""
    index = read_index(folder, "baselines.json")
    try:
        pairs = [key.split("/seed-") for key in index["trained"]]
        return [(name, int(seed)) for name, seed in pairs]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        message = f"{folder / 'baselines.json'}: incomplete or malformed ({error}); run train_baselines again"
        raise ModelError(message) from error


def parts_in(folder: Path) -> Parts:
    """Return where the networks of one model are in its own folder."""
    addressing = folder / "addressing"
    return Parts(folder / "network", addressing if addressing.is_dir() else None, None)
