import json
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import ARM, CHANGE, drive, swing
from strategies import space_specs

from addressed_dynamics.base.errors import ModelError, TransitionsError
from addressed_dynamics.episodes.transitions import COLUMNS, Dimension, DiscreteAction, SpaceSpec, Transitions
from addressed_dynamics.features.transitions.spec import DEVIATION_FLOOR, FeatureSpec, fit_features
from addressed_dynamics.sources.transitions.params import FeatureParams

TARGETS = ("absolute", "change")
Target = Literal["absolute", "change"]
Case = tuple[SpaceSpec, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Spaces, states, actions, the states after them, and exogenous inputs."""


def empty(world: Transitions) -> Transitions:
    return Transitions(spec=world.spec, **{name: getattr(world, name)[:0] for name in COLUMNS})


def respace(world: Transitions, observation: tuple[Dimension, ...]) -> Transitions:
    """The same numbers with other bounds."""
    return replace(world, spec=replace(world.spec, observation=observation))


@st.composite
def spaces_and_states(draw: st.DrawFn) -> Case:
    """A space with some states in it, actions, the states that follow, and exogenous inputs."""
    spec = draw(space_specs(max_size=4))
    generator = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows = draw(st.integers(2, 12))
    shape = (rows, len(spec.observation))
    size = 10.0 ** draw(st.integers(-3, 4))
    before, after = (generator.standard_normal((2, *shape)) * size).astype(np.float32)
    action = (
        generator.integers(0, spec.action.count, rows)
        if isinstance(spec.action, DiscreteAction)
        else generator.standard_normal((rows, len(spec.action.dimensions))).astype(np.float32)
    )
    return spec, before, action, after, generator.standard_normal((rows, len(spec.exogenous))).astype(np.float32)


def one_step_episodes(
    spec: SpaceSpec, before: np.ndarray, action: np.ndarray, after: np.ndarray, exogenous: np.ndarray | None = None
) -> Transitions:
    rows = len(before)
    return Transitions(
        spec=spec,
        episode=np.arange(rows),
        step=np.zeros(rows, dtype=np.int32),
        time_ns=np.arange(rows),
        observation=before,
        action=action,
        reward=np.zeros(rows, dtype=np.float32),
        next_observation=after,
        terminated=np.ones(rows, dtype=bool),
        truncated=np.zeros(rows, dtype=bool),
        **({} if exogenous is None else {"exogenous": exogenous}),
    )


@settings(max_examples=60)
@given(spaces_and_states(), st.sampled_from(TARGETS))
def test_decoding_an_encoded_target_gives_the_next_state(case: Case, target: Target) -> None:
    features = fit_features(one_step_episodes(*case), FeatureParams(target=target))
    before, after = torch.from_numpy(case[1]), torch.from_numpy(case[3])
    decoded = features.decode(features.encode_target(before, after), before)
    # float32 cannot do better than this share of the largest number that takes part, in units of the dimension's scale.
    largest = max(1.0, float(((before.abs() + after.abs()) / torch.tensor(features.scale)).max()))
    error = (decoded - after).abs() / torch.tensor(features.scale)
    assert float(error.max()) <= 1e-5 * largest


@settings(max_examples=60)
@given(spaces_and_states())
def test_inputs_of_the_training_data_have_mean_0_and_deviation_1_unless_they_are_constant(
    case: Case,
) -> None:
    transitions = one_step_episodes(*case)
    x = fit_features(transitions, CHANGE).samples(transitions).x.double()
    constant = (x - x[0]).abs().amax(dim=0) < 1e-12
    assert float(x.mean(dim=0)[~constant].abs().sum()) <= 1e-4 * x.shape[1]
    torch.testing.assert_close(x.std(dim=0, correction=0)[~constant], torch.ones(int((~constant).sum())).double())


@settings(max_examples=40)
@given(spaces_and_states(), st.sampled_from(TARGETS))
def test_a_spec_survives_json(case: Case, target: Target) -> None:
    features = fit_features(one_step_episodes(*case), FeatureParams(target=target))
    assert FeatureSpec.from_json(json.loads(json.dumps(features.to_json(), allow_nan=False))) == features


@pytest.mark.parametrize("target", TARGETS)
def test_targets_equal_the_formula_in_float64(target: Target) -> None:
    world = drive()
    features = fit_features(world, FeatureParams(target=target))
    scale = np.array([1.8, 0.14])
    raw = world.next_observation.astype(float) - (world.observation.astype(float) if target == "change" else 0.0)
    scaled = raw / scale
    deviation = np.sqrt(np.mean(np.var(scaled, axis=0)))
    np.testing.assert_allclose(features.scale, scale)
    np.testing.assert_allclose(features.target_deviation, deviation, rtol=1e-12)
    np.testing.assert_allclose(features.samples(world).y, (scaled - scaled.mean(axis=0)) / deviation, atol=1e-5)


@pytest.mark.parametrize("loss", ["mse", "mae"])
def test_a_loss_times_its_unit_is_the_loss_of_states_scaled_to_one(loss: Literal["mse", "mae"]) -> None:
    world = drive()
    features = fit_features(world, CHANGE)
    target = features.samples(world).y
    output = target + torch.randn(target.shape, generator=torch.Generator().manual_seed(0))
    predicted = features.decode(output, torch.from_numpy(world.observation)).double()
    error = (predicted - torch.from_numpy(world.next_observation)) / torch.tensor(features.scale)
    expected = error.square().mean() if loss == "mse" else error.abs().mean()
    trained = (output - target).square().mean() if loss == "mse" else (output - target).abs().mean()
    assert float(trained) * features.loss_unit(loss) == pytest.approx(float(expected), rel=1e-4)


def test_discrete_actions_are_one_hot() -> None:
    features = fit_features(drive(), CHANGE)
    x = features.encode(torch.zeros(3, 2), torch.tensor([0, 1, 2]))
    one_hot = x[:, 2:] * torch.tensor(features.input_deviation[2:]) + torch.tensor(features.input_mean[2:])
    torch.testing.assert_close(one_hot, torch.eye(3))


def test_continuous_actions_enter_normalised() -> None:
    world = swing()
    features = fit_features(world, CHANGE)
    assert features.inputs == 4
    x = features.encode(torch.from_numpy(world.observation), torch.from_numpy(world.action))
    expected = (world.action - world.action.mean(axis=0)) / world.action.std(axis=0)
    np.testing.assert_allclose(x[:, 2:], expected, atol=1e-5)


def test_an_unbounded_dimension_is_scaled_by_the_range_of_the_data() -> None:
    world = swing()
    features = fit_features(world, FeatureParams(target="absolute"))
    assert features.scale == pytest.approx((float(np.ptp(world.observation[:, 0].astype(float))), 16.0))


def test_a_constant_column_is_divided_by_the_floor_and_not_by_nothing() -> None:
    world = one_step_episodes(
        ARM,
        np.array([[3.0, 1.0], [3.0, 2.0]], dtype=np.float32),
        np.array([[0.5, 0.0], [0.5, 1.0]], dtype=np.float32),
        np.array([[3.0, 2.0], [3.0, 3.0]], dtype=np.float32),
    )
    features = fit_features(world, CHANGE)
    assert features.scale[0] == 1.0
    assert features.input_deviation[0] == features.input_deviation[2] == DEVIATION_FLOOR
    assert float(features.samples(world).x.abs().max()) <= 1.0 + 1e-6
    still = fit_features(replace(world, next_observation=world.observation), CHANGE)
    assert still.target_deviation == DEVIATION_FLOOR


def test_a_bound_on_one_side_only_counts_as_none() -> None:
    world = swing()
    half = respace(world, (Dimension("angle", "rad", 0.0, np.inf), ARM.observation[1]))
    assert fit_features(half, CHANGE).scale == fit_features(world, CHANGE).scale


def test_samples_keep_the_order_the_episodes_and_the_steps() -> None:
    world = drive()
    samples = fit_features(world, CHANGE).samples(world)
    assert samples.episode.tolist() == world.episode.tolist()
    assert samples.step.tolist() == world.step.tolist()


def test_transitions_of_other_spaces_are_refused() -> None:
    with pytest.raises(ModelError, match="spaces"):
        fit_features(drive(), CHANGE).samples(swing())


def test_no_transitions_are_refused() -> None:
    with pytest.raises(TransitionsError, match="no training transitions"):
        fit_features(empty(drive()), CHANGE)


@pytest.mark.parametrize(
    ("observation", "action", "message"),
    [
        (torch.zeros(3, 3), torch.zeros(3).long(), r"shape \(B, 2\), but have \(3, 3\)"),
        (torch.zeros(2), torch.zeros(2).long(), r"shape \(B, 2\)"),
        (torch.zeros(3, 2), torch.zeros(2).long(), r"integers of shape \(3,\)"),
        (torch.zeros(3, 2), torch.zeros(3), "float32"),
        (torch.zeros(3, 2), torch.tensor([0, 1, 3]), r"0\.\.2"),
        (torch.zeros(3, 2), torch.tensor([0, -1, 2]), r"0\.\.2"),
    ],
)
def test_inputs_of_a_wrong_shape_and_actions_that_do_not_exist_are_refused(
    observation: torch.Tensor, action: torch.Tensor, message: str
) -> None:
    with pytest.raises(ModelError, match=message):
        fit_features(drive(), CHANGE).encode(observation, action)


def test_continuous_actions_of_a_wrong_shape_are_refused() -> None:
    with pytest.raises(ModelError, match=r"shape \(3, 2\), but have \(3, 1\)"):
        fit_features(swing(), CHANGE).encode(torch.zeros(3, 2), torch.zeros(3, 1))


@pytest.mark.parametrize("key", ["spaces", "target", "scale", "target_deviation"])
def test_a_description_with_a_key_missing_is_refused(key: str) -> None:
    value = fit_features(drive(), CHANGE).to_json()
    del value[key]
    with pytest.raises(ModelError, match="incomplete or malformed"):
        FeatureSpec.from_json(value)


@pytest.mark.parametrize(
    ("key", "found"), [("target", "sideways"), ("scale", [1.0]), ("input_mean", [0.0]), ("scale", 3)]
)
def test_a_description_with_a_wrong_value_is_refused(key: str, found: object) -> None:
    with pytest.raises(ModelError, match="incomplete or malformed"):
        FeatureSpec.from_json(fit_features(drive(), CHANGE).to_json() | {key: found})


@pytest.mark.parametrize("far", [float(np.finfo(np.float32).max), np.inf, 1e38, 1e30, 1e7])
@pytest.mark.parametrize("target", TARGETS)
def test_bounds_that_bound_nothing_leave_the_scale_to_the_data(far: float, target: Target) -> None:
    world = drive()
    none = tuple(replace(each, low=-np.inf, high=np.inf) for each in world.spec.observation)
    wide = tuple(replace(each, low=-far, high=far) for each in world.spec.observation)
    params = FeatureParams(target=target)
    expected = fit_features(respace(world, none), params)
    found = fit_features(respace(world, wide), params)
    assert found.scale == expected.scale
    assert found.target_deviation == expected.target_deviation > 1e-6
    assert found.samples(respace(world, wide)).y.abs().max() > 0.1


def test_bounds_near_the_data_are_the_scale() -> None:
    world = drive()
    widths = tuple(each.high - each.low for each in world.spec.observation)
    assert fit_features(world, CHANGE).scale == widths


@pytest.mark.parametrize(("far", "scale"), [(1.0, 2.0), (1e4, 2e4), (1e20, 1.0), (1e29, 1.0)])
def test_bounds_far_beyond_a_constant_column_are_not_its_scale(far: float, scale: float) -> None:
    world = drive()
    still = [values.copy() for values in (world.observation, world.next_observation)]
    for values in still:
        values[:, 1] = 0.5
    position, velocity = world.spec.observation
    world = respace(
        replace(world, observation=still[0], next_observation=still[1]),
        (position, replace(velocity, low=-far, high=far)),
    )
    assert fit_features(world, CHANGE).scale == (position.high - position.low, scale)
