"""Weights that move along a cyclic spline with a phase (Holden, Komura, Saito 2017).

Mixing the weights of four control points is what `StackedMLP.forward_blended` does; here are the coefficients.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

CONTROL_POINTS = 4
"""Control points of the spline."""


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
