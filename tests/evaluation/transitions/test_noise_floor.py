"""The noise floor of an experiment, on worlds whose noise is known."""

import numpy as np
import pytest
from learning import sail

from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.evaluation.transitions.noise_floor import noise_floor
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.records import NoiseFloor
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.sources.transitions.params import FeatureParams

NORMAL = np.sqrt(2 / np.pi)
"""Mean absolute value of normal noise, in standard deviations."""


def with_noise(deviation: tuple[float, float], seed: int) -> Transitions:
    """Episodes of a world that is linear but for its noise, which is in the state."""
    generator = np.random.default_rng(seed)
    states, torque = np.zeros((5, 601, 2)), generator.uniform(-1.0, 1.0, (5, 601, 1))
    states[:, 0] = generator.uniform(-1.0, 1.0, (5, 2))
    for step in range(600):
        position, speed = states[:, step].T
        states[:, step + 1] = np.stack([0.8 * position + 0.3 * speed, 0.9 * speed + 0.2 * torque[:, step, 0]], axis=1)
        states[:, step + 1] += deviation * generator.standard_normal((5, 2))
    names = ["position", "speed"]
    return Transitions.from_arrays(
        states.reshape(-1, 2), torque.reshape(-1, 1), rate_hz=10.0, lengths=[601] * 5, observation_names=names,
        action_names=["torque"],
    )  # fmt: skip


def floor(deviation: tuple[float, float], loss: str, history: int = 1) -> tuple[NoiseFloor, FeatureSpec]:
    train, test = (with_noise(deviation, seed) for seed in (0, 1))
    features = fit_features(train, FeatureParams(target="change", history=history))
    found = noise_floor(Points.of(train, features), Points.of(test, features), loss)
    return NoiseFloor.model_validate(found), features


@pytest.mark.parametrize("history", [1, 3])
def test_a_known_level_of_noise_is_found_in_every_unit(history: int) -> None:
    deviation = np.array([0.05, 0.2])
    found, features = floor((0.05, 0.2), "mse", history)
    relative = deviation / features.scale
    assert list(found.absolute) == ["position", "speed"]
    np.testing.assert_allclose(list(found.absolute.values()), NORMAL * deviation, rtol=0.1)
    assert found.scaled == pytest.approx((relative**2).mean(), rel=0.2)
    assert found.percent == pytest.approx(100 * np.sqrt((relative**2).mean()), rel=0.1)
    assert (found.neighbours, found.transitions, found.among) == (10, 2_000, 3_000 - 5 * (history - 1))
    absolute, _ = floor((0.05, 0.2), "mae", history)
    assert absolute.scaled == pytest.approx(NORMAL * relative.mean(), rel=0.1)


def test_a_linear_world_without_noise_has_none() -> None:
    found, features = floor((0.0, 0.0), "mse")
    assert found.percent < 1e-4
    assert features.scale[0] > 0.5


def test_with_fewer_than_two_training_transitions_there_is_no_floor() -> None:
    world = sail((40,))
    features = fit_features(world, FeatureParams())
    one = world.select(np.arange(len(world)) == 0)
    assert noise_floor(Points.of(one, features), Points.of(world, features), "mse") is None
