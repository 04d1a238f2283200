"""How much of what changes in a step a model explains."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from learning import drive, untrained_model

from addressed_dynamics.evaluation.transitions.candidates import ensemble_candidates
from addressed_dynamics.evaluation.transitions.measures.explained import measure
from addressed_dynamics.evaluation.transitions.points import Points

WORLD = drive((30, 20, 25))
POINTS = Points.of(WORLD, untrained_model(WORLD).features)


def explained(predicted: np.ndarray, points: Points = POINTS) -> dict[str, float]:
    """What is explained by a candidate that predicts these states."""
    candidate = ensemble_candidates({0: {"plain": untrained_model(WORLD)}}, {0: "plain"})[0]
    predictor = lambda _, point: torch.from_numpy(predicted)[point]  # noqa: E731 - as short as it is
    return {row.quantity: row.value for row in measure(replace(candidate, predictor=predictor), points)}


def test_the_truth_explains_everything_and_the_state_before_nothing() -> None:
    assert explained(WORLD.next_observation) == {"position": 100.0, "velocity": 100.0}
    assert explained(WORLD.observation) == {"position": 0.0, "velocity": 0.0}


def test_half_of_the_way_explains_three_quarters_and_twice_as_far_nothing() -> None:
    change = WORLD.next_observation.astype(np.float64) - WORLD.observation
    halfway, beyond = ((WORLD.observation + share * change).astype(np.float32) for share in (0.5, 2.0))
    assert explained(halfway) == pytest.approx({"position": 75.0, "velocity": 75.0}, abs=0.1)
    assert explained(beyond) == pytest.approx({"position": 0.0, "velocity": 0.0}, abs=0.3)


def test_what_never_changes_is_left_out() -> None:
    columns = {
        name: getattr(WORLD, name) * np.array([0.0, 1.0], np.float32) for name in ("observation", "next_observation")
    }
    still = replace(WORLD, **columns)
    assert set(explained(WORLD.observation, replace(POINTS, transitions=still))) == {"velocity"}
