#!/usr/bin/env bash
# onnxruntime 1.32.0 and pyarrow 25.0.1 (Tensor): an array in the other byte order is taken as it lies in memory, and its numbers are others.
#
# Logs, HDF5, FITS and netCDF files and np.frombuffer(message, ">f4") bring arrays whose type is '>f4', which NumPy computes with like any
# other; of a big-endian 1.0 onnxruntime makes 4.6e-41. InferenceSession.run, OrtValue.ortvalue_from_numpy and pyarrow.Tensor.from_numpy look
# at the kind and the size of the type alone: no error, no warning, and most outputs are finite. PyTorch (from_numpy), pyarrow's own
# pa.array and onnx (numpy_helper.from_array) refuse such an array; safetensors and polars turn its bytes round.
#
# Seen (onnxruntime 1.32.0, onnx 1.23.2, pyarrow 25.0.1, numpy 2.4.6, Python 3.11, a little-endian machine): as above.
# This script exits with 0 as long as that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check onnxruntime==1.32.0 onnx==1.23.2 pyarrow==25.0.1 numpy==2.4.6

"$folder/venv/bin/python" -W error - <<'PYTHON'
import sys

import numpy as np
import onnx
import onnxruntime
import pyarrow
from onnx import TensorProto, helper, numpy_helper

nodes = [helper.make_node("Mul", ["x", "x"], ["y"])]
sides = [[helper.make_tensor_value_info(name, TensorProto.FLOAT, [3])] for name in "xy"]
model = helper.make_model(
    helper.make_graph(nodes, "square", *sides), opset_imports=[helper.make_opsetid("", 17)], ir_version=10
)
session = onnxruntime.InferenceSession(model.SerializeToString())
native = np.array([1.0, 2.0, 3.0], dtype="<f4")
swapped = native.astype(">f4")
assert np.array_equal(native, swapped)


def refuses(question):
    try:
        question()
    except (ValueError, TypeError, pyarrow.ArrowNotImplementedError):
        return True
    return False


as_they_lie = np.frombuffer(swapped.tobytes(), "<f4")
found = {
    "InferenceSession.run squares them to": (session.run(None, {"x": swapped})[0], as_they_lie * as_they_lie),
    "OrtValue holds": (onnxruntime.OrtValue.ortvalue_from_numpy(swapped).numpy(), as_they_lie),
    "pyarrow.Tensor holds": (pyarrow.Tensor.from_numpy(swapped).to_numpy(), as_they_lie),
}
print("native:", session.run(None, {"x": native})[0])
for what, (seen, _) in found.items():
    print(f"big-endian [1, 2, 3]: {what} {seen}")
as_described = (
    all(np.array_equal(seen, expected) for seen, expected in found.values())
    and np.array_equal(session.run(None, {"x": native})[0], [1.0, 4.0, 9.0])
    and refuses(lambda: pyarrow.array(swapped))
    and refuses(lambda: numpy_helper.from_array(swapped))
)
sys.exit(0 if sys.byteorder == "little" and as_described else 1)
PYTHON
