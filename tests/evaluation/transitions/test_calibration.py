import numpy as np
import pytest
import torch
from learning import drive, untrained_model
from trusted_models import NOISE, drifting, linear_pair, trusted_model

from addressed_dynamics.base.errors import EvaluationError, ModelError
from addressed_dynamics.evaluation.transitions.calibration import (
    _multiples,
    calibrate,
    cover,
    stretches,
)
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.trust import Reference
from addressed_dynamics.sources.transitions.params import FeatureParams


def test_intervals_of_gaussian_noise_are_its_quantiles():
    model, _, _ = trusted_model()
    test = drifting(100, 7)
    low, high = model.interval(test.observation, test.action, 0.9)
    inside = (low <= test.next_observation) & (test.next_observation <= high)
    assert np.abs(inside.mean(axis=0) - 0.9).max() < 0.02
    assert np.median((high - low) / 2) == pytest.approx(1.645 * NOISE, rel=0.1)


@pytest.mark.parametrize("history", [1, 3])
@pytest.mark.parametrize("coverage", [0.5, 0.9])
def test_intervals_of_rollouts_cover_their_share_of_new_episodes(history, coverage):
    model, _, _ = trusted_model(history)
    ways = stretches(Points.of(drifting(200, 8), model.features), 25, 200, "test")
    found = model.rollout(ways.history.numpy(), ways.actions.numpy(), with_trust=True, coverage=coverage)
    inside = (found.low <= ways.states.numpy()) & (ways.states.numpy() <= found.high)
    for step in (1, 5, 10, 20):
        there = ways.there[:, step - 1]
        assert inside[there, step - 1].mean() == pytest.approx(coverage, abs=0.06)


def test_a_rollout_with_trust_has_the_states_of_one_without():
    model, _, _ = trusted_model()
    test = drifting(5, 9)
    actions = test.action.reshape(5, 40, 1)[:, :20]
    found = model.rollout(test.observation[::40], actions, with_trust=True)
    assert np.array_equal(found.states, model.rollout(test.observation[::40], actions))
    assert found.low.shape == found.high.shape == (5, 20, 2)
    assert found.trust.shape == (5, 20)
    # The first step's interval is that of a single step.
    low, high = model.interval(test.observation[::40], actions[:, 0])
    assert np.allclose(found.low[:, 0], low, atol=1e-6)
    assert np.allclose(found.high[:, 0], high, atol=1e-6)
    one = model.rollout(test.observation[0], actions[0], with_trust=True)
    assert one.trust.shape == (20,)
    assert np.allclose(one.low, found.low[0], atol=1e-6)


def test_beyond_the_calibrated_steps_nothing_is_known():
    model, _, trust = trusted_model()
    found = model.rollout(np.zeros((1, 2), np.float32), np.zeros((1, 40, 1), np.float32), with_trust=True)
    assert trust.steps[-1] == 30
    assert np.isfinite(found.high[0, :30]).all()
    assert (found.high[0, 30:] == np.inf).all()
    assert (found.low[0, 30:] == -np.inf).all()


def test_trust_is_even_on_data_like_the_validation_episodes():
    model, _, _ = trusted_model()
    test = drifting(100, 10)
    trust = model.trust(test.observation, test.action)
    assert trust.min() >= 0
    assert trust.max() <= 1
    for level in (0.1, 0.5, 0.9):
        assert (trust < level).mean() == pytest.approx(level, abs=0.06)


def test_trust_falls_far_from_the_data_and_intervals_grow():
    model, _, _ = trusted_model()
    near, far = np.zeros((1, 2), np.float32), np.full((1, 2), 100.0, np.float32)
    push = np.zeros((1, 1), np.float32)
    assert model.trust(near, push)[0] > 0.2
    assert model.trust(far, push)[0] == 0.0
    widths = [np.subtract(*model.interval(state, push)[::-1]).max() for state in (near, far)]
    assert widths[1] > 10 * widths[0]


def test_what_is_no_number_is_not_trusted():
    model, _, _ = trusted_model()
    states = np.array([[0.0, np.nan], [np.inf, 0.0], [0.0, 0.0]], np.float32)
    trust = model.trust(states, np.zeros((3, 1), np.float32))
    assert trust[:2].tolist() == [0.0, 0.0]
    assert trust[2] > 0
    with pytest.raises(ModelError, match="should be finite"):
        model.interval(states, np.zeros((3, 1), np.float32))


def test_a_rollout_that_leaves_all_bounds_is_not_trusted():
    model, partner, trust = trusted_model()
    wild = AddressedDynamics(model.features, _times(model.ensemble, 1e4), trust=trust)
    found = wild.rollout(np.ones((1, 2), np.float32), np.ones((1, 30, 1), np.float32), with_trust=True)
    assert not np.isfinite(found.states[0, -1]).all()
    assert found.trust[0, -1] == 0.0
    assert partner.features == model.features


def test_surprise_is_one_on_average_and_grows_with_changed_mechanics():
    model, _, _ = trusted_model()
    same, changed = drifting(100, 11), drifting(100, 11, gain=1.0)
    usual = model.surprise(same.observation, same.action, same.next_observation)
    other = model.surprise(changed.observation, changed.action, changed.next_observation)
    assert usual.mean() == pytest.approx(1.0, abs=0.1)
    assert other.mean() > 2
    nothing = model.surprise(np.zeros(2), np.zeros(1), np.array([np.nan, 0.0]))
    assert nothing == np.inf


@pytest.mark.parametrize("size", [1e19, 1e38, 3e38])
def test_states_whose_squares_no_float_holds_are_not_trusted_and_have_endless_intervals(size):
    model, _, _ = trusted_model()
    push = np.zeros((2, 1), np.float32)
    for state in ([size, size], [size, -size]):
        states = np.array([state, [0.0, 0.0]], np.float32)
        trust, (low, high) = model.trust(states, push), model.interval(states, push)
        assert trust[0] == 0.0 < trust[1]
        assert (low[0] == -np.inf).all()
        assert (high[0] == np.inf).all()
        assert np.isfinite([low[1], high[1]]).all()
        found = model.rollout(states, np.zeros((2, 3, 1)), with_trust=True)
        assert (found.low[0] == -np.inf).all()
        assert found.trust[0].tolist() == [0.0, 0.0, 0.0]
    assert model.trust([[0.0, 0.0]], [[size]]) == 0.0


def test_no_states_have_no_trust():
    model, _, _ = trusted_model()
    assert model.trust(np.empty((0, 2)), np.empty((0, 1))).shape == (0,)
    # Frames that overlap in memory, as windows of a sequence do.
    longer, _, _ = trusted_model(3)
    frames = torch.zeros(3, 4, 2).permute(1, 0, 2)
    assert longer.trust(frames, torch.zeros(4, 3, 1)).shape == (4,)


@pytest.mark.parametrize("coverage", ["0.9", None, [0.9], np.array([0.5, 0.9])])
def test_a_coverage_that_is_no_number(coverage):
    model, _, _ = trusted_model()
    with pytest.raises(ModelError, match="a share between 0 and 1, for instance"):
        model.interval(np.zeros((1, 2)), np.zeros((1, 1)), coverage)


@pytest.mark.parametrize(("coverage", "what"), [(0.0, "between 0 and 1"), (1.0, "between 0 and 1"), (0.999, "0.01 to")])
def test_no_such_coverage(coverage, what):
    model, _, _ = trusted_model()
    with pytest.raises(ModelError, match=what):
        model.interval(np.zeros((1, 2)), np.zeros((1, 1)), coverage)


def test_a_model_that_nobody_calibrated():
    model, partner, _ = trusted_model()
    with pytest.raises(ModelError, match="nobody calibrated"):
        partner.trust(np.zeros((1, 2)), np.zeros((1, 1)))
    with pytest.raises(ModelError, match="own mode"):
        model.rollout(np.zeros((1, 2)), np.zeros((1, 3, 1)), "mixture", with_trust=True)


def test_too_few_episodes():
    model, partner, _ = trusted_model()
    train, one = (Points.of(drifting(number, 0), model.features) for number in (10, 1))
    with pytest.raises(EvaluationError, match="at least 2 validation episodes, but there are 1: raise"):
        calibrate(model, partner, train, one, steps=10)


def test_calibration_says_the_same_again():
    model, partner, trust = trusted_model()
    train, validation = (Points.of(drifting(number, seed), model.features) for number, seed in ((80, 0), (40, 1)))
    again = calibrate(model, partner, train, validation, steps=30)
    assert np.array_equal(again.multiples, trust.multiples)
    assert torch.equal(again.gauge.tensors["centres"], trust.gauge.tensors["centres"])


def test_the_product_of_all_layers_and_centres_is_each_by_itself():
    _, _, trust = trusted_model()
    gauge, known = trust.gauge, trust.gauge.tensors
    x = torch.randn(200, 3, generator=torch.Generator().manual_seed(0))
    apart = torch.rand(200, 2, generator=torch.Generator().manual_seed(1)) * 0.1
    found = gauge.scales(x, apart)
    standard = (x - known["mean"]) / known["deviation"]
    scale = torch.tensor(gauge.features.scale)
    logs = gauge.errors(standard)[0] + known["error_mean"]
    weights = known["weights"]
    size = torch.exp(weights[0] * logs + weights[1] * (apart / scale + known["floor"]).log() + weights[2])
    nearest = torch.cdist(x, known["centres"]).min(dim=1).values / 3**0.5
    unlike = (standard @ known["whitening"]).square().mean(dim=1).sqrt()
    farther = torch.maximum(nearest / known["limits"][0], unlike / known["limits"][1]).clamp(min=1.0)
    assert torch.allclose(found.error, size * scale * farther.unsqueeze(1), rtol=2e-3)
    assert np.allclose(np.exp(found.signals[1]), nearest, atol=2e-3)
    assert np.allclose(np.exp(found.signals[2]), unlike, rtol=1e-4)


def test_centres_cover_all_rows():
    x = torch.rand(2000, 2, generator=torch.Generator().manual_seed(0))
    centres = cover(x, 100)
    assert len(centres) == 100
    assert float(torch.cdist(x, centres).min(dim=1).values.max()) < 0.15
    assert len(cover(torch.ones(5, 2), 100)) == 1


def _times(network, factor):
    import copy

    larger = copy.deepcopy(network)
    larger.weights[0].mul_(factor)
    return larger


def test_an_input_that_never_changes_is_no_noise_and_its_first_change_is_not_trusted():
    train, validation = drifting(30, 0), drifting(20, 1)
    for each in (train, validation):
        each.action[:] = 0.3
    features = fit_features(train, FeatureParams())
    model, _, trust = linear_pair(features, train, validation, steps=5)
    trusted = AddressedDynamics(features, model.ensemble, trust=trust)
    state = train.observation[:20]
    assert trusted.trust(state, np.full((20, 1), 0.3)).mean() > 0.2
    assert trusted.trust(state, np.full((20, 1), 1.0)).max() < 0.01


@pytest.mark.parametrize("number", [1, 2, 4])
def test_points_that_are_all_alike_are_neither_beyond_all_nor_surprising(number):
    values = np.random.default_rng(0).integers(0, number, 4000).astype(np.float64)
    reference = Reference.of(values)
    assert reference.share_above(values).mean() == pytest.approx(0.5, abs=1e-3)
    assert reference.share_above(values).min() > 0.0
    assert 0.5 < reference.unlikely(values).mean() <= 1.0
    assert reference.share_above(np.array([number, -1.0])).tolist() == [0.0, 1.0]
    assert reference.unlikely(np.array([number, -1.0])).tolist()[0] > 1e6


def test_trust_in_states_of_the_training_does_not_hang_on_what_else_is_asked():
    train, validation = drive(), drive(seed=5)
    model, partner = untrained_model(train), untrained_model(train, seed=1)
    points = Points.of(train, model.features)
    trust = calibrate(model, partner, points, Points.of(validation, model.features), steps=10)
    trusted = AddressedDynamics(model.features, model.ensemble, model.addressing, trust=trust)
    together = trusted.trust(train.observation[:5], train.action[:5])
    alone = [trusted.trust(*given) for given in zip(train.observation[:5], train.action[:5], strict=True)]
    assert np.allclose(together, alone, atol=1e-5)


def test_few_points_calibrate_no_high_coverage():
    model, partner, _ = trusted_model()
    train, few = (Points.of(drifting(number, 3, length=4), model.features) for number in (30, 3))
    trust = calibrate(model, partner, train, few, steps=4)
    assert trust.coverages[-1] == 0.9
    trusted = AddressedDynamics(model.features, model.ensemble, trust=trust)
    with pytest.raises(ModelError, match=r"3 validation episodes calibrate coverages from 0\.01 to 0\.9, but 0\.95"):
        trusted.interval(np.zeros((1, 2)), np.zeros((1, 1)), 0.95)


def test_an_episode_counts_as_much_as_any_other_however_long_it_is():
    generator = np.random.default_rng(0)
    lengths = np.where(np.arange(400) % 10 == 0, 200, 2)
    episode = np.repeat(np.arange(400), lengths)
    # Long episodes, nine tenths of all rows, have small errors.
    ratios = np.abs(generator.normal(size=(len(episode), 1))) * np.where(lengths == 200, 0.1, 1.0)[episode][:, None]
    (half,), (most,) = _multiples(ratios, episode, (0.5, 0.9))
    by_episode = [np.mean([(ratios[episode == each] <= limit).mean() for each in range(400)]) for limit in (half, most)]
    assert by_episode == pytest.approx([0.5, 0.9], abs=0.01)
    assert (ratios <= half).mean() > 0.9


def test_an_episode_has_as_many_stretches_as_any_other_where_it_has_so_many():
    model, _, _ = trusted_model()
    episodes = drifting(30, 4)
    rows = (episodes.episode >= 5) | (episodes.step < 3)
    ways = stretches(Points.of(episodes.select(rows), model.features), 20, 120, "test")
    counts = np.bincount(ways.episode)
    assert counts[:5].tolist() == [2] * 5 or counts[:5].max() <= 3
    assert counts[5:].max() - counts[5:].min() <= 1
    assert counts.sum() == 120
