"""What is delivered of an experiment's models, and where each of them is in its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal, get_args

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.files import write_json
from addressed_dynamics.base.params.experiments import PARAMS, known_experiments
from addressed_dynamics.base.params.training import Trained
from addressed_dynamics.networks.files import addressed_folders, read_index
from addressed_dynamics.training.baselines import OTHER_RECIPE
from addressed_dynamics.training.references import LAST_CHANGE, LINEAR_FRAME

MODELS = Path("data/models")
"""Where the pipeline keeps the models of experiments."""
FILE = "delivered.json"
"""Name of the file in a folder of models; the evaluation writes it."""
ENSEMBLE = "ensemble"
"""Name of the candidate that is no baseline."""
ROOMS = ("ensemble", "addressing", "baselines")
"""Folders that the trainings make in a folder of models."""
RUN_FILE = "mlflow_run.json"
"""Name of what earlier versions left beside every network."""


RECOMMENDED = "recommended"
"""Name that stands for the candidate that holds longest on validation episodes."""


Why = Literal["asked", "best", "reference", "unmeasured"]
"""Why a model is delivered: the params file asks for it; it is the best on validation episodes, or the simplest of
those that are about as good; it is a reference, than which no trained model is clearly better there; or there are none,
and it is the addressed ensemble for want of a choice."""


@dataclass(frozen=True)
class Choice:
    """One of all trained models, and how it is used."""

    candidate: str
    """`ensemble`, or the name of a baseline."""
    seed: int
    """The seed that it was trained from."""
    variant: str | None
    """Its addressing network; None for a baseline, or for the one that training chose."""
    mode: str | None
    """How the outputs of the addressing network are used; None for the way in which it was saved."""


@dataclass(frozen=True)
class Delivered:
    """Which of the trained models is delivered, and how it is used."""

    seed: int
    """The seed that it was trained from."""
    variant: str | None
    """Its addressing network; None for a baseline, or for the one that training chose."""
    mode: str | None
    """How the outputs of the addressing network are used; None for the way in which it was saved."""
    recommended: Choice | None = None
    """Which model held longest on validation episodes; None if that was not measured."""
    candidate: str = ENSEMBLE
    """`ensemble`, or the name of a baseline."""
    ensemble: Choice | None = None
    """The addressed ensemble that stands for all, if something else is delivered; None: it is what is delivered."""
    why: Why | None = None
    """None if nobody says."""
    scores: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """What the model, the addressed ensemble and the best reference reach on validation episodes, by the names of
    candidates; the model comes first."""

    @property
    def choice(self) -> Choice:
        """The model that is delivered."""
        return Choice(self.candidate, self.seed, self.variant, self.mode)


@dataclass(frozen=True)
class Origin:
    """Which of an experiment's models a model is."""

    candidate: str
    """`ensemble`, or the name of a baseline."""
    seed: int
    """The seed that it was trained from."""
    variant: str | None = None
    """Its addressing network; None for a baseline."""

    def __str__(self) -> str:
        """Return it in words."""
        variant = "" if self.variant is None else f", variant {self.variant}"
        return f"candidate {self.candidate}, seed {self.seed}{variant}"


@dataclass(frozen=True)
class Parts:
    """Where the networks of one model are."""

    network: Path
    """Folder of what predicts."""
    addressing: Path | None
    """Folder of what addresses it; None if there is nothing to choose."""
    mode: str | None
    """How it is delivered; None if that was not asked for."""
    origin: Origin | None = None
    """Which of the experiment's models it is; None if its own folder was named."""


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
            f"{folder / FILE}: missing{_age(folder)}, so nobody knows which of the models is delivered; evaluation "
            f"writes it: 'dvc repro evaluate@{folder.name}', or load one by its 'seed'"
        )
        raise ModelError(message)
    try:
        read = read_index(folder, FILE)
        variant = read["variant"]
        recommended, ensemble = (
            None if read.get(name) is None else Choice(**read[name]) for name in ("recommended", "ensemble")
        )
        return Delivered(
            int(read["seed"]),
            None if variant is None else str(variant),
            None if read["mode"] is None else str(read["mode"]),
            recommended,
            str(read.get("candidate", ENSEMBLE)),
            ensemble,
            next((each for each in get_args(Why) if each == read.get("why")), None),
            dict(read.get("scores", {})),
        )
    except (KeyError, TypeError, ValueError) as error:
        message = (
            f"{folder / FILE}: incomplete or malformed ({error}); 'dvc repro evaluate@{folder.name}' writes it anew"
        )
        raise ModelError(message) from error


def _age(folder: Path) -> str:
    """Return a remark if the models are of a version that kept the ids of its runs beside them, and delivered none."""
    if any(folder.rglob(RUN_FILE)):
        return f" (an earlier version of this package trained these models: there is '{RUN_FILE}' among them)"
    return ""


def find_models(name: str, models: Path = MODELS, params: Path = PARAMS) -> Path:
    """Return the folder that is meant by the name of an experiment with models, or by a folder.

    Args:
        name: either.
        models: where the models of experiments are.
        params: the params file that says which experiments there are; it need not be there.

    Raises:
        ModelError: there is neither.
    """
    if len(Path(name).parts) == 1 and (models / name).is_dir():
        return models / name
    if name and Path(name).is_dir():
        return Path(name)
    if name in known_experiments(params):
        message = f"the experiment '{name}' has no models yet; 'dvc repro evaluate@{name}' makes them"
    else:
        message = f"there is neither an experiment '{name}' nor a folder of that name ({known_words(models, params)})"
    raise ModelError(message)


def known_words(folder: Path, params: Path = PARAMS) -> str:
    """Say which experiments there are: of a params file, if it is there, and those that have something in a folder."""
    named = f"experiments of {params}: {', '.join(known_experiments(params)) or 'none'}; " if params.is_file() else ""
    made = ", ".join(sorted(path.name for path in folder.iterdir() if path.is_dir())) if folder.is_dir() else ""
    return f"{named}in {folder}: {made or 'none'}"


def find_parts(folder: Path, candidate: str | None, seed: int | None, variant: str | None) -> Parts:
    """Return where a model is in a folder of models, the delivered one if nothing is asked for, or in its own folder.

    Args:
        folder: what the training stages wrote, or the folder of one model, of which there is nothing to choose.
        candidate: `ensemble`, the name of a baseline, or `recommended`; None for what is delivered, or for the ensemble
            if a seed or a variant is asked for.
        seed: which of the trained seeds; None for the one that stands for all, or for a baseline's first.
        variant: which addressing network of the ensemble; None for the one that stands for all, or that training chose.

    Raises:
        ModelError: a file is missing or damaged, there is no such candidate, seed or variant, or one was asked for of
            the folder of one model.
    """
    if not folder.is_dir():
        how = f"; 'dvc repro evaluate@{folder.name}' makes it, 'dvc checkout' brings it back"
        known = folder.name in known_experiments()
        message = f"{folder}: no such model folder{how if known else f' ({known_words(MODELS)})'}"
        raise ModelError(message)
    if (folder / "network").is_dir():
        asked = {"candidate": candidate, "seed": seed, "variant": variant}
        if given := [name for name, value in asked.items() if value is not None]:
            message = (
                f"{folder}: this is one saved model, of which no {' or '.join(given)} can be chosen; "
                "leave that out, or load the folder of the experiment's models"
            )
            raise ModelError(message)
        return parts_in(folder)
    if not any((folder / name).exists() for name in (*ROOMS, FILE)):
        there = ", ".join(sorted(path.name for path in folder.iterdir() if path.is_dir())[:5]) or "none"
        message = (
            f"{folder}: neither a saved model nor the models of an experiment, for instance 'data/models/mountaincar' "
            f"(folders in it: {there})"
        )
        raise ModelError(message)
    if candidate == RECOMMENDED:
        return _recommended(folder, seed, variant)
    if candidate is None and seed is None and variant is None:
        return _chosen(folder, read_delivered(folder).choice)
    if candidate in (None, ENSEMBLE):
        if seed is not None:
            return _ensemble(folder, seed, variant, None)
        delivered = read_delivered(folder)
        own = delivered.ensemble or delivered.choice
        return _ensemble(folder, own.seed, variant or own.variant, own.mode)
    if variant is not None:
        message = f"{folder}: variants are those of the ensemble's addressing network; '{candidate}' has none"
        raise ModelError(message)
    trained = _trained_baselines(folder / "baselines")
    seeds = [each for name, each in trained if name == candidate]
    if not seeds:
        names = ", ".join(dict.fromkeys([ENSEMBLE, *(name for name, _ in trained)]))
        message = f"{folder}: there is no candidate '{candidate}' (candidates there: {names}){_how_to_get(candidate)}"
        raise ModelError(message)
    if seed is not None and seed not in seeds:
        message = (
            f"{folder}: '{candidate}' was not trained from seed {seed} (seeds there: {', '.join(map(str, seeds))})"
        )
        raise ModelError(message)
    chosen = Origin(str(candidate), seeds[0] if seed is None else seed)
    return replace(parts_in(folder / "baselines" / f"{candidate}/seed-{chosen.seed}"), origin=chosen)


def _how_to_get(candidate: str | None) -> str:
    """Say what to do for a candidate that was not trained; nothing of a name that there is none of."""
    name = "other_recipe" if candidate in OTHER_RECIPE.values() else candidate
    if name in get_args(Trained):
        return f"; name it in baselines.train ('{name}') and run train_baselines again"
    if name in (LAST_CHANGE, LINEAR_FRAME):
        return "; there is one if features.history is above 1 and train_baselines has run since"
    return ""


def _recommended(folder: Path, seed: int | None, variant: str | None) -> Parts:
    if seed is not None or variant is not None:
        message = f"{folder}: what is recommended has a seed and a variant of its own; leave 'seed' and 'variant' out"
        raise ModelError(message)
    chosen = read_delivered(folder).recommended
    if chosen is None:
        message = (
            f"{folder / FILE}: it recommends no model; 'dvc repro evaluate@{folder.name}' does if there are validation "
            "episodes"
        )
        raise ModelError(message)
    return _chosen(folder, chosen)


def _chosen(folder: Path, chosen: Choice) -> Parts:
    if chosen.candidate == ENSEMBLE:
        return _ensemble(folder, chosen.seed, chosen.variant, chosen.mode)
    return replace(find_parts(folder, chosen.candidate, chosen.seed, None), mode=chosen.mode)


def _ensemble(folder: Path, seed: int, variant: str | None, mode: str | None) -> Parts:
    network, addressing = addressed_folders(folder, seed, variant)
    return Parts(network, addressing, mode, Origin(ENSEMBLE, seed, addressing.name))


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
