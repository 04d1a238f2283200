"""Networks that are given several frames: which frames, in which order, and how much the older ones weigh."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from learning import ADDRESSING, ENSEMBLE, drive, swing
from strategies import random_transitions, space_specs

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.transitions import DiscreteAction, Transitions
from addressed_dynamics.features.common import samples as samples_module
from addressed_dynamics.features.common.samples import Samples, Windows
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.sources.transitions.params import FeatureParams
from addressed_dynamics.training.addressing import train_addressing
from addressed_dynamics.training.ensemble import evaluate_profiles, train_ensemble

WORLDS = {"car": drive((9, 2, 14, 3)), "arm": swing((9, 2, 14, 3))}
histories = st.integers(2, 7)
weights = st.floats(0.01, 3.0)


def fitted(world: Transitions, history: int, weight: float = 1.0) -> FeatureSpec:
    return fit_features(world, FeatureParams(target="change", history=history, history_weight=weight))


def frame(world: Transitions, features: FeatureSpec, row: int) -> np.ndarray:
    """State and action of one row, normalised, in float64."""
    kind, action = world.spec.action, world.action[row]
    encoded = np.eye(kind.count)[action] if isinstance(kind, DiscreteAction) else action.astype(np.float64)
    raw = np.concatenate([world.observation[row].astype(np.float64), encoded])
    return (raw - features.input_mean) / features.input_deviation


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
@given(history=histories, weight=weights)
def test_inputs_are_the_frames_of_one_episode_oldest_first(world: Transitions, history: int, weight: float) -> None:
    features = fitted(world, history, weight)
    samples = features.samples(world)
    rows = [row for row in range(len(world)) if world.step[row] >= history - 1]
    share = math.sqrt((1.0 + (history - 1) * weight**2) / history)
    expected = [
        np.concatenate(
            [frame(world, features, row - age) * (weight if age else 1.0) / share for age in reversed(range(history))]
        )
        for row in rows
    ]
    assert features.inputs == history * len(features.input_mean)
    np.testing.assert_allclose(samples.x[:], np.array(expected), rtol=1e-4, atol=1e-5)
    assert samples.episode.tolist() == world.episode[rows].tolist()
    assert samples.step.tolist() == world.step[rows].tolist()


@given(st.lists(st.integers(1, 9), min_size=1, max_size=6).filter(lambda lengths: max(lengths) >= 2), histories)
def test_there_is_a_sample_for_every_row_with_enough_rows_of_its_episode_before_it(
    lengths: list[int], history: int
) -> None:
    assume(max(lengths) >= history)
    world = drive(lengths)
    samples = fitted(world, history).samples(world)
    assert len(samples) == sum(max(length - history + 1, 0) for length in lengths)
    assert samples.y.shape == (len(samples), 2)
    assert all(step >= history - 1 for step in samples.step.tolist())


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_a_target_is_that_of_the_last_frame(world: Transitions) -> None:
    alone, together = fitted(world, 1).samples(world), fitted(world, 4).samples(world)
    enough = alone.step >= 3
    torch.testing.assert_close(together.y, alone.y[enough], rtol=0.0, atol=0.0)


@settings(max_examples=20)
@given(space_specs(max_size=4).flatmap(lambda spec: st.tuples(st.just(spec), st.integers(0, 2**31 - 1))), histories)
def test_samples_are_what_encoding_the_frames_gives(case: tuple, history: int) -> None:
    spec, seed = case
    world = random_transitions(spec, [history + 3, history - 1], np.random.default_rng(seed))
    features = fitted(world, history, 0.5)
    places = np.arange(history - 1, history + 3)[:, None] + np.arange(1 - history, 1)
    columns = (world.observation, world.action, world.exogenous)
    encoded = features.encode(*(torch.from_numpy(values[places]) for values in columns))
    torch.testing.assert_close(features.samples(world).x[:], encoded, rtol=0.0, atol=0.0)


@given(history=histories, weight=weights)
def test_a_weight_is_the_size_of_older_frames_beside_the_last_and_keeps_the_variance_of_all(
    history: int, weight: float
) -> None:
    features = fitted(WORLDS["car"], history, weight)
    columns = len(features.input_mean)
    joined = features.join(torch.ones(1, history, columns)).view(history, columns)
    torch.testing.assert_close(joined[:-1], joined[-1:].expand(history - 1, -1) * weight)
    assert float(joined.square().mean()) == pytest.approx(1.0, rel=1e-5)


@given(history=histories)
def test_a_weight_of_one_leaves_frames_alone(history: int) -> None:
    frames = torch.randn(3, history, 5, generator=torch.Generator().manual_seed(history))
    joined = fitted(WORLDS["car"], history).join(frames)
    torch.testing.assert_close(joined, frames.flatten(start_dim=1), rtol=0.0, atol=0.0)


def test_without_a_history_a_weight_changes_nothing() -> None:
    world = WORLDS["car"]
    plain, weighted = fitted(world, 1).samples(world), fitted(world, 1, 0.1).samples(world)
    assert torch.equal(plain.x, weighted.x)
    assert plain.x.shape == (len(world), 5)


def test_a_spec_with_a_history_survives_json() -> None:
    features = fitted(WORLDS["arm"], 6, 0.3)
    read = FeatureSpec.from_json(json.loads(json.dumps(features.to_json(), allow_nan=False)))
    assert read == features
    assert (read.history, read.history_weight, read.inputs) == (6, 0.3, 24)


@pytest.mark.parametrize("history", [0, -3])
def test_a_spec_of_no_frames_is_refused(history: int) -> None:
    with pytest.raises(ModelError, match="history should be at least 1"):
        FeatureSpec.from_json({**fitted(WORLDS["car"], 2).to_json(), "history": history})


@pytest.mark.parametrize(
    ("observation", "action", "message"),
    [
        (torch.zeros(3, 2), torch.zeros(3).long(), r"shape \(B, 4, 2\), but have \(3, 2\)"),
        (torch.zeros(3, 5, 2), torch.zeros(3, 5).long(), r"shape \(B, 4, 2\), but have \(3, 5, 2\)"),
        (torch.zeros(3, 4, 3), torch.zeros(3, 4).long(), r"shape \(B, 4, 2\)"),
        (torch.zeros(3, 4, 2), torch.zeros(3).long(), r"integers of shape \(3, 4\)"),
        (torch.zeros(3, 4, 2), torch.zeros(3, 3).long(), r"integers of shape \(3, 4\)"),
        (torch.zeros(3, 4, 2), torch.full((3, 4), 3), r"0\.\.2"),
    ],
)
def test_frames_of_a_wrong_shape_are_refused(observation: torch.Tensor, action: torch.Tensor, message: str) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        fitted(WORLDS["car"], 4).encode(observation, action)
    assert "\n" not in str(caught.value)


def test_continuous_actions_of_a_wrong_number_of_frames_are_refused() -> None:
    with pytest.raises(ModelError, match=r"shape \(3, 4, 2\), but have \(3, 2\)"):
        fitted(WORLDS["arm"], 4).encode(torch.zeros(3, 4, 2), torch.zeros(3, 2))


def materialised(samples: Samples) -> Samples:
    """Return the same samples with every window in memory by itself."""
    return replace(samples, x=samples.x[:].clone())


def test_frames_are_kept_once_and_windows_are_put_together_for_each_batch() -> None:
    world = drive((9, 2, 14, 3))
    samples = fitted(world, 4, 0.5).samples(world)
    assert isinstance(samples.x, Windows)
    assert samples.x.frames.untyped_storage().nbytes() == 4 * 5 * len(world)
    whole = materialised(samples)
    assert samples.x.shape == whole.x.shape
    assert samples.x.ndim == whole.x.ndim
    rows = torch.tensor([[3, 0, 3], [len(samples) - 1, 1, 5]])
    assert torch.equal(samples.x[rows], whole.x[rows])
    assert torch.equal(samples.x[2:5], whole.x[2:5])


def test_training_on_windows_is_training_on_each_window_by_itself_bit_for_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(samples_module, "BLOCK_ROWS", 7)
    train, validation = (drive((40, 2, 30), seed) for seed in (0, 1))
    features = fitted(train, 4, 0.5)
    found = list[list[torch.Tensor]]()
    both = features.samples(train), features.samples(validation)
    for own, other in (both, tuple(map(materialised, both))):
        *_, ensemble = train_ensemble(own, other, ENSEMBLE, seed=0, loss_unit=1.0)
        profiles = [evaluate_profiles(ensemble.network, each, "mse") for each in (own, other)]
        *_, addressing = train_addressing(own, profiles[0], other, profiles[1], ADDRESSING, seed=0, variant="plain")
        found.append([*ensemble.network.parameters(), *addressing.network.parameters(), *profiles])
        assert own.fingerprint() == both[0].fingerprint()
    assert all(torch.equal(window, alone) for window, alone in zip(*found, strict=True))
