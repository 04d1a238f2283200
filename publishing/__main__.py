"""`python -m publishing`: take over the figures of a run, and write the documents anew."""

import argparse
import shutil
import sys
from pathlib import Path

from addressed_dynamics.base.errors import AddressedDynamicsError, ReportError
from publishing import ROOT, documents, figures

FILM = Path("docs", "images", "film.gif")
"""The moving picture of the README."""
FILMED = "mountaincar"


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m publishing", description=__doc__)
    parser.add_argument(
        "--from", dest="run", type=Path, help="root of a repository with a finished run; none by default"
    )
    options = parser.parse_args()
    try:
        for path in made(ROOT, options.run):
            print(path.relative_to(ROOT))
    except AddressedDynamicsError as error:
        sys.exit(f"error: {error}")


def made(root: Path, run: Path | None) -> list[Path]:
    """Write the figures, the picture and the documents of the repository at `root`; return what was written."""
    folder = root / documents.FIGURES
    taken = figures.collect(run, folder) if run else []
    film = [_film(run, root / FILM)] if run and any(path.parent.name == "quick" for path in taken) else []
    figures.stamp(folder, root)
    return [*taken, *film, *documents.write(root)]


def _film(run: Path, target: Path) -> Path:
    """Copy the first film of the report."""
    films = sorted((run / "data" / "reports" / FILMED / "figures").glob("animation-*.gif"))
    if not films:
        message = f"{run}: the report of {FILMED} has no film; run 'dvc repro report@{FILMED}' there"
        raise ReportError(message)
    target.parent.mkdir(exist_ok=True)
    return Path(shutil.copyfile(films[0], target))


if __name__ == "__main__":
    main()
