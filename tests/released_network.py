"""The released phase-functioned network as a predictor, written anew: what the project's own loader is held against."""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import elu

from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.simulators.motion_predictor import MotionPredictor


def released_network(folder: Path) -> MotionPredictor:
    """A cyclic Catmull-Rom spline through four control points, at each row's phase."""
    with np.load(folder / "released_control_points.npz") as file:
        points = {name: torch.from_numpy(file[name]) for name in file.files}
    x_mean, x_std, y_mean, y_std = (
        torch.from_numpy(np.fromfile(folder / f"{name}.bin", np.float32)) for name in ("Xmean", "Xstd", "Ymean", "Ystd")
    )

    def predict(x: Tensor, phase: Tensor) -> Tensor:
        index, shares = (4 * phase).floor().long(), catmull_rom((4 * phase) % 1.0)
        around = [(index + offset) % 4 for offset in (-1, 0, 1, 2)]
        hidden = (x - x_mean) / x_std
        for layer in range(3):
            values = torch.zeros(len(x), points[f"b{layer}"].shape[1])
            for point in range(4):
                of_point = hidden @ points[f"W{layer}"][point].T + points[f"b{layer}"][point]
                share = sum(shares[k] * (around[k] == point) for k in range(4))
                values += torch.as_tensor(share)[:, None] * of_point
            hidden = elu(values) if layer < 2 else values
        return hidden * y_std + y_mean

    return predict


def catmull_rom(t: Tensor) -> list[Tensor]:
    return [
        -0.5 * t + t**2 - 0.5 * t**3,
        1 - 2.5 * t**2 + 1.5 * t**3,
        0.5 * t + 2 * t**2 - 1.5 * t**3,
        -0.5 * t**2 + 0.5 * t**3,
    ]


def recorded_motion(folder: Path) -> Motion:
    """The rows of `database_flat.npz`."""
    with np.load(folder / "database_flat.npz") as file:
        clip, frame, cycle, _ = file["meta"].astype(np.int64).T
        return Motion(file["Xun"], file["Yun"], file["Pun"], file["clips"][clip], frame, cycle)
