"""Exogenous inputs as a network sees them: normalised beside state and action, in every frame, and never a target."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from learning import BOAT, CHANGE, drive, sail

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.features.transitions.spec import DEVIATION_FLOOR, FeatureSpec, fit_features
from addressed_dynamics.sources.transitions.params import FeatureParams

WORLD = sail((12, 9))


def test_they_enter_normalised_behind_the_action_and_are_never_a_target() -> None:
    features = fit_features(WORLD, CHANGE)
    samples = features.samples(WORLD)
    assert (features.inputs, features.outputs) == (4, 2)
    wind = WORLD.exogenous.astype(np.float64)
    np.testing.assert_allclose(samples.x[:, 3:], (wind - wind.mean(axis=0)) / wind.std(axis=0), atol=1e-5)
    other = features.samples(replace(WORLD, exogenous=-WORLD.exogenous))
    torch.testing.assert_close(other.y, samples.y, rtol=0.0, atol=0.0)
    torch.testing.assert_close(other.x[:, :3], samples.x[:, :3], rtol=0.0, atol=0.0)


def test_in_every_frame_of_a_window_the_value_of_a_step_stands_with_the_action_of_that_step() -> None:
    number = np.arange(len(WORLD), dtype=np.float32)[:, None]
    features = fit_features(
        replace(WORLD, action=number / 100, exogenous=number), FeatureParams(target="change", history=3)
    )
    samples = features.samples(replace(WORLD, action=number / 100, exogenous=number))
    frames = samples.x[:].view(len(samples), 3, 4) * torch.tensor(features.input_deviation)
    frames = frames + torch.tensor(features.input_mean)
    torch.testing.assert_close(frames[..., 3], frames[..., 2] * 100)
    rows = [row for row in range(len(WORLD)) if WORLD.step[row] >= 2]
    expected = np.array(rows)[:, None] + np.array([-2, -1, 0])
    np.testing.assert_allclose(frames[..., 3], expected, atol=1e-4)


def test_one_that_never_changes_is_divided_by_the_floor_of_its_bounds() -> None:
    still = replace(WORLD, exogenous=np.full_like(WORLD.exogenous, 1.5))
    features = fit_features(still, CHANGE)
    assert features.input_deviation[-1] == DEVIATION_FLOOR * 4.0
    assert features.samples(still).x[:, -1].abs().max() == 0


def test_the_spec_of_a_model_with_them_survives_json_and_one_without_them_says_nothing_of_them() -> None:
    features = fit_features(WORLD, CHANGE)
    assert FeatureSpec.from_json(json.loads(json.dumps(features.to_json(), allow_nan=False))) == features
    assert "exogenous" not in json.dumps(fit_features(drive(), CHANGE).to_json())
    short = features.to_json() | {"input_mean": [0.0] * 3}
    with pytest.raises(ModelError, match="input_mean should have 4 numbers, but has 3"):
        FeatureSpec.from_json(short)


def test_transitions_without_them_are_of_other_spaces() -> None:
    calm = replace(WORLD, spec=replace(BOAT, exogenous=()), exogenous=np.empty((len(WORLD), 0), np.float32))
    with pytest.raises(ModelError, match="spaces are not those"):
        fit_features(WORLD, CHANGE).samples(calm)
