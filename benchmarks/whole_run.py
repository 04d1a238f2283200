"""How long it takes from a clone without anything to the reports: what the README says of both scales.

    python benchmarks/whole_run.py quick --figures docs/figures/durations-quick.json

It measures one scale, in a clone of what is committed; each has a file of its own. Nothing else should run beside it;
`make bench` leaves it out.
"""

import argparse
import json
import os
import subprocess
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = {
    "quick": (("make", "run"),),
    "paper": (("make", "setup"), ("dvc", "exp", "run", "-S", "params_file=params/paper.yaml")),
}
"""What is run for each scale."""


def minutes(scale: str, folder: Path) -> float:
    """Return how long a scale takes in a new clone below `folder`, its installation included."""
    clone = folder / "clone"
    subprocess.run(["git", "clone", "--quiet", "--no-hardlinks", ROOT, clone], check=True)
    here = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    here["PATH"] = f"{clone / '.venv' / 'bin'}{os.pathsep}{here['PATH']}"
    begin = time.perf_counter()
    for command in COMMANDS[scale]:
        subprocess.run(command, cwd=clone, env=here, check=True)
    return (time.perf_counter() - begin) / 60


def main() -> None:
    """Measure, print and keep what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scale", choices=COMMANDS)
    parser.add_argument("--figures", type=Path, help="where the figures for README.md go, as JSON")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        taken = round(minutes(options.scale, Path(folder)))
    cores = len(os.sched_getaffinity(0))
    print(f"{options.scale}: {taken} minutes on {cores} cores")
    if options.figures:
        options.figures.write_text(json.dumps({"minutes": taken, "cores": cores}), encoding="utf-8")


if __name__ == "__main__":
    main()
