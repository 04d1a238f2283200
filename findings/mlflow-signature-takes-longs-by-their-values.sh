#!/usr/bin/env bash
# mlflow 3.17.2: whether a pyfunc takes an int64 column where its signature says double depends on the numbers in it.
#
# A signature's 'double' takes int32 and float32. Of int64, pandas' own type for whole numbers, MLflow says that it cannot be
# converted safely, and refuses [1, 2] or [-1, 0]. But a column in which every value is 0 or 1 passes, so the same call of the same
# model, with columns of the same types, works on one table and raises an MlflowException on the next: with the one-hot actions or
# flags that somebody tries first, and no more when an action becomes 2. (The exception is meant for booleans that were read as
# numbers.) What decides is the whole table, not the row: 0 and 1 are refused, too, if a 2 stands below them.
#
# Seen (mlflow 3.17.2, pandas 3.1.1, Python 3.11): as above. This script exits with 0 as long as that is so, and with 1 when it
# changes. Give such columns as floats.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mlflow==3.17.2 pandas==3.1.1

cd "$folder"
export MLFLOW_DISABLE_TELEMETRY=true DO_NOT_TRACK=true
cat > doubled.py <<'PYTHON'
import mlflow


class Doubled(mlflow.pyfunc.PythonModel):
    def predict(self, context, model_input, params=None):
        return 2.0 * model_input["action"]


mlflow.models.set_model(Doubled())
PYTHON
"$folder/venv/bin/python" -W ignore - <<'PYTHON'
import logging
import sys

import mlflow
import numpy as np
import pandas as pd
from mlflow.models import ModelSignature
from mlflow.types import ColSpec, Schema

logging.disable(logging.WARNING)
double = Schema([ColSpec("double", "action")])
mlflow.pyfunc.save_model(
    "model", python_model="doubled.py", signature=ModelSignature(inputs=double), pip_requirements=["mlflow==3.17.2"]
)
model = mlflow.pyfunc.load_model("model", suppress_warnings=True)


def takes(values: list[int], dtype: type) -> bool:
    try:
        found = model.predict(pd.DataFrame({"action": np.array(values, dtype)}))
    except mlflow.MlflowException as error:
        assert "Can not safely convert int64 to float64" in str(error), error
        return False
    assert found.tolist() == [2.0 * each for each in values]
    return True


seen = {
    "int64 [0, 1, 1]": takes([0, 1, 1], np.int64),
    "int64 [1, 1]": takes([1, 1], np.int64),
    "int64 [0, 1, 2]": takes([0, 1, 2], np.int64),
    "int64 [-1, 0]": takes([-1, 0], np.int64),
    "int32 [0, 1, 2]": takes([0, 1, 2], np.int32),
}
for name, taken in seen.items():
    print(f"{name}: {'taken' if taken else 'refused'}")
sys.exit(list(seen.values()) != [True, True, False, False, True])
PYTHON
