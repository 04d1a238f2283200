import numpy as np
import pytest
import torch
from learning import drive, untrained_model

from addressed_dynamics.errors import EvaluationError
from addressed_dynamics.evaluation.candidates import MEAN, ensemble_candidates
from addressed_dynamics.evaluation.one_step import errors_per_dimension, predict_all, scaled_losses
from addressed_dynamics.evaluation.suite import (
    chosen_members,
    evaluate_addressing,
    evaluate_candidate,
    evaluate_oracle,
    member_losses,
)
from addressed_dynamics.models.addressed import MODES
from addressed_dynamics.transitions import COLUMNS, Transitions

WORLD = drive((30, 20, 25))
MODEL = untrained_model(WORLD)
SCALE = MODEL.features.scale


@pytest.mark.parametrize("loss", ["mse", "mae"])
def test_losses_are_of_states_scaled_to_one(loss: str) -> None:
    predicted = predict_all(MODEL.predict, WORLD)
    error = (predicted.double().numpy() - WORLD.next_observation) / np.array([1.8, 0.14])
    expected = (error**2 if loss == "mse" else np.abs(error)).mean(axis=1)
    np.testing.assert_allclose(scaled_losses(predicted, WORLD, SCALE, loss), expected, rtol=1e-9)


def test_a_perfect_prediction_has_no_loss() -> None:
    perfect = torch.from_numpy(WORLD.next_observation)
    assert float(scaled_losses(perfect, WORLD, SCALE, "mse").max()) == 0.0
    dimensions = errors_per_dimension(perfect, WORLD, WORLD.spec.observation)
    assert [dimension["squared"]["max"] for dimension in dimensions] == [0.0, 0.0]


def test_errors_of_a_dimension_are_in_its_own_unit() -> None:
    off = torch.from_numpy(WORLD.next_observation) + torch.tensor([0.5, -0.25])
    position, velocity = errors_per_dimension(off, WORLD, WORLD.spec.observation)
    assert (position["name"], position["unit"]) == ("position", "m")
    assert position["absolute"]["mean"] == pytest.approx(0.5, rel=1e-5)
    assert velocity["squared"]["median"] == pytest.approx(0.0625, rel=1e-5)


def test_predicting_in_blocks_gives_what_predicting_at_once_gives() -> None:
    predicted = predict_all(MODEL.predict, WORLD)
    at_once = MODEL.predict(torch.from_numpy(WORLD.observation), torch.from_numpy(WORLD.action))
    torch.testing.assert_close(predicted, at_once)


def test_no_test_episodes_and_predictions_that_are_not_finite_are_refused() -> None:
    empty = Transitions(spec=WORLD.spec, **{name: getattr(WORLD, name)[:0] for name in COLUMNS})
    with pytest.raises(EvaluationError, match="no test episodes"):
        predict_all(MODEL.predict, empty)
    with pytest.raises(EvaluationError, match="not finite"):
        predict_all(lambda observation, _: observation * float("nan"), WORLD)


def test_the_oracle_is_at_least_as_good_as_any_addressing_on_every_sample() -> None:
    losses = member_losses(MODEL, WORLD, "mse").losses
    chosen = losses.gather(0, chosen_members(MODEL, WORLD).unsqueeze(0))[0]
    oracle = evaluate_oracle(MODEL, WORLD, "mse")["one_step"]["scaled"]
    assert oracle["mean"] == pytest.approx(float(losses.min(dim=0).values.mean()))
    assert bool((losses.min(dim=0).values <= chosen).all())
    table = evaluate_addressing(MODEL, WORLD, "mse")
    assert table["regret"]["mean"] == pytest.approx(float(chosen.mean()) - oracle["mean"])


def test_every_mode_seed_and_variant_is_a_candidate_and_the_argmax_is_what_the_table_shows() -> None:
    other = untrained_model(WORLD, seed=1)
    models = {0: {"plain": MODEL, "cost_sensitive": other}, 5: {"plain": other, "cost_sensitive": MODEL}}
    candidates = {each.name: each for each in ensemble_candidates(models, {0: "plain", 5: "plain"})}
    assert {f"ensemble/{mode}" for mode in MODES} <= candidates.keys()
    assert {MEAN, "ensemble/argmax/cost_sensitive", "ensemble/argmax/seed-5"} <= candidates.keys()
    argmax = evaluate_candidate(candidates["ensemble/argmax"], WORLD, SCALE, "mse")
    losses = member_losses(MODEL, WORLD, "mse").losses
    chosen = losses.gather(0, chosen_members(MODEL, WORLD).unsqueeze(0))[0]
    assert argmax["one_step"]["scaled"]["mean"] == pytest.approx(float(chosen.mean()), rel=1e-5)
    mean = evaluate_candidate(candidates[MEAN], WORLD, SCALE, "mse")
    members = member_losses(MODEL, WORLD, "mse").predicted.mean(dim=0)
    expected = float(scaled_losses(members, WORLD, SCALE, "mse").mean())
    assert mean["one_step"]["scaled"]["mean"] == pytest.approx(expected, rel=1e-5)
    assert mean["parameters"] == 3 * MODEL.ensemble.parameters_per_member
