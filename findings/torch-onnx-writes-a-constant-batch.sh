#!/usr/bin/env bash
# torch 2.13.0: torch.onnx.export turns a batch that was asked to be dynamic into a constant, and reports success.
#
# In both torch.export.export and torch.onnx.export(dynamo=True) a torch.export.Dim in 'dynamic_shapes' asks for a dynamic axis.
# A module that takes the length of its batch by 'len(x)' makes it a constant, where one with 'x.shape[0]' does not.
# torch.export.export refuses the first with a UserError, "Constraints violated (batch)". torch.onnx.export, given the same
# module, inputs and Dim, raises nothing and warns of nothing that names the axis, prints a tick behind every step, and writes a
# graph whose input is 2 rows long, the size of the example: ONNX Runtime then refuses every other batch, one row among them.
# Whoever tries what was exported with the example it was exported with will not notice.
#
# Seen (torch 2.13.0, onnx 1.23.2, onnxscript 0.7.2, onnxruntime 1.32.0, Python 3.11): as above; with x.shape[0] the axis is
# dynamic in both. This script exits with 0 as long as that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    torch==2.13.0 numpy==2.4.6 onnx==1.23.2 onnxscript==0.7.2 onnxruntime==1.32.0

cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import contextlib
import io
import sys
import warnings

import numpy as np
import onnxruntime
import torch


class ByLength(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x.new_zeros(len(x), 3) + x.sum(dim=1, keepdim=True)


class ByShape(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x.new_zeros(x.shape[0], 3) + x.sum(dim=1, keepdim=True)


def dynamic() -> tuple[dict[int, object]]:
    return ({0: torch.export.Dim("batch")},)


def to_onnx(module: torch.nn.Module) -> tuple[object, list[int], str]:
    """Return the first axis of the input that was written, the batches it takes, and all that was said on the way."""
    said = io.StringIO()
    with warnings.catch_warnings(record=True) as caught, contextlib.redirect_stdout(said):
        warnings.simplefilter("always")
        program = torch.onnx.export(module.eval(), (torch.zeros(2, 4),), dynamic_shapes=dynamic(), dynamo=True)
        program.save("module.onnx")
    session = onnxruntime.InferenceSession("module.onnx", providers=["CPUExecutionProvider"])
    axis = session.get_inputs()[0].shape[0]
    taken = []
    for rows in (1, 2, 3):
        try:
            session.run(None, {session.get_inputs()[0].name: np.zeros((rows, 4), np.float32)})
            taken.append(rows)
        except Exception:
            pass
    return axis, taken, said.getvalue() + " ".join(str(each.message) for each in caught)


refused = ""
try:
    torch.export.export(ByLength().eval(), (torch.zeros(2, 4),), dynamic_shapes=dynamic())
except Exception as error:
    refused = f"{type(error).__name__}: {str(error).splitlines()[0]}"
torch.export.export(ByShape().eval(), (torch.zeros(2, 4),), dynamic_shapes=dynamic())
axis, taken, said = to_onnx(ByLength())
other, all_taken, _ = to_onnx(ByShape())
print("torch.export.export, len(x):", refused)
print("torch.onnx.export, len(x): first axis", repr(axis), "takes batches of", taken)
print("torch.onnx.export, x.shape[0]: first axis", repr(other), "takes batches of", all_taken)
print("failed steps:", said.count("❌"), "; steps with a tick:", said.count("✅"), "; the axis is named:", "batch" in said)
as_described = (
    refused.startswith("UserError: Constraints violated")
    and axis == 2
    and taken == [2]
    and isinstance(other, str)
    and all_taken == [1, 2, 3]
    and "❌" not in said
    and "✅" in said
    and "batch" not in said
)
sys.exit(0 if as_described else 1)
PYTHON
