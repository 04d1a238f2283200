"""Real records that nobody here made: what the defaults of `addressed-dynamics new` deliver, beside the references.

The records come with packages, which pip and apt fetch into a temporary folder; nothing of them is kept here. Each is
split in blocks in time, and all of the pipeline up to the evaluation runs in a clone of this repository, once a seed.
"""

import argparse
import csv
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from measuring import print_table
from ruamel.yaml import YAML

ROOT = Path(__file__).resolve().parents[1]
REFERENCES = ("persistence", "linear")
OCTAVE = "octave-control"
"""Debian's package (GPL-3+) of Octave's toolbox for control, whose tests of identification hold real records."""
TESTS = "usr/share/octave/packages/control-*/moen4.m"


@dataclass(frozen=True)
class Record:
    """A real record, as somebody would import it."""

    what: str
    write: Callable[[Path], None]
    """Writes a table of it into a folder."""
    wishes: tuple[str, ...]
    """What `new` is told."""


def ride(folder: Path) -> None:
    """Write the ride of examples/ride."""
    subprocess.run([sys.executable, ROOT / "examples/ride/make_table.py", "--folder", folder], check=True)


def dryer(folder: Path) -> None:
    """Write the hair dryer: the first matrices called Y and U of the tests, column by column."""
    tests = octave_tests()
    y, u = (matrix(tests, name).ravel(order="F") for name in "YU")
    write_table(folder / "dryer.csv", 0.08, {"temperature [V]": y, "heater [V]": u})


def arm(folder: Path) -> None:
    """Write the arm of a CD player. How long a step is nobody says; here it is taken for a second."""
    columns = matrix(octave_tests(), "UY").T
    names = ("force_1", "force_2", "tracking_1", "tracking_2")
    write_table(folder / "arm.csv", 1.0, dict(zip(names, columns, strict=True)))


RECORDS = {
    "ride": Record(
        "a bicycle ride, 8,357 samples at 1 Hz (sweat 0.25.0, MIT)",
        ride,
        ("--observation", "speed [m/s]", "--observation", "heart_rate [1/min]", "--action", "power [W]",
         "--action", "cadence [1/min]", "--exogenous", "slope"),
    ),
    "arm": Record(
        f"the arm of a CD player, 2,048 samples (DaISy 96-007, in {OCTAVE}, GPL-3+)",
        arm,
        ("--observation", "tracking_1", "--observation", "tracking_2", "--action", "force_1", "--action", "force_2"),
    ),
    "dryer": Record(
        f"a hair dryer, 1,000 samples at 12.5 Hz (DaISy 96-006, in {OCTAVE}, GPL-3+)",
        dryer,
        ("--observation", "temperature [V]", "--action", "heater [V]"),
    ),
}  # fmt: skip


def octave_tests() -> str:
    """Return the file of tests that holds the records, from the package that has it."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["apt-get", "download", "--quiet", OCTAVE], cwd=folder, check=True, capture_output=True)
        (package,) = Path(folder).glob("*.deb")
        subprocess.run(["dpkg-deb", "--extract", package, folder], check=True)
        (tests,) = Path(folder).glob(TESTS)
        return tests.read_text(encoding="utf-8")


def matrix(tests: str, name: str) -> np.ndarray:
    """Return the first matrix of this name, which stands in comments of Octave."""
    inside = tests.partition(f" {name} = [")[2].partition("]")[0].replace("%!", "").strip()
    return np.array([[float(each) for each in row.split()] for row in inside.splitlines()])


def write_table(path: Path, step_seconds: float, columns: Mapping[str, np.ndarray]) -> None:
    """Write columns as a table with a clock."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["time [s]", *columns])
        for number, row in enumerate(zip(*columns.values(), strict=True)):
            writer.writerow([round(number * step_seconds, 6), *row])


def evaluations(name: str, seeds: Sequence[int], clone: Path) -> Iterator[dict[str, Any]]:
    """Import a record into a clone of this repository and yield what is measured from each seed."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    settings = os.environ | {"PATH": path, "PYTHONPATH": f"{clone / 'src'}{os.pathsep}{clone}"}

    def call(*command: str) -> None:
        done = subprocess.run(command, cwd=clone, env=settings, text=True, capture_output=True, check=False)
        if done.returncode:
            raise SystemExit(done.stdout + done.stderr)

    record = RECORDS[name]
    record.write(clone / "logs" / name)
    call("addressed-dynamics", "new", name, f"logs/{name}", "--yes", *record.wishes)
    yaml, params = YAML(), clone / "params.yaml"
    for seed in seeds:
        document = yaml.load(params)
        for section in ("ensemble", "baselines"):
            document[name][section]["seeds"] = [seed]
        yaml.dump(document, params)
        call("dvc", "repro", f"evaluate@{name}")
        yield json.loads((clone / "data" / "evaluation" / name / "evaluation.json").read_text(encoding="utf-8"))


def errors(candidate: Mapping[str, Any]) -> dict[str, tuple[float, float, float]]:
    """Return the errors of each dimension of the state: MAE and RMSE of a step, RMSE of the median rollout."""
    spreads = candidate["rollouts"]["groups"]["all"]["mse"]
    one_step = {each["name"]: each for each in candidate["one_step"]["dimensions"]}
    return {
        name: (one_step[name]["absolute"]["mean"], one_step[name]["squared"]["mean"] ** 0.5, spread["median"] ** 0.5)
        for name, spread in spreads.items()
    }


def ratios(evaluation: Mapping[str, Any]) -> dict[str, list[float]]:
    """Return each error of the delivered model over that of the better reference, by dimension."""
    candidates = evaluation["candidates"]
    chosen = errors(candidates[evaluation["choice"]["candidate"]])
    references = [errors(each) for name, each in candidates.items() if name.partition("/")[0] in REFERENCES]
    return {
        name: [own / min(each[name][place] for each in references) for place, own in enumerate(found)]
        for name, found in chosen.items()
    }


def medians_and_worst(of_seeds: Sequence[Sequence[float]]) -> dict[str, tuple[float, float]]:
    """Return the median over the seeds of each ratio, and the worst."""
    several = zip(("mae", "rmse", "rollout"), zip(*of_seeds, strict=True), strict=True)
    return {name: (statistics.median(each), max(each)) for name, each in several}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--record", action="append", choices=RECORDS, help="one of them; all by default")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--figures", type=Path, help="where the figures for docs/results.md go, as JSON")
    parser.add_argument("--folder", type=Path, help="where the clones are kept; a temporary folder by default")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        rows, kept = [], dict[str, Any]()
        for name in arguments.record or RECORDS:
            clone = folder.resolve() / name
            subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
            found = list(evaluations(name, range(arguments.seeds), clone))
            delivered = list(dict.fromkeys(each["choice"]["candidate"].partition("/seed-")[0] for each in found))
            of_seeds = [ratios(each) for each in found]
            dimensions = {
                dimension: medians_and_worst([each[dimension] for each in of_seeds]) for dimension in of_seeds[0]
            }
            kept[name] = {
                "what": RECORDS[name].what,
                "seeds": len(found),
                "delivered": delivered,
                "dimensions": dimensions,
            }
            for dimension, errors_of in dimensions.items():
                cells = [f"{median:.2f} ({worst:.2f})" for median, worst in errors_of.values()]
                rows.append((f"{name}: {dimension}", *cells, ", ".join(delivered)))
            print(f"{name}: {RECORDS[name].what}", flush=True)
        print("Error of what is delivered over that of the better reference: median of the seeds (the worst).")
        print_table(("record: state", "one step: MAE", "RMSE", "rollout: RMSE", "delivered"), rows)
    if arguments.figures:
        arguments.figures.write_text(json.dumps({"records": kept}), encoding="utf-8")


if __name__ == "__main__":
    main()
