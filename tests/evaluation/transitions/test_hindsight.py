"""The best of several guesses in hindsight: of the members, and of random guesses with their mean and spread."""

import numpy as np
import pytest
import torch
from learning import drive, untrained_model

from addressed_dynamics.evaluation.transitions.candidates import predictor_of
from addressed_dynamics.evaluation.transitions.hindsight import evaluate_guesses, evaluate_oracle, random_guesses
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.records import CandidateResult
from addressed_dynamics.evaluation.transitions.suite import one_step_errors
from addressed_dynamics.simulators.addressed import AddressedDynamics

WORLD = drive((30, 20, 25))


@pytest.mark.parametrize("loss", ["mse", "mae"])
def test_one_member_in_hindsight_is_the_member_and_so_is_one_random_guess(loss: str) -> None:
    model = untrained_model(WORLD, 1)
    points = Points.of(WORLD, model.features)
    expected = one_step_errors(predictor_of(model, "argmax")(points, torch.arange(len(points))), points, loss)
    for evaluate in (evaluate_oracle, evaluate_guesses):
        found = evaluate(model, points, loss)
        assert found["one_step"]["scaled"]["mean"] == pytest.approx(expected["scaled"]["mean"], rel=1e-6)
        assert found["label"] in {"hindsight over one guess (the members)", "hindsight over one random guess"}


def test_random_guesses_have_the_mean_and_the_covariance_of_the_members_at_every_point() -> None:
    members = torch.tensor([[1.0, 4.0], [3.0, 4.0], [2.0, 10.0], [-2.0, 6.0]])
    guesses = random_guesses(members.unsqueeze(1).expand(4, 50_000, 2))(slice(None)).flatten(end_dim=1).numpy()
    np.testing.assert_allclose(guesses.mean(axis=0), members.mean(dim=0), atol=0.03)
    np.testing.assert_allclose(np.cov(guesses.T), np.cov(members.numpy().T, bias=True), atol=0.08)


def test_random_guesses_are_independent_of_each_other_and_the_same_every_time() -> None:
    outputs = torch.randn(3, 20_000, 1, generator=torch.Generator().manual_seed(1))
    guesses = random_guesses(outputs)(slice(None))
    assert torch.equal(guesses[:, 1:], random_guesses(outputs)(slice(1, None)))
    shares = (guesses - outputs.mean(dim=0))[..., 0] / outputs.std(dim=0, correction=0)[..., 0]
    np.testing.assert_allclose(np.corrcoef(shares.numpy()), np.eye(3), atol=0.03)


def test_members_that_know_something_are_better_in_hindsight_than_random_guesses_of_their_spread() -> None:
    model = untrained_model(WORLD, 2)
    points = Points.of(WORLD, model.features)
    truth = model.features.encode_target(
        torch.from_numpy(points.observation), torch.from_numpy(points.next_observation)
    )
    # At every point one of the two is right, and the other is off by one.
    right = torch.arange(len(points)) % 2 == 0
    outputs = torch.stack(
        [truth + torch.where(right, 0.0, 1.0)[:, None], truth + torch.where(right, 1.0, 0.0)[:, None]]
    )
    points._kept["outputs", model.features, model.ensemble] = outputs
    found, guessed = (
        CandidateResult.model_validate(each(model, points, "mae")) for each in (evaluate_oracle, evaluate_guesses)
    )
    assert found.one_step.scaled.mean < 1e-6
    # Guesses are at 0.5 + z / 2 from the truth: the better of two is off by 0.29 in the mean.
    draws = np.abs(0.5 + 0.5 * np.random.default_rng(0).standard_normal((2, 200_000))).min(axis=0).mean()
    assert guessed.one_step.scaled.mean == pytest.approx(draws * model.features.target_deviation, rel=0.15)
    assert (found.label, guessed.label) == (
        "hindsight over 2 guesses (the members)",
        "hindsight over 2 random guesses",
    )


def test_hindsight_has_the_size_of_all_members_and_none_of_their_addressing() -> None:
    model = untrained_model(WORLD, 3)
    assert isinstance(model, AddressedDynamics)
    for evaluate in (evaluate_oracle, evaluate_guesses):
        found = evaluate(model, Points.of(WORLD, model.features), "mse")
        assert found["parameters"] == model.ensemble.parameters_total
        assert found["multiply_adds"] == model.ensemble.multiply_adds()
