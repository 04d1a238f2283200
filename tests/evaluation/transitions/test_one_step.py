import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from acrobot_recordings import acrobot_recording
from hypothesis import given
from hypothesis import strategies as st
from learning import drive, untrained_model

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.episodes.transitions import COLUMNS, Transitions
from addressed_dynamics.evaluation.transitions.candidates import MEAN, ensemble_candidates, predictor_of
from addressed_dynamics.evaluation.transitions.hindsight import evaluate_oracle
from addressed_dynamics.evaluation.transitions.one_step import errors_per_dimension, predict_all, scaled_losses
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.suite import (
    evaluate_addressing,
    evaluate_candidate,
    evaluate_specialisation,
)
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.networks.frozen import FrozenMLP
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.modes import MODES, Mode
from addressed_dynamics.sources.transitions.params import AngleParams, FeatureParams

WORLD = drive((30, 20, 25))
MODEL = untrained_model(WORLD)
POINTS = Points.of(WORLD, MODEL.features)
ANGLES = tuple(
    AngleParams(name=f"angle_{i}", cosine=f"cos_angle_{i}", sine=f"sin_angle_{i}", velocity=f"velocity_{i}")
    for i in (1, 2)
)
SWINGING = acrobot_recording([12, 9])
TURNING = Points.of(SWINGING, fit_features(SWINGING, FeatureParams(target="change", history=3, angles=ANGLES)))


def at_angles(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """States of Acrobot at these angles, at rest."""
    still = np.zeros_like(first)
    return np.stack([np.cos(first), np.sin(first), np.cos(second), np.sin(second), still, still], axis=1).astype("f4")


@pytest.mark.parametrize("loss", ["mse", "mae"])
def test_losses_are_of_states_scaled_to_one(loss: str) -> None:
    predicted = predict_all(predictor_of(MODEL, "argmax"), POINTS)
    error = (predicted.double().numpy() - WORLD.next_observation) / np.array([1.8, 0.14])
    expected = (error**2 if loss == "mse" else np.abs(error)).mean(axis=1)
    np.testing.assert_allclose(scaled_losses(predicted, POINTS, loss), expected, rtol=1e-9)


def test_a_perfect_prediction_has_no_loss() -> None:
    perfect = torch.from_numpy(WORLD.next_observation)
    assert float(scaled_losses(perfect, POINTS, "mse").max()) == 0.0
    dimensions = errors_per_dimension(perfect, POINTS)
    assert [dimension["squared"]["max"] for dimension in dimensions] == [0.0, 0.0]


def test_errors_of_a_dimension_are_in_its_own_unit() -> None:
    off = torch.from_numpy(WORLD.next_observation) + torch.tensor([0.5, -0.25])
    position, velocity = errors_per_dimension(off, POINTS)
    assert (position["name"], position["unit"]) == ("position", "m")
    assert position["absolute"]["mean"] == pytest.approx(0.5, rel=1e-5)
    assert velocity["squared"]["median"] == pytest.approx(0.0625, rel=1e-5)


@given(angle=st.floats(-math.pi, math.pi), off=st.tuples(st.floats(-3.1, 3.1), st.floats(-3.1, 3.1)))
def test_the_error_of_an_angle_is_the_shorter_way_round(angle: float, off: tuple[float, float]) -> None:
    rows = len(SWINGING)
    first, seam = np.full(rows, angle), np.linspace(-0.01, 0.01, rows) + math.pi
    step, over = np.zeros(rows, dtype=np.int32), np.ones(rows, dtype=bool)
    world = replace(
        SWINGING, episode=np.arange(rows), step=step, terminated=over, next_observation=at_angles(first, seam)
    )
    points = Points.of(world, replace(TURNING.features, history=1))
    predicted = torch.from_numpy(at_angles(first + off[0], seam + off[1]))
    errors = {each["name"]: each for each in errors_per_dimension(predicted, points)}
    for name, expected in zip(("angle_1", "angle_2"), off, strict=True):
        assert errors[name]["unit"] == "rad"
        assert errors[name]["absolute"]["mean"] == pytest.approx(abs(expected), abs=1e-6)
        assert errors[name]["squared"]["max"] == pytest.approx(expected**2, abs=1e-5)


def test_angles_come_after_the_dimensions_and_are_right_where_those_are() -> None:
    perfect = torch.from_numpy(TURNING.next_observation)
    errors = errors_per_dimension(perfect, TURNING)
    assert [each["name"] for each in errors] == [*SWINGING.spec.observation_names, "angle_1", "angle_2"]
    assert all(each["absolute"]["max"] == each["squared"]["max"] == 0.0 for each in errors)


@pytest.mark.parametrize("loss", ["mse", "mae"])
@pytest.mark.parametrize(("velocity", "counted"), [("difference", 4), ("predicted", 6)])
def test_losses_are_over_what_a_network_predicts(loss: str, velocity: str, counted: int) -> None:
    angles = [each.model_dump() for each in ANGLES]
    settings = {"target": "change", "history": 3, "angles": angles, "velocity": velocity}
    features = fit_features(SWINGING, FeatureParams.model_validate(settings, strict=False))
    points = Points.of(SWINGING, features)
    off = torch.tensor([0.1, -0.2, 0.3, -0.4, 5.0, -6.0])
    error = (off.double() / torch.tensor(features.scale, dtype=torch.float64))[:counted]
    expected = float((error.square() if loss == "mse" else error.abs()).mean())
    losses = scaled_losses(torch.from_numpy(points.next_observation) + off, points, loss)
    torch.testing.assert_close(losses, torch.full((len(points),), expected).double(), rtol=1e-5, atol=1e-6)


def test_predictions_of_frames_in_blocks_are_those_of_the_frames_at_once() -> None:
    model = untrained_model(WORLD, history=3)
    points = Points.of(WORLD, model.features)
    at_once = model.predict(*points.inputs(torch.arange(len(points))))
    torch.testing.assert_close(predict_all(predictor_of(model, "argmax"), points), at_once)
    short = Points.of(drive((2, 2)), model.features)
    with pytest.raises(EvaluationError, match="no test episodes of at least 3 steps"):
        predict_all(predictor_of(model, "argmax"), short)


def test_predicting_in_blocks_gives_what_predicting_at_once_gives() -> None:
    predicted = predict_all(predictor_of(MODEL, "argmax"), POINTS)
    at_once = MODEL.predict(torch.from_numpy(WORLD.observation), torch.from_numpy(WORLD.action))
    torch.testing.assert_close(predicted, at_once)


def test_no_test_episodes_and_predictions_that_are_not_finite_are_refused() -> None:
    empty = Transitions(spec=WORLD.spec, **{name: getattr(WORLD, name)[:0] for name in COLUMNS})
    with pytest.raises(EvaluationError, match="no test episodes"):
        predict_all(predictor_of(MODEL, "argmax"), Points.of(empty, MODEL.features))
    with pytest.raises(EvaluationError, match="not finite"):
        predict_all(lambda _, point: torch.full((len(point), 2), math.nan), POINTS)


def test_the_oracle_is_at_least_as_good_as_any_addressing_on_every_sample() -> None:
    losses = POINTS.losses(MODEL, "mse")
    chosen = losses.gather(0, POINTS.probabilities(MODEL).argmax(dim=1).unsqueeze(0))[0]
    oracle = evaluate_oracle(MODEL, POINTS, "mse")["one_step"]["scaled"]
    assert oracle["mean"] == pytest.approx(float(losses.min(dim=0).values.mean()))
    assert bool((losses.min(dim=0).values <= chosen).all())
    table = evaluate_addressing(MODEL, POINTS, "mse")
    assert table["regret"]["mean"] == pytest.approx(float(chosen.mean()) - oracle["mean"])


def test_all_measures_share_one_pass_of_the_members_and_one_of_the_addressing(monkeypatch: pytest.MonkeyPatch) -> None:
    passes = list[tuple[int, ...]]()

    def count(kind: type, name: str) -> None:
        evaluate = getattr(kind, name)

        def counted(network: object, x: torch.Tensor | np.ndarray) -> torch.Tensor | np.ndarray:
            output: torch.Tensor | np.ndarray = evaluate(network, x)
            passes.append(tuple(output.shape))
            return output

        monkeypatch.setattr(kind, name, counted)

    for kind, name in ((StackedMLP, "forward"), (StackedMLP, "forward_all"), (FrozenMLP, "scores")):
        count(kind, name)
    monkeypatch.setattr(FrozenMLP, "forward_all", lambda *_: pytest.fail("all members are evaluated anew"))
    points = Points.of(WORLD, MODEL.features)
    for candidate in ensemble_candidates({0: {"plain": MODEL}}, {0: "plain"}):
        evaluate_candidate(candidate, points, "mse")
    evaluate_oracle(MODEL, points, "mse")
    evaluate_addressing(MODEL, points, "mse")
    evaluate_specialisation(MODEL, points, "mse")
    members, outputs = MODEL.ensemble.members, MODEL.ensemble.widths[-1]
    assert sorted(passes) == sorted([(len(points), members), (members, len(points), outputs)])


@pytest.mark.parametrize("mode", MODES)
def test_what_is_predicted_from_shared_passes_is_what_the_model_predicts(mode: Mode) -> None:
    for points in (POINTS, Points.of(SWINGING, untrained_model(SWINGING, history=3).features)):
        model = untrained_model(points.transitions, history=points.features.history)
        drawn = [torch.Generator().manual_seed(0) for _ in range(2)]
        found = predict_all(predictor_of(model, mode, drawn[0]), points)
        expected = model.predict(*points.inputs(torch.arange(len(points))), mode, generator=drawn[1])
        assert torch.equal(found, expected)


def test_every_mode_seed_and_variant_is_a_candidate_and_the_argmax_is_what_the_table_shows() -> None:
    other = untrained_model(WORLD, seed=1)
    models = {0: {"plain": MODEL, "cost_sensitive": other}, 5: {"plain": other, "cost_sensitive": MODEL}}
    candidates = {each.name: each for each in ensemble_candidates(models, {0: "plain", 5: "plain"})}
    assert {f"ensemble/{mode}" for mode in MODES} <= candidates.keys()
    assert {MEAN, "ensemble/argmax/cost_sensitive", "ensemble/argmax/seed-5"} <= candidates.keys()
    argmax = evaluate_candidate(candidates["ensemble/argmax"], POINTS, "mse")
    losses = POINTS.losses(MODEL, "mse")
    chosen = losses.gather(0, POINTS.probabilities(MODEL).argmax(dim=1).unsqueeze(0))[0]
    assert argmax["one_step"]["scaled"]["mean"] == pytest.approx(float(chosen.mean()), rel=1e-5)
    mean = evaluate_candidate(candidates[MEAN], POINTS, "mse")
    outputs = POINTS.outputs(MODEL).mean(dim=0)
    averaged = MODEL.features.decode(outputs, torch.from_numpy(WORLD.observation))
    expected = float(scaled_losses(averaged, POINTS, "mse").mean())
    assert mean["one_step"]["scaled"]["mean"] == pytest.approx(expected, rel=1e-5)
    assert mean["parameters"] == 3 * MODEL.ensemble.parameters_per_member
    assert mean["multiply_adds"] == MODEL.ensemble.multiply_adds()
