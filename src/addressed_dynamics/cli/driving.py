"""From a name on the command line to a page in which it is driven."""

from __future__ import annotations

import secrets
from pathlib import Path

from addressed_dynamics.base.errors import DriveError
from addressed_dynamics.base.files import why_not_folder
from addressed_dynamics.drive.finding import Named, find
from addressed_dynamics.drive.motion import DrivenMotion
from addressed_dynamics.drive.transitions import DrivenWorld

RECORDINGS = Path("data/driven")
"""Where recordings go if nobody says."""
STARTS = 2**32
"""Seeds between those of two pages: each start of a page takes the next one."""


def drive_in_page(
    name: str,
    params: Path | None,
    *,
    port: int | None,
    candidate: str | None,
    environment: str | None,
    record_to: Path | None,
    seed: int | None,
) -> None:
    """Serve a page until Ctrl-C.

    Args:
        name: an experiment, or a model folder.
        params: the params file; None for the project's, if there is one.
        port: where to serve it; None for the usual one.
        candidate: which of the models; None for what is delivered.
        environment: Gymnasium identifier of what is modelled; None to look for it.
        record_to: folder for recordings; None for one named as the models are.
        seed: of the first start of the first page; None for one by chance.

    Raises:
        DriveError: there is nothing of that name, the folder for recordings cannot be written, aiohttp is missing, or
            the port is in use.
        ParamsError: the params file is not there, or does not have the experiment.
        ModelError: a model is missing or damaged, or of a version that this one does not read.
    """
    try:
        from addressed_dynamics.drive.server import PORT, serve
    except ModuleNotFoundError as error:
        if error.name != "aiohttp":
            raise
        message = "'drive' needs aiohttp, which is not installed: pip install 'addressed-dynamics[drive]'"
        raise DriveError(message) from error
    if record_to is not None and (problem := why_not_folder(record_to)) is not None:
        message = f"--record-to {record_to}: {problem}; name another folder"
        raise DriveError(message)
    named = find(name, params, candidate)
    driven = _load(named, candidate, environment)
    folder = record_to or RECORDINGS / named.folder.resolve().name
    first = secrets.randbits(32) if seed is None else seed
    serve(lambda page: driven.session(first + page * STARTS, folder), PORT if port is None else port, _say)


def _load(named: Named, candidate: str | None, environment: str | None) -> DrivenWorld | DrivenMotion:
    match named.kind:
        case "transitions":
            return DrivenWorld.load(named, candidate, environment)
        case "motion":
            return DrivenMotion.load(named, candidate)
        case _:
            message = f"{named.folder}: models of '{named.kind}' cannot be driven; those of transitions and motion can"
            raise DriveError(message)


def _say(line: str) -> None:
    print(line, flush=True)  # noqa: T201 - a command line prints
