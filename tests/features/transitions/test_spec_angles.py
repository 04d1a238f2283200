"""Angles in the features: next states on the unit circle, and velocities from the angles or from the network."""

import json
import math
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import torch
from acrobot_recordings import acrobot_recording
from hypothesis import given, settings
from hypothesis import strategies as st

from addressed_dynamics.base.errors import ModelError, TransitionsError
from addressed_dynamics.episodes.transitions import COLUMNS, Transitions
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.sources.transitions.params import AngleParams, FeatureParams

Target = Literal["absolute", "change"]
AngleFrom = Literal["weighted", "atan2"]
Velocity = Literal["difference", "predicted"]
TARGETS: tuple[Target, ...] = ("absolute", "change")
ANGLE_FROM: tuple[AngleFrom, ...] = ("weighted", "atan2")
ANGLES = tuple(
    AngleParams(name=f"angle_{i}", cosine=f"cos_angle_{i}", sine=f"sin_angle_{i}", velocity=f"velocity_{i}")
    for i in (1, 2)
)
WORLD = acrobot_recording([60, 60, 50], torque=(True, False))
STEP_SECONDS = 0.02
FASTEST = (4 * math.pi, 9 * math.pi)


def fitted(
    world: Transitions = WORLD,
    *,
    target: Target = "change",
    angle_from: AngleFrom = "weighted",
    velocity: Velocity = "difference",
    angles: tuple[AngleParams, ...] = ANGLES,
) -> FeatureSpec:
    return fit_features(world, FeatureParams(target=target, angles=angles, angle_from=angle_from, velocity=velocity))


def true_outputs(features: FeatureSpec, world: Transitions = WORLD) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """What a perfect network says, the states before, and the states after."""
    before, after = torch.from_numpy(world.observation), torch.from_numpy(world.next_observation)
    return features.encode_target(before, after), before, after


def state(turns: tuple[float, float], velocities: tuple[float, float] = (0.0, 0.0)) -> torch.Tensor:
    shown = [function(turn) for turn in turns for function in (math.cos, math.sin)]
    return torch.tensor([[*shown, *velocities]], dtype=torch.float32)


@pytest.mark.parametrize(("velocity", "outputs"), [("difference", 4), ("predicted", 6)])
def test_velocities_that_follow_from_angles_are_no_outputs(velocity: Velocity, outputs: int) -> None:
    features = fitted(velocity=velocity)
    assert features.outputs == len(features.predicted) == outputs
    assert features.predicted == tuple(range(outputs))
    assert features.inputs == 9
    assert features.samples(WORLD).y.shape == (len(WORLD), outputs)


def test_an_angle_without_a_velocity_leaves_all_dimensions_to_the_network() -> None:
    features = fitted(angles=tuple(replace_velocity(angle, None) for angle in ANGLES))
    assert features.predicted == tuple(range(6))
    outputs, before, after = true_outputs(features)
    torch.testing.assert_close(features.decode(outputs, before), after, rtol=0.0, atol=3e-5)


def replace_velocity(angle: AngleParams, velocity: str | None) -> AngleParams:
    return angle.model_copy(update={"velocity": velocity})


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("angle_from", ANGLE_FROM)
def test_a_perfect_network_that_predicts_velocities_gives_the_true_next_state(
    target: Target, angle_from: AngleFrom
) -> None:
    features = fitted(target=target, angle_from=angle_from, velocity="predicted")
    outputs, before, after = true_outputs(features)
    error = (features.decode(outputs, before) - after).abs().amax(dim=0)
    assert float(error[:4].max()) < 2e-6
    assert float(error[4:].max()) < 3e-5  # float32 at up to 28 rad/s


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("angle_from", ANGLE_FROM)
def test_a_perfect_network_without_velocities_lags_half_a_step_behind_them(
    target: Target, angle_from: AngleFrom
) -> None:
    features = fitted(target=target, angle_from=angle_from)
    outputs, before, after = true_outputs(features)
    found = features.decode(outputs, before)
    assert float((found - after).abs()[:, :4].max()) < 2e-6
    acceleration = (after - before)[:, 4:] / STEP_SECONDS
    lag = found[:, 4:] - (after[:, 4:] - acceleration * STEP_SECONDS / 2)
    assert float(lag.abs().max()) < 0.05 * float(acceleration.abs().max()) * STEP_SECONDS / 2


@settings(max_examples=60)
@given(seed=st.integers(0, 2**31 - 1), size=st.floats(0.01, 30.0), members=st.integers(0, 3))
@pytest.mark.parametrize("angle_from", ANGLE_FROM)
@pytest.mark.parametrize("velocity", ["difference", "predicted"])
def test_whatever_a_network_says_angles_are_on_the_circle_and_velocities_in_their_bounds(
    angle_from: AngleFrom, velocity: Velocity, seed: int, size: float, members: int
) -> None:
    features = fitted(angle_from=angle_from, velocity=velocity)
    shape = (*([members] if members else []), 20, features.outputs)
    outputs = torch.randn(shape, generator=torch.Generator().manual_seed(seed)) * size
    found = features.decode(outputs, torch.from_numpy(WORLD.observation[:20]))
    assert found.shape == (*shape[:-1], 6)
    radius = found[..., 0:4:2].square() + found[..., 1:4:2].square()
    torch.testing.assert_close(radius, torch.ones_like(radius), rtol=0.0, atol=1e-6)
    assert bool((found[..., 4:].abs() <= torch.tensor(FASTEST) * (1 + 1e-6)).all())


@given(
    angle=st.floats(-math.pi, math.pi),
    turns=st.tuples(st.floats(-12.0, 12.0), st.floats(-28.0, 28.0)),
    angle_from=st.sampled_from(ANGLE_FROM),
    target=st.sampled_from(TARGETS),
)
def test_a_velocity_is_the_mean_over_the_step_also_across_the_seam(
    angle: float, turns: tuple[float, float], angle_from: AngleFrom, target: Target
) -> None:
    features = fitted(target=target, angle_from=angle_from)
    seam = math.copysign(math.pi, angle)
    before = state((angle, seam - turns[1] * STEP_SECONDS / 2))
    after = state((angle + turns[0] * STEP_SECONDS, seam + turns[1] * STEP_SECONDS / 2))
    found = features.decode(features.encode_target(before, after), before)
    torch.testing.assert_close(found[0, 4:], torch.tensor(turns), rtol=1e-5, atol=3e-4)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_velocity_beyond_its_bounds_is_that_bound(sign: float) -> None:
    before, after = state((0.0, 3.0)), state((sign, 3.0 + sign))
    features = fitted()
    found = features.decode(features.encode_target(before, after), before)[0, 4:]
    torch.testing.assert_close(found, sign * torch.tensor(FASTEST))
    predicted = fitted(velocity="predicted")
    after[0, 4:] = sign * 100.0
    found = predicted.decode(predicted.encode_target(before, after), before)[0, 4:]
    torch.testing.assert_close(found, sign * torch.tensor(FASTEST))


@given(st.floats(-12.0, 12.0), st.floats(-28.0, 28.0))
def test_predicted_velocities_are_what_the_network_says_whatever_the_angles_do(first: float, second: float) -> None:
    features = fitted(velocity="predicted")
    before, after = state((0.3, -2.0)), state((0.4, 3.1), (first, second))
    found = features.decode(features.encode_target(before, after), before)
    torch.testing.assert_close(found[0, 4:], torch.tensor([first, second]), rtol=1e-5, atol=3e-5)


def test_dimensions_that_belong_to_no_angle_stay_what_the_network_says() -> None:
    features = fitted(angles=ANGLES[1:])
    assert features.predicted == (0, 1, 2, 3, 4)
    outputs, before, after = true_outputs(features)
    found = features.decode(outputs + 1.0, before)
    moved = features.target_deviation * torch.tensor(features.scale)[[0, 1, 4]]
    difference = (found - after)[:, [0, 1, 4]]
    torch.testing.assert_close(difference, moved.expand(len(WORLD), -1), atol=3e-5, rtol=0)


@given(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi))
def test_an_angle_of_a_state_is_the_one_it_shows(first: float, second: float) -> None:
    features = fitted()
    shown = state((first, second)).double()
    for angle, expected in zip(features.angles, (first, second), strict=True):
        found = float(features.angle(angle, shown)[0])
        assert math.remainder(found - expected, 2 * math.pi) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("angle_from", ANGLE_FROM)
@pytest.mark.parametrize("velocity", ["difference", "predicted"])
def test_a_spec_with_angles_survives_json(target: Target, angle_from: AngleFrom, velocity: Velocity) -> None:
    features = fitted(target=target, angle_from=angle_from, velocity=velocity)
    read = FeatureSpec.from_json(json.loads(json.dumps(features.to_json(), allow_nan=False)))
    assert read == features
    assert (read.outputs, read.angles[1].velocity) == (features.outputs, "velocity_2")


@pytest.mark.parametrize("part", ["cosine", "sine", "velocity"])
def test_an_angle_of_a_dimension_that_does_not_exist_is_refused(part: str) -> None:
    wrong = ANGLES[1].model_copy(update={part: "speed"})
    with pytest.raises(TransitionsError, match=f"the {part} of 'angle_2' should be a dimension .* but is 'speed'") as e:
        fitted(angles=(ANGLES[0], wrong))
    assert "cos_angle_1, sin_angle_1" in str(e.value)
    assert "\n" not in str(e.value)


@pytest.mark.parametrize("part", ["cosine", "sine", "velocity"])
def test_a_dimension_that_two_parts_of_angles_share_is_refused(part: str) -> None:
    wrong = ANGLES[1].model_copy(update={part: "cos_angle_1"})
    with pytest.raises(TransitionsError, match=f"the {part} of 'angle_2' is 'cos_angle_1', which is .* another") as e:
        fitted(angles=(ANGLES[0], wrong))
    assert "\n" not in str(e.value)


@pytest.mark.parametrize("name", ["angle_1", "velocity_2"])
def test_an_angle_with_a_name_that_is_taken_is_refused(name: str) -> None:
    wrong = ANGLES[1].model_copy(update={"name": name})
    with pytest.raises(TransitionsError, match=f"'{name}' is the name of another angle or of a dimension") as e:
        fitted(angles=(ANGLES[0], wrong))
    assert "\n" not in str(e.value)


@pytest.mark.parametrize("change", [{"cosine": "speed"}, {"sine": "cos_angle_1"}, {"name": "angle_1"}, {"unit": "rad"}])
def test_a_saved_spec_with_an_angle_that_does_not_fit_is_refused(change: dict[str, str]) -> None:
    saved = fitted(velocity="predicted").to_json()
    saved["angles"] = [saved["angles"][0], {**saved["angles"][1], **change}]
    with pytest.raises(ModelError, match="features is incomplete or malformed") as caught:
        FeatureSpec.from_json(saved)
    assert "\n" not in str(caught.value)


def test_no_transitions_are_refused_before_angles() -> None:
    empty = Transitions(spec=WORLD.spec, **{name: getattr(WORLD, name)[:0] for name in COLUMNS})
    with pytest.raises(TransitionsError, match="no training transitions"):
        fitted(empty)


def test_targets_have_the_deviation_of_the_predicted_dimensions_alone() -> None:
    world = replace(WORLD, observation=WORLD.observation.copy(), next_observation=WORLD.next_observation.copy())
    world.next_observation[:, 4:] *= 0.5
    assert fitted(world).target_deviation == fitted().target_deviation
    assert fitted(world, velocity="predicted").target_deviation != fitted(velocity="predicted").target_deviation
    y = fitted().samples(WORLD).y.double()
    np.testing.assert_allclose(y.var(dim=0, correction=0).mean(), 1.0, rtol=1e-5)
