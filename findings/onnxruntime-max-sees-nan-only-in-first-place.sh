#!/usr/bin/env bash
# onnxruntime 1.32.0: ArgMax and ReduceMax see a NaN only where it stands first, and pass over it anywhere else.
#
# numpy and torch answer NaN for the largest of numbers among which there is one, and its place for argmax: whoever exports a network
# that picks by argmax (a gate, a mixture of experts, a policy) expects a broken input to be as visible as before. ONNX Runtime on the
# CPU compares with '>', which is false for NaN: behind the first place it never wins, in the first place it never loses. So the same
# three numbers in another order give 0.3 or NaN, and a pick that looks like any other. Min and ArgMin are alike. Max of two tensors and
# the nonlinear functions keep NaN; Sign keeps it, too, where torch.sign answers 0.
#
# Seen (onnxruntime 1.32.0, onnx 1.23.2, numpy 2.4.6, Python 3.11), rows of [a, b, c]:
#   [nan, 0.2, 0.3]: ReduceMax nan, ArgMax 0 (numpy: nan, 0)
#   [0.1, nan, 0.3]: ReduceMax 0.3, ArgMax 2 (numpy: nan, 1)
#   [0.5, 0.2, nan]: ReduceMax 0.5, ArgMax 0 (numpy: nan, 2)
# This script exits with 0 as long as that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check numpy==2.4.6 onnx==1.23.2 onnxruntime==1.32.0

cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import onnxruntime
from onnx import TensorProto, helper

ROWS = np.array([[np.nan, 0.2, 0.3], [0.1, np.nan, 0.3], [0.5, 0.2, np.nan]], np.float32)


def answer(operator: str, *inputs: np.ndarray, **attributes: int) -> np.ndarray:
    """Return what a graph of one operator answers."""
    names = [f"x{number}" for number in range(len(inputs))]
    kind = TensorProto.INT64 if operator.startswith("Arg") else TensorProto.FLOAT
    axes = {"axes": [1]} if operator.startswith("Reduce") else {}
    graph = helper.make_graph(
        [helper.make_node(operator, names, ["y"], **attributes, **axes)],
        "one",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, each.shape) for name, each in zip(names, inputs)],
        [helper.make_tensor_value_info("y", kind, None)],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return session.run(None, dict(zip(names, inputs)))[0]


largest, place = answer("ReduceMax", ROWS, keepdims=0), answer("ArgMax", ROWS, axis=1, keepdims=0)
smallest, least = answer("ReduceMin", ROWS, keepdims=0), answer("ArgMin", ROWS, axis=1, keepdims=0)
print("ReduceMax", largest, "numpy", ROWS.max(1), "; ArgMax", place, "numpy", ROWS.argmax(1))
print("ReduceMin", smallest, "numpy", ROWS.min(1), "; ArgMin", least, "numpy", ROWS.argmin(1))
kept = [answer(name, ROWS) for name in ("Relu", "Tanh", "Sign")] + [answer("Max", ROWS, np.zeros_like(ROWS))]
as_described = (
    np.array_equal(largest, np.float32([np.nan, 0.3, 0.5]), equal_nan=True)
    and place.tolist() == [0, 2, 0]
    and np.array_equal(smallest, np.float32([np.nan, 0.1, 0.2]), equal_nan=True)
    and least.tolist() == [0, 0, 1]
    and np.isnan(ROWS.max(1)).all()
    and ROWS.argmax(1).tolist() == [0, 1, 2]
    and all(np.array_equal(np.isnan(each), np.isnan(ROWS)) for each in kept)
)
sys.exit(0 if as_described else 1)
PYTHON
