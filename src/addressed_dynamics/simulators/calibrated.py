"""The folder in which the trust in an experiment's models is kept, whatever kind of data they are of."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from addressed_dynamics.base.files import atomic_path, write_json
from addressed_dynamics.simulators.delivery import Origin

FOLDER = "trust"
"""Name of the folder in a folder of models."""
INDEX = "trust.json"


@dataclass(frozen=True)
class Calibrated:
    """The trust in one model."""

    origin: Origin
    mode: str
    """The addressing mode in which it was calibrated."""
    save: Callable[[Path], None]
    """Writes it into a folder of its own."""


def write_trust(models: Path, calibrated: Sequence[Calibrated], missing: str | None) -> None:
    """Write the trust in some of an experiment's models, in place of what was there.

    Args:
        models: folder of the experiment's models.
        calibrated: those that there is one for.
        missing: why there is none for any; None if there is.
    """
    with atomic_path(models / FOLDER) as folder:
        folder.mkdir(parents=True)
        entries = []
        for each in calibrated:
            origin = each.origin
            parts = [origin.candidate, f"seed-{origin.seed}", *([origin.variant] if origin.variant else []), each.mode]
            name = "-".join(parts)
            each.save(folder / name)
            entries.append({**asdict(origin), "mode": each.mode, "folder": name})
        write_json(folder / INDEX, {"format": 1, "models": entries, "missing": missing})
