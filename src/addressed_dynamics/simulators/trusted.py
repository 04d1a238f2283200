"""Where the trust in an experiment's models is written, and for which of them there is one."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.networks.files import read_index
from addressed_dynamics.simulators.calibrated import FOLDER, INDEX
from addressed_dynamics.simulators.delivery import Origin
from addressed_dynamics.simulators.modes import Mode
from addressed_dynamics.simulators.trust import Trust, fingerprint, load_trust, partner_of

if TYPE_CHECKING:
    from addressed_dynamics.simulators.addressed import AddressedDynamics


@dataclass(frozen=True)
class TrustFile:
    """Where to look when a model is asked how far it is to be trusted."""

    models: Path
    """Folder of the experiment's models."""
    origin: Origin | None
    """Which of them it is."""
    mode: Mode
    """How it was loaded."""


def find_trust(place: TrustFile, model: AddressedDynamics) -> Trust:
    """Return the trust in a model.

    Args:
        place: where to look.
        model: that one.

    Raises:
        ModelError: there is none for it, or a file is missing or damaged.
    """
    from addressed_dynamics.simulators.addressed import AddressedDynamics

    folder = place.models / FOLDER
    if place.origin is None:
        message = (
            f"{place.models}: the trust in a model is not beside it but in the folder of the experiment's models; load "
            "the model from there, with its 'candidate' and 'seed'"
        )
        raise ModelError(message)
    if not folder.is_dir():
        message = (
            f"{folder}: missing, so nobody knows how far these models are to be trusted; evaluation calibrates that: "
            f"'dvc repro evaluate@{place.models.name}'"
        )
        raise ModelError(message)
    name, why = _found(folder, place.origin, place.mode)
    if name is None:
        asked = f"{place.origin}, mode {place.mode}"
        message = f"{folder}: no trust was calibrated for {asked}: {why}"
        raise ModelError(message)
    second = partner_of(folder / name)
    try:
        partner = AddressedDynamics.load(place.models, **second)
    except TypeError as error:
        message = f"{folder / name}: incomplete or malformed ({error}); 'dvc repro' brings it back"
        raise ModelError(message) from error
    trust = load_trust(folder / name, partner)
    # Models that were trained anew are others, even if they see the same data in the same way.
    others = trust.networks is not None and trust.networks != (fingerprint(model), fingerprint(partner))
    if trust.gauge.features != model.features or others:
        message = f"{folder / name}: it was calibrated for another model; 'dvc repro' evaluates this one"
        raise ModelError(message)
    return trust


def is_calibrated(place: TrustFile) -> bool:
    """Return whether there is a trust in a model.

    Raises:
        ModelError: the index of those that there are is damaged.
    """
    folder = place.models / FOLDER
    return place.origin is not None and folder.is_dir() and _found(folder, place.origin, place.mode)[0] is not None


def _found(folder: Path, origin: Origin, mode: Mode) -> tuple[str | None, str]:
    """Return the name of the folder with the trust in a model, or None and why there is none."""
    index = read_index(folder, INDEX)
    try:
        entries, missing = [dict(each) for each in index["models"]], index["missing"]
        wanted = {**asdict(origin), "mode": mode}
        found = [str(each["folder"]) for each in entries if wanted.items() <= each.items()]
        shown = [f"{Origin(each['candidate'], each['seed'], each['variant'])}, mode {each['mode']}" for each in entries]
    except (KeyError, TypeError, ValueError) as error:
        message = f"{folder / INDEX}: incomplete or malformed ({error}); 'dvc repro' writes it anew"
        raise ModelError(message) from error
    return (found[0], "") if found else (None, missing or f"there is one for {' and for '.join(shown) or 'no model'}")
