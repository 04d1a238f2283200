"""Angles from predicted cosines and sines, and velocities from successive angles (Section 3.3 of the paper)."""

import math

import torch
from jaxtyping import Float
from torch import Tensor


def angle_of(
    cosine: Float[Tensor, "*batch"], sine: Float[Tensor, "*batch"], *, weighted: bool
) -> Float[Tensor, "*batch"]:
    """Return the angle of a predicted cosine and sine, in rad in [-pi, pi]: by `weighted_angle`, or by atan2.

    The derivative is that of atan2 in both cases: that of the weighted mean is infinite at the ends of arccosine and
    arcsine, through which every turn goes.
    """
    if not weighted:
        return torch.atan2(sine, cosine)
    if not (torch.is_grad_enabled() and (cosine.requires_grad or sine.requires_grad)):
        return weighted_angle(cosine, sine)
    smooth = torch.atan2(sine, cosine)
    return smooth + (weighted_angle(cosine.detach(), sine.detach()) - smooth.detach())


def weighted_angle(cosine: Float[Tensor, "*batch"], sine: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Return the angle of a predicted cosine and sine, in rad in [-pi, pi], as a weighted mean of arccos and arcsin.

    The paper weighs arccos(c) and arcsin(s) by 1 - w and w with w = c / (c + s), which holds in the first quadrant.
    Here both branches are continued to the whole circle, by the sign of the sine and of the cosine, and w is
    c² / (c² + s²), which is 1 where the arcsine is exact to first order (s = 0) and 0 where the arccosine is (c = 0).
    Cosines and sines beyond ±1 count as ±1; where both are 0 the angle is 0.
    """
    square_cosine, square_sine = cosine.square(), sine.square()
    total = square_cosine + square_sine
    weight = torch.where(total > 0, square_cosine / total.clamp_min(torch.finfo(total.dtype).tiny), 1.0)
    side = torch.where(sine < 0, -1.0, 1.0).to(cosine.dtype)
    from_cosine = side * torch.arccos(cosine.clamp(-1.0, 1.0))
    first = torch.arcsin(sine.clamp(-1.0, 1.0))
    from_sine = torch.where(cosine < 0, side * math.pi - first, first)
    return (1.0 - weight) * from_cosine + weight * from_sine


def wrapped_difference(angle: Float[Tensor, "*batch"], before: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Return how far `angle` is from `before` on the shorter way round, in rad in [-pi, pi]."""
    return torch.remainder(angle - before + math.pi, 2.0 * math.pi) - math.pi


def velocity_from_angles(
    angle: Float[Tensor, "*batch"], before: Float[Tensor, "*batch"], *, step_seconds: float
) -> Float[Tensor, "*batch"]:
    """Return the mean velocity between two successive angles, in rad/s.

    At an acceleration a it lags half a step behind the velocity at the end of the step, by a * step_seconds / 2.

    Args:
        angle: angles at the end of a step, in rad.
        before: angles at its beginning, in rad.
        step_seconds: length of the step.
    """
    return wrapped_difference(angle, before) / step_seconds
