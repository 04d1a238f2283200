import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.logs.hierarchy import ORDERS
from addressed_dynamics.sources.motion.quaternions import about, between, from_euler, logarithm, multiply, rotate

SEEDS = st.integers(0, 2**32 - 1)


def _random_rotations(seed: int, count: int = 5) -> np.ndarray:
    values = np.random.default_rng(seed).normal(size=(count, 4))
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


@given(seed=SEEDS)
def test_a_product_turns_by_its_right_factor_first(seed: int) -> None:
    left, right = _random_rotations(seed), _random_rotations(seed + 1)
    vectors = np.random.default_rng(seed).normal(size=(5, 3))
    np.testing.assert_allclose(rotate(multiply(left, right), vectors), rotate(left, rotate(right, vectors)), atol=1e-12)


def test_a_quarter_turn_takes_each_axis_to_the_next() -> None:
    quarter = np.full(1, np.pi / 2)
    for axis in range(3):
        first, second = np.eye(3)[[(axis + 1) % 3, (axis + 2) % 3]]
        np.testing.assert_allclose(rotate(about(axis, quarter), first[None]), second[None], atol=1e-15)


@given(seed=SEEDS, order=st.sampled_from(ORDERS))
def test_angles_are_applied_from_the_last_channel_to_the_first(seed: int, order: str) -> None:
    angles = np.random.default_rng(seed).uniform(-7, 7, (5, 3))
    turned = vectors = np.random.default_rng(seed + 1).normal(size=(5, 3))
    for axis in ("xyz".index(name) for name in reversed(order)):
        turned = rotate(about(axis, angles[:, axis]), turned)
    np.testing.assert_allclose(rotate(from_euler(angles, order), vectors), turned, atol=1e-12)


@given(seed=SEEDS)
def test_a_logarithm_is_the_axis_times_half_the_angle(seed: int) -> None:
    generator = np.random.default_rng(seed)
    axes, angles = generator.normal(size=(5, 3)), generator.uniform(0, np.pi, (5, 1))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    rotations = np.concatenate([np.cos(angles / 2), np.sin(angles / 2) * axes], axis=-1)
    np.testing.assert_allclose(logarithm(rotations), axes * angles / 2, atol=1e-9)
    np.testing.assert_array_equal(logarithm(-rotations), logarithm(rotations))


def test_no_rotation_and_tiny_ones_have_logarithms() -> None:
    rotations = np.array([[1, 0, 0, 0], [-1, 0, 0, 0], [1, 0, 1e-14, 0], [1, 1e-9, 0, 0]])
    np.testing.assert_allclose(logarithm(rotations)[:, :2], [[0, 0], [0, 0], [0, 1e-14], [1e-9, 0]], rtol=1e-9)


@given(seed=SEEDS)
def test_the_rotation_between_directions_takes_one_to_the_other(seed: int) -> None:
    start, end = np.random.default_rng(seed).normal(size=(2, 5, 3))
    end[0], end[1] = start[0], -start[1]
    rotations = between(start, end)
    unit = [each / np.linalg.norm(each, axis=-1, keepdims=True) for each in (start, end)]
    np.testing.assert_allclose(rotate(rotations, unit[0]), unit[1], atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(rotations, axis=-1), 1)
    np.testing.assert_allclose((rotations[:, 1:] * start).sum(axis=-1), 0, atol=1e-7)
