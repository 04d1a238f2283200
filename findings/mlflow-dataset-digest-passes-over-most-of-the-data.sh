#!/usr/bin/env bash
# mlflow 3.17.2: a dataset's digest stays the same where rows after the 10,000th, or whole columns, have other values.
#
# A run keeps a name and a digest of the data it was given (mlflow.data, log_input), and the interface shows them, so that one can tell
# whether two runs saw the same. The digest of a DataFrame is of its first 10,000 rows, its number of rows and its column names, and of
# those rows it takes columns of numbers, and of strings none of which is missing: a flag that is flipped, a time, a list in each row (a
# vector observation), a string column with one None may change throughout. That of a NumPy array is of its first 10,000 numbers, which for
# 100 columns is 100 rows. Two arrays of which one is the other with the rest of it corrected have one digest.
#
# Seen (mlflow 3.17.2, pandas 3.1.1, numpy 2.4.6, Python 3.11): the same digest in all six cases below, another one where the first
# rows of a column of numbers differ. This script exits with 0 as long as that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mlflow==3.17.2 pandas==3.1.1 numpy==2.4.6

cd "$folder"
MLFLOW_DISABLE_TELEMETRY=true "$folder/venv/bin/python" - <<'PYTHON'
import sys

import mlflow.data
import numpy as np
import pandas as pd

ROWS = 20_000
LATER = np.arange(ROWS) >= 10_000


def of_frame(**columns: object) -> str:
    """Return the digest of a DataFrame with these columns beside one of numbers."""
    return mlflow.data.from_pandas(pd.DataFrame({"step": range(len(next(iter(columns.values())))), **columns})).digest


def of_array(values: np.ndarray) -> str:
    """Return the digest of an array."""
    return mlflow.data.from_numpy(values).digest


WIDE = np.ones((ROWS, 100), np.float32)
pairs = {
    "a number in rows after the 10,000th": (of_frame(x=np.ones(ROWS)), of_frame(x=np.where(LATER, -1.0, 1.0))),
    "a flag": (of_frame(ended=[True, False, False]), of_frame(ended=[False, True, True])),
    "a time": (of_frame(at=pd.date_range("2020", periods=3)), of_frame(at=pd.date_range("2021", periods=3))),
    "a vector": (of_frame(state=[np.ones(2)] * 3), of_frame(state=[np.zeros(2)] * 3)),
    "a string, one missing": (of_frame(gear=["up", "down", None]), of_frame(gear=["down", "up", None])),
    "an array after its row 100 of 20,000": (of_array(WIDE), of_array(np.where(np.arange(ROWS)[:, None] < 100, WIDE, 7.0))),
}
for what, (one, other) in pairs.items():
    print(f"{what}: {one} and {other}")
differs = of_frame(x=np.ones(3)) != of_frame(x=np.zeros(3))
print("numbers in the first rows: another digest:", differs)
sys.exit(0 if differs and all(one == other for one, other in pairs.values()) else 1)
PYTHON
