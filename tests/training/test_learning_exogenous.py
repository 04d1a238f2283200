"""What an exogenous input drives cannot be learned without it, and is learned with it."""

from dataclasses import replace

import numpy as np
from learning import BOAT, CHANGE, ENSEMBLE, sail

from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.training.ensemble import train_ensemble


def without_wind(world: Transitions) -> Transitions:
    """The same transitions, of which nobody recorded the wind."""
    return replace(world, spec=replace(BOAT, exogenous=()), exogenous=np.empty((len(world), 0), np.float32))


def validation_loss(train: Transitions, validation: Transitions) -> float:
    """The mean squared error of the best member, as a share of the variance of the targets."""
    features = fit_features(train, CHANGE)
    params = ENSEMBLE.model_copy(update={"members": 1, "epochs": 30, "cluster_epochs": 1})
    parts = (features.samples(each) for each in (train, validation))
    *_, last = train_ensemble(*parts, params, seed=0, loss_unit=1.0)
    return last.metrics["loss/validation"]


def test_a_boat_in_a_random_wind_is_learned_with_the_wind_and_is_a_riddle_without_it() -> None:
    train, validation = sail((20,) * 15, seed=1), sail((20,) * 5, seed=2)
    assert validation_loss(train, validation) < 0.02
    assert validation_loss(without_wind(train), without_wind(validation)) > 0.5
