#!/usr/bin/env bash
# pyarrow 25.0.1: filters on a Parquet file lose rows whose value is NaN, or count too many, where statistics can answer.
#
# Parquet's statistics leave NaN out. A pyarrow dataset takes them for what holds of all rows of a row group, and answers a filter from
# them alone where it can. So a sensor that says 1.0 all the time but for one NaN has no NaN by 'is_nan(x)', and nothing that is
# 'not finite'; where it varies from 0.1 to 1.0, '~(x <= 1.0)', which holds of NaN, finds nothing. Counting is wrong the other way:
# 'count_rows' of 'x <= 1.0' counts the NaN, which 'to_table' with the same filter does not return. The same table in memory, and
# the same file written without statistics, give each time what comparisons with NaN should. pq.read_table(filters=...) is such a dataset.
#
# Seen (pyarrow 25.0.1, numpy 2.4.6, Python 3.11): as below; of three rows, one of them NaN. This script exits with 0 as long
# as that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check pyarrow==25.0.1 numpy==2.4.6

cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq

X = pc.field("x")
CONSTANT, VARYING = [1.0, np.nan, 1.0], [0.1, np.nan, 1.0]
ASKED = [
    # values, filter, and how many rows: file, file without statistics, memory; counted in the file
    ("constant", CONSTANT, "is_nan(x)", pc.is_nan(X), (0, 1, 1, 0)),
    ("constant", CONSTANT, "~is_finite(x)", ~pc.is_finite(X), (0, 1, 1, 0)),
    ("constant", CONSTANT, "x != 1.0", X != 1.0, (0, 1, 1, 0)),
    ("varying", VARYING, "is_nan(x)", pc.is_nan(X), (1, 1, 1, 1)),
    ("varying", VARYING, "~(x <= 1.0)", ~(X <= 1.0), (0, 1, 1, 0)),
    ("varying", VARYING, "x <= 1.0", X <= 1.0, (2, 2, 2, 3)),
]

as_described = True
for name, values, words, asked, expected in ASKED:
    table = pa.table({"x": np.array(values)})
    pq.write_table(table, "file.parquet")
    pq.write_table(table, "bare.parquet", write_statistics=False)
    rows = tuple(ds.dataset(each).to_table(filter=asked).num_rows for each in ("file.parquet", "bare.parquet", table))
    counted = ds.dataset("file.parquet").count_rows(filter=asked)
    print(f"{name:9} {words:14} file {rows[0]}, without statistics {rows[1]}, memory {rows[2]}; counted in the file {counted}")
    as_described &= (*rows, counted) == expected and pq.read_table("file.parquet", filters=asked).num_rows == rows[0]
sys.exit(0 if as_described else 1)
PYTHON
