"""How well an angle comes out of a noisy cosine and sine: the forms of Section 3.3 and atan2, compared."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float64

from addressed_dynamics.features.transitions.angles import weighted_angle

Values = Float64[np.ndarray, " sample"]
Noise = tuple[Values, Values]
"""What is added to the cosine and to the sine at a size of 1."""

SAMPLES = 28_800
"""Angles, evenly spread over the whole circle, each with noise of its own."""


def from_arccos(cosine: Values, sine: Values) -> Values:
    """Return the angle by the arccosine, with the sine's sign."""
    angle: Values = np.where(sine < 0, -1.0, 1.0) * np.arccos(cosine.clip(-1.0, 1.0))
    return angle


def from_arcsin(cosine: Values, sine: Values) -> Values:
    """Return the angle by the arcsine, mirrored where the cosine is negative."""
    first = np.arcsin(sine.clip(-1.0, 1.0))
    angle: Values = np.where(cosine < 0, np.where(sine < 0, -np.pi, np.pi) - first, first)
    return angle


def as_printed(cosine: Values, sine: Values) -> Values:
    """Return the angle with the weight as the paper prints it, w = c / (c + s), mirrored into every quadrant.

    Without mirrors it is an angle in the first quadrant alone: elsewhere w leaves 0..1, and c + s passes 0.
    """
    c, s = np.abs(cosine), np.abs(sine)
    weight = c / (c + s)
    first = (1 - weight) * np.arccos(c.clip(0.0, 1.0)) + weight * np.arcsin(s.clip(0.0, 1.0))
    angle: Values = np.where(sine < 0, -1.0, 1.0) * np.where(cosine < 0, np.pi - first, first)
    return angle


def weighted(cosine: Values, sine: Values) -> Values:
    """Return the weighted angle of `features.angles`."""
    angle: Values = weighted_angle(torch.from_numpy(cosine), torch.from_numpy(sine)).numpy()
    return angle


def from_atan2(cosine: Values, sine: Values) -> Values:
    """Return the angle of the point (cosine, sine), whatever its distance from 0."""
    angle: Values = np.arctan2(sine, cosine)
    return angle


FORMS: dict[str, Callable[[Values, Values], Values]] = {
    "arccos": from_arccos,
    "arcsin": from_arcsin,
    "printed": as_printed,
    "weighted": weighted,
    "atan2": from_atan2,
}
"""Ways from cosine and sine to an angle."""


def circle() -> Values:
    """Return the angles of the study, in rad in [-pi, pi)."""
    return np.linspace(-np.pi, np.pi, SAMPLES, endpoint=False)


def noises(angle: Values) -> dict[str, Noise]:
    """Return each kind of noise at a size, that is, a standard deviation, of 1: normal, but radial noise even."""
    # An even lattice (the R2 sequence) in place of random numbers: means of few samples are exact and curves smooth.
    plastic = 1.324717957244746
    u, v = np.remainder(0.5 + np.arange(len(angle)) / plastic ** np.array([[1.0], [2.0]]), 1.0)
    first, second = np.sqrt(-2 * np.log(u)) * np.array([np.cos(2 * np.pi * v), np.sin(2 * np.pi * v)])
    # Evenly distributed, so that at no size below 0.57 a radius is negative, which would be another angle.
    stretch = np.sqrt(3) * (2 * u - 1)
    nothing = np.zeros_like(angle)
    return {
        "independent": (first, second),
        "one": (first, nothing),
        "radial": (stretch * np.cos(angle), stretch * np.sin(angle)),
    }


def errors(form: str, angle: Values, noise: Noise, size: float, *, clipped: bool = False) -> Values:
    """Return the errors of a form in rad, the shorter way round.

    Args:
        form: one of `FORMS`.
        angle: true angles, in rad.
        noise: what is added to cosine and sine, at a size of 1.
        size: size of the noise.
        clipped: whether cosine and sine stay within -1 and 1, as the outputs of a tanh do.
    """
    cosine, sine = np.cos(angle) + size * noise[0], np.sin(angle) + size * noise[1]
    if clipped:
        cosine, sine = cosine.clip(-1.0, 1.0), sine.clip(-1.0, 1.0)
    wrapped: Values = np.remainder(FORMS[form](cosine, sine) - angle + np.pi, 2 * np.pi) - np.pi
    return wrapped


def root_mean_square(values: Values) -> float:
    """Return the root of the mean of the squares."""
    return float(np.sqrt(np.mean(values**2)))
