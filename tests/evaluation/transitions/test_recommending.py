"""Which model is recommended: the best on validation episodes, and never one that is worse than a reference."""

from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.evaluation.transitions.recommending import (
    SLACK,
    Course,
    Score,
    choose,
    deliver,
    simplest,
)
from addressed_dynamics.simulators.delivery import Choice

NAMES = ("ensemble/argmax", "ensemble/mixture", "total_parameters/seed-0", "persistence/seed-0", "linear/seed-0")
SCORES = st.builds(Score, st.floats(0.01, 100), st.floats(0.01, 1000), st.floats(0.1, 100))


@given(scores=st.fixed_dictionaries(dict.fromkeys(NAMES, SCORES)))
def test_what_is_recommended_is_never_worse_than_a_reference_in_rollouts_nor_than_nothing_in_a_step(
    scores: dict[str, Score],
) -> None:
    name, sound = choose(scores)
    references = [scores["persistence/seed-0"], scores["linear/seed-0"]]
    best_step = scores["persistence/seed-0"].one_step_percent
    best_rollout = min(each.rollout_percent for each in references)
    chosen = scores[name]
    if sound:
        assert chosen.one_step_percent <= SLACK * best_step
        assert chosen.rollout_percent <= SLACK * best_rollout
        assert not name.startswith(("persistence", "linear"))
    else:
        assert chosen in references
        assert chosen.rank == min(each.rank for each in references if each.rollout_percent <= SLACK * best_rollout)


@pytest.mark.parametrize(
    ("mixture", "expected"),
    [
        (Score(1.0, 3.0, 50.0), ("ensemble/mixture", True)),  # holds longest
        (Score(1.0, 6.0, 50.0), ("total_parameters/seed-0", True)),  # worse in rollouts than least squares
        (Score(1.2, 3.0, 50.0), ("total_parameters/seed-0", True)),  # worse in a step than nothing
    ],
)
def test_the_horizon_comes_first_among_those_that_are_no_worse(mixture: Score, expected: tuple[str, bool]) -> None:
    scores = {
        "ensemble/argmax": Score(2.0, 20.0, 5.0),
        "ensemble/mixture": mixture,
        "total_parameters/seed-0": Score(0.9, 4.0, 40.0),
        "persistence/seed-0": Score(1.0, 9.0, 20.0),
        "linear/seed-0": Score(1.1, 5.0, 30.0),
    }
    assert choose(scores) == expected


def test_a_reference_is_recommended_where_everything_trained_is_worse() -> None:
    scores = {
        "ensemble/argmax": Score(2.0, 20.0, 5.0),
        "persistence/seed-0": Score(1.0, 9.0, 20.0),
        "linear/seed-0": Score(1.1, 5.0, 30.0),
    }
    assert choose(scores) == ("linear/seed-0", False)


def test_least_squares_that_fly_off_in_the_end_are_not_delivered_for_holding_longer() -> None:
    scores = {
        "ensemble/argmax": Score(1.6, 1.3e7, 12.0),
        "persistence/seed-0": Score(4.7, 27.0, 9.0),
        "linear/seed-0": Score(1.4, 1.3e7, 12.0),
    }
    assert choose(scores) == ("persistence/seed-0", False)


def test_least_squares_that_are_better_in_a_step_alone_are_no_reason_against_a_model() -> None:
    scores = {
        "ensemble/argmax": Score(0.15, 10.0, 16.0),
        "persistence/seed-0": Score(1.7, 30.0, 0.6),
        "linear/seed-0": Score(0.03, 26.0, 2.8),
    }
    assert choose(scores) == ("ensemble/argmax", True)


def test_the_last_change_and_the_linear_map_of_one_frame_are_references_in_rollouts_too() -> None:
    scores = {
        "ensemble/argmax": Score(0.1, 10.0, 16.0),
        "persistence/seed-0": Score(1.7, 30.0, 0.6),
        "last_change/seed-0": Score(0.05, 9.0, 20.0),
        "linear_frame/seed-0": Score(0.2, 9.5, 18.0),
    }
    assert choose(scores) == ("last_change/seed-0", False)
    scores["ensemble/argmax"] = Score(0.1, 9.1, 16.0)
    assert choose(scores) == ("ensemble/argmax", True)


def test_without_references_the_best_is_recommended() -> None:
    assert choose({"a/seed-0": Score(1.0, 1.0, 1.0), "b/seed-0": Score(2.0, 2.0, 2.0)}) == ("b/seed-0", True)


def course(percent: float, *, noise: float = 0.2, seed: int = 0) -> Course:
    """Return the errors of eight rollouts of four episodes, and horizons as long as all the others'."""
    errors = percent * np.exp(noise * np.random.default_rng(seed).normal(size=8))
    return Course(errors, np.full(8, 50.0), np.repeat(np.arange(4), 2))


SIZES = {"ensemble/argmax": 9000, "same_size/seed-0": 1000, "persistence/seed-0": 0, "linear/seed-0": 12}


def chosen(courses: dict[str, Course], **one_step: float) -> str:
    steps = {"ensemble": 1.0, "same_size": 1.0, "persistence": 1.5, "linear": 1.1} | one_step
    scores = {name: Score(steps[name.partition("/")[0]], each.percent.mean(), 50.0) for name, each in courses.items()}
    best, _ = choose(scores)
    return simplest(best, scores, courses, SIZES)


FAR = {"persistence/seed-0": course(20.0), "linear/seed-0": course(12.0)}


def test_of_those_that_no_episode_tells_apart_the_smallest_is_recommended() -> None:
    alike = {"ensemble/argmax": course(3.0), "same_size/seed-0": course(3.02, seed=1)}
    assert chosen(FAR | alike) == "same_size/seed-0"
    assert chosen(FAR | alike, same_size=1.1) == "ensemble/argmax"


def test_a_smaller_model_that_is_clearly_worse_in_rollouts_is_not_recommended() -> None:
    assert chosen(FAR | {"ensemble/argmax": course(3.0), "same_size/seed-0": course(4.5, seed=1)}) == "ensemble/argmax"
    shorter = Course(course(3.0).percent, np.full(8, 40.0), course(3.0).episode)
    assert shorter.clearly_worse(course(3.0))
    assert not course(3.0).clearly_worse(shorter)


def test_least_squares_are_recommended_where_no_model_is_clearly_better() -> None:
    near = {"persistence/seed-0": course(20.0), "linear/seed-0": course(3.05, seed=1)}
    assert chosen(near | {"ensemble/argmax": course(3.0)}, linear=1.0) == "linear/seed-0"
    assert chosen(near | {"ensemble/argmax": course(3.0)}, linear=1.1) == "ensemble/argmax"


def test_one_episode_tells_no_rollouts_apart() -> None:
    one = [Course(np.full(3, percent), np.full(3, 50.0), np.zeros(3, np.int64)) for percent in (1.0, 9.0)]
    assert not one[1].clearly_worse(one[0])


OWN, LINEAR = Choice("ensemble", 3, "plain", "argmax"), Choice("linear", 0, None, "argmax")


def found(*, better: bool) -> tuple[dict[str, Any], Choice]:
    scores = {
        "ensemble/argmax": Score(2.0, 20.0, 5.0),
        "ensemble/mixture": Score(2.0, 19.0, 5.0),
        "persistence/seed-0": Score(1.0, 9.0, 20.0),
        "linear/seed-0": Score(1.1, 5.0, 30.0),
    }
    record = {"candidate": "linear/seed-0", "beats_references": better}
    return record | {"scores": {name: asdict(each) for name, each in scores.items()}}, LINEAR


@pytest.mark.parametrize(("better", "why"), [(True, "best"), (False, "reference")])
def test_the_best_is_delivered_with_the_reason_and_with_what_it_is_better_than(better: bool, why: str) -> None:
    delivered, name = deliver("best", OWN, found(better=better))
    assert (name, delivered.choice, delivered.ensemble, delivered.why) == ("linear/seed-0", LINEAR, OWN, why)
    assert list(delivered.scores) == ["linear/seed-0", "ensemble/argmax"]
    assert delivered.scores["linear/seed-0"]["horizon_seconds"] == 30.0


def test_the_addressed_ensemble_is_delivered_whatever_it_reaches_if_that_is_asked_for() -> None:
    delivered, name = deliver("addressed", OWN, found(better=False))
    assert (name, delivered.choice, delivered.ensemble, delivered.why) == ("ensemble/argmax", OWN, None, "asked")
    assert delivered.recommended == LINEAR
    assert list(delivered.scores) == ["ensemble/argmax", "linear/seed-0"]


def test_without_validation_episodes_the_addressed_ensemble_is_delivered_and_the_reason_says_so() -> None:
    delivered, name = deliver("best", OWN, None)
    assert (name, delivered.choice, delivered.why, delivered.scores) == ("ensemble/argmax", OWN, "unmeasured", {})
    assert deliver("addressed", OWN, None)[0].why == "asked"
