"""Angles from cosines and sines: right on the whole circle and at its edges, and that of atan2 without noise."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.features.transitions.angles import velocity_from_angles, weighted_angle, wrapped_difference

angles = st.floats(-math.pi, math.pi)


def tensor(value: float) -> torch.Tensor:
    return torch.tensor(value, dtype=torch.float64)


@given(angles)
def test_the_angle_of_an_exact_cosine_and_sine_is_that_of_atan2(angle: float) -> None:
    cosine, sine = math.cos(angle), math.sin(angle)
    found = weighted_angle(tensor(cosine), tensor(sine))
    assert abs(wrapped_difference(found, tensor(math.atan2(sine, cosine)))) < 1e-7


@pytest.mark.parametrize("quadrant", range(4))
@given(share=st.floats(0.0, 1.0), noise=st.tuples(st.floats(-1e-3, 1e-3), st.floats(-1e-3, 1e-3)))
def test_noise_moves_the_angle_by_no_more_than_its_size_in_every_quadrant(
    quadrant: int, share: float, noise: tuple[float, float]
) -> None:
    angle = (quadrant + share) * math.pi / 2
    found = weighted_angle(tensor(math.cos(angle) + noise[0]), tensor(math.sin(angle) + noise[1]))
    assert abs(wrapped_difference(found, tensor(angle))) < 5e-3


@pytest.mark.parametrize(
    ("cosine", "sine", "angle"),
    [
        *((1, 0, 0), (0, 1, math.pi / 2), (0, -1, -math.pi / 2), (-1, 0, math.pi), (-1, -0.0, math.pi)),
        *((1.2, 0, 0), (-1.2, 0, math.pi), (0, 1.5, math.pi / 2), (0, 0, 0)),
    ],
)
def test_the_edges_of_the_quadrants_and_values_beyond_one(cosine: float, sine: float, angle: float) -> None:
    assert weighted_angle(tensor(cosine), tensor(sine)).item() == pytest.approx(angle, abs=1e-12)


@given(angle=angles, noise=st.tuples(st.floats(-1e-3, 1e-3), st.floats(-1e-3, 1e-3)))
def test_small_noise_moves_the_angle_as_it_moves_that_of_atan2(angle: float, noise: tuple[float, float]) -> None:
    cosine, sine = math.cos(angle) + noise[0], math.sin(angle) + noise[1]
    expected = math.atan2(sine, cosine)
    # The arccosine and the arcsine grow like a root at 1, so what is left is of the order 3/2, not 2.
    assert abs(wrapped_difference(weighted_angle(tensor(cosine), tensor(sine)), tensor(expected))) < 3 * 1e-3**1.5


coordinates = st.floats(-1.5, 1.5).filter(lambda value: abs(value) > 1e-100)  # squares of the rest are 0


@given(coordinates, coordinates)
def test_mirrored_points_have_mirrored_angles(cosine: float, sine: float) -> None:
    angle = weighted_angle(tensor(cosine), tensor(sine))
    assert -math.pi <= angle <= math.pi
    assert weighted_angle(tensor(cosine), tensor(-sine)) == -angle
    mirrored = weighted_angle(tensor(-cosine), tensor(sine))
    assert mirrored.item() == pytest.approx(math.copysign(math.pi, sine) - angle.item(), abs=1e-12)
    across = weighted_angle(tensor(abs(sine)), tensor(abs(cosine)))
    first = weighted_angle(tensor(abs(cosine)), tensor(abs(sine)))
    assert across.item() == pytest.approx(math.pi / 2 - first.item(), abs=1e-12)


@given(st.lists(angles, min_size=1, max_size=5))
def test_a_batch_in_single_precision_has_its_shape_and_its_angles(turns: list[float]) -> None:
    exact = torch.tensor(turns, dtype=torch.float32)
    found = weighted_angle(exact.cos(), exact.sin())
    assert found.shape == exact.shape
    assert found.dtype == torch.float32
    assert float(wrapped_difference(found, exact).abs().max()) < 1e-6


@given(angle=angles, turn=st.floats(-3.0, 3.0))
def test_a_difference_goes_the_shorter_way_round(angle: float, turn: float) -> None:
    wrapped = math.atan2(math.sin(angle + turn), math.cos(angle + turn))
    assert wrapped_difference(tensor(wrapped), tensor(angle)).item() == pytest.approx(turn, abs=1e-9)


@given(angle=angles, velocity=st.floats(-40.0, 40.0))
def test_a_velocity_is_the_mean_over_the_step(angle: float, velocity: float) -> None:
    found = velocity_from_angles(tensor(angle + 0.02 * velocity), tensor(angle), step_seconds=0.02)
    assert found.item() == pytest.approx(velocity, abs=1e-8)
