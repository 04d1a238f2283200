"""Rollouts of Acrobot by angles and energy, beside what the true equations of motion make of them."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from acrobot_recordings import acrobot_recording
from learning import drive

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.envs import acrobot_energy, acrobot_observation, acrobot_state, acrobot_step
from addressed_dynamics.episodes.transitions import SpaceSpec, Transitions
from addressed_dynamics.evaluation.transitions.physics import ROUNDING, TRUTH, TWIN, acrobot_course
from addressed_dynamics.evaluation.transitions.rollouts import evaluate_rollouts, evaluate_simulations, free_run
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts, replay_recorded
from addressed_dynamics.sources.transitions.params import RecordedRollouts

PARAMS = RecordedRollouts(kind="recorded", episodes=20, steps=900, seed=0, physics="acrobot")
SCALE = np.array([2.0, 2.0, 2.0, 2.0, 8 * np.pi, 18 * np.pi])


@dataclass
class Features:
    spaces: SpaceSpec


@dataclass
class Simulator:
    """A model that is the true simulator, with the angle of its first link off by `error` rad at the start."""

    features: Features
    error: float = 0.0

    def rollout(self, observation: np.ndarray, actions: np.ndarray, _mode: str, **_: object) -> np.ndarray:
        history = observation.shape[1]
        state = acrobot_state(observation[:, -1]) + np.array([self.error, 0.0, 0.0, 0.0])
        states = []
        for step in range(history - 1, actions.shape[1]):
            state = acrobot_step(state, actions[:, step], 0.02)
            states.append(acrobot_observation(state))
        return np.stack(states, axis=1).astype(np.float32)


@lru_cache
def recording() -> Transitions:
    return acrobot_recording([910, 910, 905, 910], torque=(True, False))


@lru_cache
def truth() -> TrueRollouts:
    episodes = recording().episode.tolist()
    segments = {episode: ("torque", "swing")[index % 2] for index, episode in enumerate(dict.fromkeys(episodes))}
    return replay_recorded(PARAMS, recording(), 6, segments)


@lru_cache
def simulated() -> tuple[dict[str, Any], list[dict[str, Any]]]:
    record, rows = evaluate_simulations(PARAMS, truth(), recording().spec, SCALE)
    assert record is not None
    return record["simulations"], rows


def judged(model: Any) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    predicted = free_run(model, truth(), "argmax")
    return evaluate_rollouts("ensemble/argmax", predicted, truth(), recording().spec, SCALE, physics=True)


def exact(error: float = 0.0) -> Simulator:
    return Simulator(Features(recording().spec), error)


def test_the_true_simulator_as_a_model_is_as_good_as_single_precision_allows() -> None:
    summary, rows = judged(exact())
    floor, floor_rows = simulated()
    assert list(summary["groups"]) == ["all", "torque", "swing"]
    for group, result in summary["groups"].items():
        assert result["physics"]["lost_seconds"] == floor[ROUNDING]["groups"][group]["physics"]["lost_seconds"]
        assert result["physics"]["energy_error"]["max"] < 1e-3
    ours = {(row["group"], row["horizon"]): row["angle_error_p50"] for row in rows}
    theirs = {(r["group"], r["horizon"]): r["angle_error_p50"] for r in floor_rows if r["model"] == ROUNDING}
    assert ours.keys() == theirs.keys()
    np.testing.assert_allclose(list(ours.values()), list(theirs.values()), rtol=0.5, atol=1e-6)


def test_a_model_that_is_off_by_more_at_the_start_loses_the_truth_no_later() -> None:
    never = [
        judged(exact(error))[0]["groups"]["all"]["physics"]["lost_seconds"]["never_share"]
        for error in (0.0, 1e-3, 0.1, 0.6)
    ]
    assert never == sorted(never, reverse=True)
    assert never[-1] == 0.0


def test_two_simulations_start_as_far_apart_as_asked_for_and_part_faster_than_rounding() -> None:
    _, rows = simulated()
    first = {row["model"]: row for row in rows if row["group"] == "all" and row["horizon"] == 10}
    assert 1e-7 < first[TWIN]["angle_1_error_p50"] < 1e-5
    assert first[ROUNDING]["angle_error_p50"] < first[TWIN]["angle_error_p50"]


def test_the_recording_has_no_error_and_keeps_its_energy_where_there_is_no_torque() -> None:
    groups = simulated()[0][TRUTH]["groups"]
    for result in groups.values():
        assert result["physics"]["energy_error"]["max"] == 0.0
        assert result["physics"]["lost_seconds"] == {"p10": None, "median": None, "p90": None, "never_share": 1.0}
    assert groups["swing"]["physics"]["energy_drift"]["max"] < 1e-2
    assert groups["torque"]["physics"]["energy_drift"]["median"] > 0.1


def test_angles_are_compared_on_the_shorter_way_round_and_energy_in_joules() -> None:
    generator = np.random.default_rng(0)
    states, found = generator.uniform(-3, 3, (4, 31, 4)), generator.uniform(-3, 3, (4, 30, 4))
    course = acrobot_course(acrobot_observation(found), acrobot_observation(states))
    energy = acrobot_energy(states)
    for episode in range(4):
        for step in range(30):
            for angle in range(2):
                apart = found[episode, step, angle] - states[episode, step + 1, angle]
                expected = min(abs(apart + turn * 2 * np.pi) for turn in (-1, 0, 1))
                assert course.angle_error[episode, step, angle] == pytest.approx(expected)
            now = acrobot_energy(found[episode, step])
            assert course.energy_error[episode, step] == pytest.approx(abs(now - energy[episode, step + 1]))
            assert course.energy_drift[episode, step] == pytest.approx(abs(now - energy[episode, 0]))
    np.testing.assert_array_equal(course.values["angle_error"], course.angle_error.max(axis=-1))


@pytest.mark.parametrize(
    ("lost_after", "expected"),
    [
        ([10] * 20, {"p10": 1.0, "median": 1.0, "p90": 1.0, "never_share": 0.0}),
        (list(range(10, 30)), {"p10": 1.1, "median": 1.9, "p90": 2.7, "never_share": 0.0}),
        ([10] * 6 + [20] * 6 + [None] * 8, {"p10": 1.0, "median": 2.0, "p90": None, "never_share": 0.4}),
        ([30] * 2 + [None] * 18, {"p10": 3.0, "median": None, "p90": None, "never_share": 0.9}),
        ([None] * 20, {"p10": None, "median": None, "p90": None, "never_share": 1.0}),
        # One too few for percentiles.
        ([10] * 19, {"p10": None, "median": 1.0, "p90": None, "never_share": 0.0}),
    ],
)
def test_a_time_beyond_the_end_is_not_made_up(lost_after: list[int | None], expected: dict[str, float]) -> None:
    number = len(lost_after)
    states = np.zeros((number, 41, 4))
    found = np.zeros((number, 40, 4))
    for episode, step in enumerate(lost_after):
        if step is not None:
            found[episode, step - 1, episode % 2] = 0.51
            found[episode, :, 1 - episode % 2] = -0.49
    course = acrobot_course(acrobot_observation(found), acrobot_observation(states))
    summary = course.summary(np.ones(number, dtype=bool), 0.1)
    assert summary is not None
    assert summary["lost_seconds"] == pytest.approx(expected)
    assert course.summary(np.zeros(number, dtype=bool), 0.1) is None


def test_a_model_that_diverges_is_lost_and_its_numbers_are_finite() -> None:
    class Diverging(Simulator):
        def rollout(self, *args: Any, **kwargs: Any) -> np.ndarray:
            states = super().rollout(*args, **kwargs)
            states[:, 5:] = np.nan
            return states

    summary, rows = judged(Diverging(Features(recording().spec)))
    result = summary["groups"]["all"]["physics"]
    assert result["lost_seconds"]["never_share"] < 1.0
    spreads = [result["energy_error"], result["energy_drift"]]
    assert all(np.isfinite(value) for spread in spreads for value in spread.values() if value is not None)
    assert all(np.isfinite(value) for row in rows for value in row.values() if isinstance(value, float))


def test_without_physics_nothing_is_simulated() -> None:
    world = drive((40, 30))
    plain = RecordedRollouts(kind="recorded", episodes=2, steps=10, seed=0)
    rollouts = replay_recorded(plain, world, 1, dict.fromkeys(world.episode.tolist(), "driving"))
    assert evaluate_simulations(plain, rollouts, world.spec, np.ones(2)) == (None, [])


def refusal(world: Transitions) -> str:
    segments = dict.fromkeys(world.episode.tolist(), "somewhere")
    params = PARAMS.model_copy(update={"steps": 20})
    with pytest.raises(EvaluationError) as caught:
        evaluate_simulations(
            params, replay_recorded(params, world, 1, segments), world.spec, np.ones(len(world.spec.observation))
        )
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_physics_of_something_else_than_acrobot_is_refused() -> None:
    assert "but the recording has position, velocity; leave 'physics' out" in refusal(drive((40, 30)))


def test_an_acrobot_with_torque_noise_is_refused() -> None:
    message = refusal(acrobot_recording([30, 30], noise=0.5))
    assert "a recorded step departs from the simulated one by" in message
    assert "torque noise" in message
