"""Phase-functioned networks (Holden, Komura, Saito 2017): weights that move along a cyclic spline with the phase.

Mixing the weights of four control points is what `StackedMLP.forward_blended` does; here are the coefficients, and the
network that the authors released, in the two forms in which its weights are found.
"""

from __future__ import annotations

import zipfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.params.motion import MotionFeatureParams
from addressed_dynamics.episodes.layout import INPUT, OUTPUT
from addressed_dynamics.features.motion.features import MotionFeatures
from addressed_dynamics.networks.files import SavedNetwork
from addressed_dynamics.networks.stacked import StackedMLP

CONTROL_POINTS = 4
"""Control points of the spline."""
PFNN_FEATURES = MotionFeatureParams(target="absolute", joint_input_weight=0.1)
"""What a phase-functioned network is given and asked for (Section 6 there)."""
RELEASED_WIDTHS = (INPUT.width, 512, 512, OUTPUT.width)
RELEASED_PHASES = 50
"""Phases, evenly spaced from 0, at which the released binaries hold the weights."""
_STATISTICS = {"Xmean": INPUT.width, "Xstd": INPUT.width, "Ymean": OUTPUT.width, "Ystd": OUTPUT.width}


def catmull_rom(phase: Float[Tensor, " sample"]) -> Float[Tensor, "sample 4"]:
    """Return the weight of each control point at a phase: a cyclic cubic Catmull-Rom spline (Section 5.2, Eq. 6 there).

    Args:
        phase: phases in cycles; 0 and 1 are the same, and so is any whole number more.
    """
    place = CONTROL_POINTS * torch.remainder(phase, 1.0)
    start = place.floor()
    t = (place - start).unsqueeze(1)
    powers = torch.cat([torch.ones_like(t), t, t**2, t**3], dim=1)
    # Rows: 1, t, t², t³. Columns: the control points before, at, after and two after `start`.
    basis = powers.new_tensor([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]) / 2
    points = start.long().unsqueeze(1) + torch.arange(-1, 3, device=phase.device)
    return torch.zeros_like(powers).scatter_add_(1, points % CONTROL_POINTS, powers @ basis)


def load_released(path: Path) -> SavedNetwork[MotionFeatures]:
    """Read a released phase-functioned network: its control points as one stack, and its normalisation.

    Args:
        path: an .npz file with the control points `W0 W1 W2` (4, out, in) and `b0 b1 b2` (4, out), or a folder with the
            binaries `W0_000.bin` … `b2_049.bin` of the weights at 50 phases, whose control points are found by least
            squares. `Xmean.bin Xstd.bin Ymean.bin Ystd.bin` lie beside the file, or in the folder.

    Raises:
        ModelError: a file is missing, is no such file, or holds another number of values.
    """
    layers = _control_points_of_phases(path) if path.is_dir() else _control_points(path)
    folder = path if path.is_dir() else path.parent
    statistics = {name: _read_floats(folder / f"{name}.bin", (width,)) for name, width in _STATISTICS.items()}
    stack = StackedMLP(CONTROL_POINTS, RELEASED_WIDTHS, "elu")
    with torch.no_grad():
        for layer, (weight, bias) in enumerate(layers):
            stack.weights[layer].copy_(torch.from_numpy(weight).transpose(1, 2))
            stack.biases[layer].copy_(torch.from_numpy(bias).unsqueeze(1))
    features = MotionFeatures(
        target="absolute",
        joint_input_weight=1.0,  # the released deviations hold it already
        input_mean=tuple(statistics["Xmean"].tolist()),
        input_deviation=tuple(statistics["Xstd"].tolist()),
        target_mean=tuple(statistics["Ymean"].tolist()),
        target_deviation=tuple(statistics["Ystd"].tolist()),
    )
    return SavedNetwork(stack.requires_grad_(False), features, {"source": "released phase-functioned network"})


Layer = tuple[Float32[np.ndarray, "point out in"], Float32[np.ndarray, "point out"]]
"""Weight and bias of a layer at every control point, or at every phase."""


def _control_points(path: Path) -> list[Layer]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except FileNotFoundError as error:
        message = f"{path}: no such file; give the .npz of the control points or the folder of the binaries"
        raise ModelError(message) from error
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, AttributeError) as error:
        message = f"{path}: not an .npz file of control points ({error}); copy it again"
        raise ModelError(message) from error
    layers = []
    for layer, (inputs, outputs) in enumerate(pairwise(RELEASED_WIDTHS)):
        pair = []
        for name, shape in ((f"W{layer}", (outputs, inputs)), (f"b{layer}", (outputs,))):
            expected = (CONTROL_POINTS, *shape)
            if name not in arrays or arrays[name].shape != expected:
                found = arrays[name].shape if name in arrays else "missing"
                message = f"{path}: the array '{name}' should have shape {expected}, but is {found}"
                raise ModelError(message)
            pair.append(arrays[name].astype(np.float32))
        layers.append((pair[0], pair[1]))
    return layers


def _control_points_of_phases(folder: Path) -> list[Layer]:
    phases = torch.arange(RELEASED_PHASES, dtype=torch.float64) / RELEASED_PHASES
    # The weights at a phase are the coefficients times the control points, so these are a least-squares solution.
    inverse = np.linalg.pinv(catmull_rom(phases).numpy())

    def solve(name: str, shape: tuple[int, ...]) -> np.ndarray:
        total = np.zeros((CONTROL_POINTS, *shape))
        for index in range(RELEASED_PHASES):
            values = _read_floats(folder / f"{name}_{index:03d}.bin", shape)
            total += inverse[:, index].reshape(-1, *[1] * len(shape)) * values
        return total.astype(np.float32)

    return [
        (solve(f"W{layer}", (outputs, inputs)), solve(f"b{layer}", (outputs,)))
        for layer, (inputs, outputs) in enumerate(pairwise(RELEASED_WIDTHS))
    ]


def _read_floats(path: Path, shape: tuple[int, ...]) -> Float32[np.ndarray, ...]:
    try:
        values = np.fromfile(path, dtype="<f4")
    except OSError as error:
        message = f"{path}: missing or unreadable; the released network needs all of its files"
        raise ModelError(message) from error
    expected = int(np.prod(shape))
    if len(values) != expected or path.stat().st_size != 4 * expected:
        message = f"{path}: should hold {expected} float32 values, but has {path.stat().st_size} bytes"
        raise ModelError(message)
    if not np.isfinite(values).all():
        message = f"{path}: holds a value that is not finite; copy it again"
        raise ModelError(message)
    return values.reshape(shape)
