"""Drives without a browser: what a page says, and what it is shown."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from driven import CAR_ENVIRONMENT, driven, say, session_of, steps
from learned_worlds import learned
from learning import untrained_model
from strategies import random_transitions
from trusted_models import SPACES, drifting, trusted_model

from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.drive.finding import Named, environment_of
from addressed_dynamics.drive.imagined import Calibrated
from addressed_dynamics.drive.transitions import DrivenWorld, neutral_action
from addressed_dynamics.envs import ACROBOT, CONTINUING_MOUNTAIN_CAR
from addressed_dynamics.episodes.transitions import DiscreteAction, SpaceSpec
from addressed_dynamics.evaluation.transitions.starting import starts_of
from addressed_dynamics.recording.spaces import space_spec
from addressed_dynamics.simulators.worlds import World

ACTIONS = [2, 2, 0, 1, 2, 0, 0]


@pytest.mark.parametrize("history", [1, 3])
def test_truth_and_model_start_in_one_state_and_take_the_same_actions(tmp_path: Path, history: int) -> None:
    session = session_of(driven("car", history, CAR_ENVIRONMENT), tmp_path)
    first = session.reset()
    env = gymnasium.make(CONTINUING_MOUNTAIN_CAR)
    before = [env.reset(seed=4)[0], *(env.step(1)[0] for _ in range(history - 1))]
    assert (first["step"], first["model"], first["truth"]) == (history - 1, first["truth"], first["model"])
    np.testing.assert_allclose(first["truth"], before[-1], rtol=1e-6)
    frames = []
    for action in ACTIONS:
        assert say(session, "act", action=action) == []
        frames += steps(session, 1)
    true = [env.step(action)[0] for action in ACTIONS]
    np.testing.assert_allclose([each["truth"] for each in frames], true, rtol=1e-6)
    taken = np.array([1] * (history - 1) + ACTIONS)
    expected = learned("car", history).model.rollout(np.array(before) if history > 1 else before[0], taken)
    np.testing.assert_allclose([each["model"] for each in frames], expected, rtol=2e-6, atol=1e-9)
    assert [each["step"] for each in frames] == list(range(history, history + len(ACTIONS)))
    assert [each["action"] for each in frames] == ACTIONS
    assert {each["network"] for each in frames} <= {0, 1, 2}
    assert all(sum(each["weights"]) == pytest.approx(1, abs=0.01) for each in frames)


def test_the_same_page_starts_elsewhere_each_time_and_another_page_elsewhere_again(tmp_path: Path) -> None:
    world = driven("car", environment=CAR_ENVIRONMENT)
    starts = [session.reset()["truth"] for session in map(world.session, (0, 1), [tmp_path] * 2) for _ in range(2)]
    assert starts[0] != starts[1]
    assert starts[1] == starts[2]  # seeds count up: page 1 begins where page 0 went on
    assert world.session(0, tmp_path).reset()["truth"] == starts[0]


def test_the_model_takes_the_true_state_when_it_is_told_to(tmp_path: Path) -> None:
    session = session_of(driven("car", 3, CAR_ENVIRONMENT), tmp_path)
    last = steps(session, 5)[-1]
    assert last["model"] != last["truth"]
    (frame,) = say(session, "sync")
    assert frame["model"] == frame["truth"] == last["truth"]
    assert frame["step"] == last["step"]


def test_a_model_alone_starts_where_an_episode_was_recorded(tmp_path: Path) -> None:
    session = session_of(driven("arm"), tmp_path)
    hello, frame = session.hello(), session.reset()
    assert hello["environment"] is None
    assert frame["truth"] is None
    starts = learned("arm").starts
    at = starts.observation[starts.beginning, -1]
    assert np.isclose(at, frame["model"], rtol=1e-6).all(axis=1).any()
    assert say(session, "act", action=[1.5, 0.25]) == []
    (after,) = steps(session, 1)
    expected = learned("arm").model.predict(np.float32(frame["model"]), np.float32([1.5, 0.25]))
    np.testing.assert_allclose(after["model"], np.clip(expected, [-np.inf, -8], [np.inf, 8]), rtol=1e-5)
    assert after["action"] == [1.5, 0.25]


def test_what_a_page_has_to_know_comes_first(tmp_path: Path) -> None:
    hello = session_of(driven("car", environment=CAR_ENVIRONMENT), tmp_path).hello()
    recorded = learned("car").starts.observation[:, -1, 0]
    assert hello["observation"][0]["unit"] == "m"
    assert (hello["observation"][0]["low"], hello["observation"][0]["high"]) == (recorded.min(), recorded.max())
    assert hello["action"] == {"kind": "discrete", "names": ["push_left", "no_push", "push_right"], "neutral": 1}
    assert (hello["environment"], hello["members"], hello["calibrated"]) == (CONTINUING_MOUNTAIN_CAR, 3, False)
    assert hello["rate"] == pytest.approx(30)
    arm = session_of(driven("arm"), tmp_path).hello()
    recorded = learned("arm").starts.observation[:, -1, 0]
    assert (arm["observation"][0]["low"], arm["observation"][0]["high"]) == (recorded.min(), recorded.max())
    assert arm["action"]["neutral"] == [0, 0]
    assert json.loads(json.dumps(arm, allow_nan=False)) == arm


@pytest.mark.parametrize(
    ("world", "message", "answer"),
    [
        ("car", {"type": "act", "action": 3}, r"the action 3 is not taken: actions should lie in 0\.\.2 \(push_left"),
        ("car", {"type": "act", "action": 10**30}, "the action 10000"),
        ("car", {"type": "act", "action": [1.0]}, "is not taken: actions should be 1 integers"),
        ("car", {"type": "act", "action": 1.0}, "no message that a drive takes"),
        ("arm", {"type": "act", "action": [5.0, 0.0]}, r"'torque' should lie in -2\.\.2 N m, but one is 5"),
        ("arm", {"type": "act", "action": [1.0]}, "actions should have shape"),
        ("arm", {"type": "act", "action": 1}, "actions should have shape"),
        ("boat", {"type": "exogenous", "values": [3.0]}, r"'wind' should lie in -2\.\.2 m/s, but one is 3"),
        ("boat", {"type": "exogenous", "values": []}, "there are 1 exogenous inputs, but 0 were given"),
        ("arm", {"type": "sync"}, "there is no truth beside this model"),
        ("car", {"type": "command", "ahead": 1.0}, "knows no 'command'"),
        ("car", {"type": "speed", "rate": 0.0}, "speed.rate: Input should be greater than 0"),
        ("car", {"type": "speed", "rate": "fast"}, "speed.rate: Input should be a valid number"),
        ("car", {"type": "fly"}, "Input tag 'fly'"),
        ("car", {"type": "act", "action": 1, "force": 2}, "force: Extra inputs"),
        ("car", {}, "Unable to extract tag"),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_line_and_the_drive_goes_on(
    tmp_path: Path, world: str, message: dict[str, Any], answer: str
) -> None:
    session = session_of(driven(world), tmp_path)
    before = steps(session, 1)[0]
    (said,) = session.hear(json.dumps(message))
    assert said["type"] == "refused"
    assert "\n" not in said["message"]
    with pytest.raises(AssertionError, match=answer):
        raise AssertionError(said["message"])
    (after,) = steps(session, 1)
    assert (after["step"], after["action"]) == (2, before["action"])


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '{"type": "act", "action": NaN}', "\x00", '"reset"'])
def test_what_is_no_message_is_refused(tmp_path: Path, text: str) -> None:
    (said,) = session_of(driven("car"), tmp_path).hear(text)
    assert said["type"] == "refused"
    assert "\n" not in said["message"]


def test_speed_is_that_of_the_world_and_at_most_sixty_steps_a_second(tmp_path: Path) -> None:
    session = session_of(driven("boat"), tmp_path)
    assert session.rate == 10
    assert say(session, "speed", rate=1000.0) == [{"type": "status", "paused": False, "rate": 60.0}]
    assert say(session, "speed", rate=2.5)[0]["rate"] == session.rate == 2.5


def test_a_pause_a_step_and_going_on(tmp_path: Path) -> None:
    session = session_of(driven("car"), tmp_path)
    assert say(session, "pause") == [{"type": "status", "paused": True, "rate": session.rate}]
    status, frame = say(session, "step")
    assert (status["paused"], frame["step"]) == (True, 1)
    assert say(session, "resume")[0]["paused"] is session.paused is False


def test_exogenous_inputs_are_those_recorded_until_someone_takes_them(tmp_path: Path) -> None:
    made = learned("boat")
    session = session_of(driven("boat"), tmp_path)
    wind, state = session.reset()["exogenous"], session.reset()["model"]
    assert len(wind) == 1
    first = session.reset()
    (after,) = steps(session, 1)
    expected = made.model.predict(np.float32(first["model"]), np.zeros(1, np.float32), exogenous=first["exogenous"])
    np.testing.assert_allclose(after["model"], expected, rtol=1e-5)
    assert state != first["model"]
    say(session, "exogenous", values=[-1.5])
    (given,) = steps(session, 1)
    expected = made.model.predict(np.float32(after["model"]), np.zeros(1, np.float32), exogenous=[-1.5])
    np.testing.assert_allclose(given["model"], expected, rtol=1e-4)
    assert given["exogenous"] == [-1.5]


def test_an_episode_ends_with_what_was_recorded_beside_it_and_goes_on_with_the_sliders(tmp_path: Path) -> None:
    session = session_of(driven("boat"), tmp_path)
    frames = steps(session, 40)
    assert frames[-1]["ended"] == "exogenous"
    last = max(each["step"] for each in frames)
    assert last in learned("boat").train.step + 1
    assert say(session, "exogenous", values=[0.0]) == []
    assert steps(session, 1)[0]["step"] > last
    assert session.reset()["ended"] == ""


def test_an_environment_that_ends_an_episode_waits_for_a_reset(tmp_path: Path) -> None:
    cart = EnvironmentParams(id="CartPole-v1")
    spaces = space_spec(gymnasium.make("CartPole-v1"))
    made = random_transitions(spaces, [20, 20], np.random.default_rng(0))
    small = {name: np.clip(getattr(made, name), -1, 1) for name in ("observation", "next_observation")}
    model = untrained_model(replace(made, **small), members=1)
    session = session_of(DrivenWorld("cart", Path("cart"), World.of(model), None, cart), tmp_path)
    say(session, "act", action=1)
    frames = steps(session, 30)
    assert frames[-1]["ended"] == "terminated"
    over = next(each["step"] for each in frames if each["ended"])
    assert over < 15
    assert {each["step"] for each in frames[over:]} == {over}
    assert session.reset()["ended"] == ""
    assert steps(session, 1)[0]["step"] == 1


def test_a_model_that_predicts_no_number_stays_and_says_so(tmp_path: Path) -> None:
    model = untrained_model(learned("car").train, members=1)
    model.ensemble.biases[-1].fill_(np.nan)
    session = session_of(DrivenWorld("car", Path("car"), World.of(model), None, CAR_ENVIRONMENT), tmp_path)
    first = session.reset()
    (frame,) = steps(session, 1)
    assert (frame["ended"], frame["model"]) == ("not_finite", first["model"])
    assert json.dumps(frame, allow_nan=False)
    (again,) = say(session, "sync")
    assert (again["ended"], again["model"]) == ("", frame["truth"])


def test_trust_and_intervals_are_those_of_a_rollout(tmp_path: Path) -> None:
    model, _, trust = trusted_model()
    starts = starts_of(drifting(3, 0), 1)
    world = DrivenWorld("drift", Path("drift"), World.of(model, starts=starts), Calibrated(trust), None)
    session = session_of(world, tmp_path)
    assert session.hello()["coverage"] == 0.9
    first = session.reset()
    actions = np.linspace(-1, 1, 40, dtype=np.float32)[:, None]
    frames = []
    for action in actions:
        say(session, "act", action=[float(action[0])])
        frames += steps(session, 1)
    expected = model.rollout(np.float32(first["model"]), actions, with_trust=True)
    np.testing.assert_allclose([each["model"] for each in frames], expected.states, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose([each["trust"] for each in frames], expected.trust, atol=2e-3)
    known = [each["interval"] for each in frames[:30]]
    np.testing.assert_allclose(known, np.stack([expected.low, expected.high], axis=1)[:30], rtol=1e-3, atol=1e-4)
    assert trust.steps[-1] == 30
    assert {str(each["interval"]) for each in frames[30:]} == {"None"}


@pytest.mark.parametrize(
    ("spaces", "found"),
    [
        (learned("car").model.features.spaces, CONTINUING_MOUNTAIN_CAR),
        (space_spec(gymnasium.make(ACROBOT, time_step=0.05)), ACROBOT),
        (space_spec(gymnasium.make("CartPole-v1")), "CartPole-v1"),
        (learned("arm").model.features.spaces, None),
        (learned("boat").model.features.spaces, None),
    ],
)
def test_an_environment_is_known_by_its_names_and_its_step(spaces: SpaceSpec, found: str | None) -> None:
    environment = environment_of(Named(Path("somewhere"), "?", "transitions"), spaces, None)
    assert (environment.id if environment else None) == found
    if environment is not None and environment.id == ACROBOT:
        assert environment.kwargs["time_step"] == 0.05


def test_while_nobody_acts_the_action_is_the_one_that_does_nothing() -> None:
    def of(*names: str) -> int:
        spaces = SpaceSpec(SPACES.observation, DiscreteAction(names), 0.1)
        return int(neutral_action(spaces, np.empty(0), np.empty(0)))

    assert of("left", "no_push", "right") == 1
    assert of("noop", "left", "main", "right") == 0
    assert of("a", "b", "c") == 1
    assert of("left", "right") == 0
    low, high = np.float32([-1, 0.5, -3]), np.float32([1, 2, -1])
    np.testing.assert_array_equal(neutral_action(SPACES, low, high), np.float32([0, 0.5, -1]))
