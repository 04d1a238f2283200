"""Drives of characters: commands as the closed loop has them, two models under the same, logs that say what it is."""

import cmath
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from driven import MOTION, motion_model, say, steps, walker

from addressed_dynamics.drive.finding import Named, find
from addressed_dynamics.drive.motion import JOG, TURNS, DrivenMotion
from addressed_dynamics.envs import LEARNED
from addressed_dynamics.episodes.layout import JOINTS
from addressed_dynamics.evaluation.motion.closed_loop.commands import Segment, script
from addressed_dynamics.evaluation.motion.closed_loop.run import closed_loop, start_pose
from addressed_dynamics.features.motion.features import TARGETS, fit_motion_features
from addressed_dynamics.logs import read_log
from addressed_dynamics.simulators.motion_controller import SLOWEST
from addressed_dynamics.simulators.motion_loop import mean_pose
from addressed_dynamics.sources.motion.params import MotionFeatureParams


@pytest.mark.parametrize("target", TARGETS)
def test_a_drive_begins_with_the_mean_pose_which_the_model_knows(target: str) -> None:
    features = fit_motion_features(MOTION, MotionFeatureParams.model_validate({"target": target}))
    expected, found = start_pose(MOTION), mean_pose(features)
    np.testing.assert_allclose(found.position, expected.position, atol=1e-4)
    np.testing.assert_allclose(found.velocity, expected.velocity, atol=1e-4)


def test_a_drive_is_the_closed_loop_of_both_models(tmp_path: Path) -> None:
    session = walker(tmp_path)
    session.reset()
    say(session, "command", ahead=1.0)
    frames = steps(session, 30)
    traces = closed_loop(session._predictors, [script([Segment(0.5, stick=1.0)])], session._start)
    for index, trace in enumerate(traces.values()):
        joints = [each["bodies"][index]["joints"] for each in frames]
        np.testing.assert_allclose(np.reshape(joints, (30, 31, 3)), trace.joint_position[0], atol=0.06)
        assert all(each["bodies"][index]["alive"] for each in frames)
    assert not np.allclose(*(each["joints"] for each in frames[-1]["bodies"]))
    assert frames[0]["command"] == [0, SLOWEST]
    assert all(sum(each["weights"]) == pytest.approx(1, abs=0.01) for each in frames)


def test_turning_jogging_strafing_and_crouching_are_commands(tmp_path: Path) -> None:
    session = walker(tmp_path, beside=False)
    session.reset()
    say(session, "command", ahead=1.0, turn=1.0)
    steps(session, 60)
    left = cmath.exp(1j * math.radians(TURNS))
    assert session._facing == pytest.approx(left)
    # Left is towards +x.
    assert left.imag > 0
    say(session, "command", right=1.0, strafe=1.0, run=1.0, crouch=0.5)
    commands = session._commands()
    assert complex(commands.velocity[0]) == pytest.approx(SLOWEST * (1 + JOG) * left * -1j)
    assert (commands.jogging[0], commands.strafe[0], commands.crouch[0]) == (True, 1.0, 0.5)
    say(session, "command", right=1.0, ahead=1.0)
    assert abs(session._commands().velocity[0]) == pytest.approx(SLOWEST)


def test_a_character_that_loses_itself_stays_where_it_was_until_a_reset(tmp_path: Path) -> None:
    session = walker(tmp_path)
    session.reset()
    steps(session, 3)
    session._driven.model.networks.biases[-1].fill_(torch.nan)
    first, second = steps(session, 2)
    alive = [[body["alive"] for body in each["bodies"]] for each in (first, second)]
    assert alive == [[False, True]] * 2
    assert first["bodies"][0]["joints"] == second["bodies"][0]["joints"]
    assert second["weights"] is None
    assert [body["alive"] for body in session.reset()["bodies"]] == [True, True]


def test_what_is_no_command_is_refused(tmp_path: Path) -> None:
    session = walker(tmp_path)
    for kind, values, words in (
        ("act", {"action": 1}, "a character knows no 'act'"),
        ("sync", {}, "a character knows no 'sync'"),
        ("command", {"ahead": 1.5}, "ahead: Input should be less than or equal to 1"),
    ):
        (said,) = say(session, kind, **values)
        assert (said["type"], words in said["message"]) == ("refused", True)


def test_what_a_model_makes_of_commands_is_recorded_as_predictions(tmp_path: Path) -> None:
    session = walker(tmp_path)
    session.reset()
    say(session, "command", ahead=1.0)
    say(session, "record")
    frames = steps(session, 5)
    (answer,) = say(session, "stop")
    contents = read_log(Path(answer["path"]))
    found = contents.transitions
    assert contents.run.environment == LEARNED
    assert found.spec.observation_names[4:7] == ("Hips_x", "Hips_y", "Hips_z")
    assert len(found.spec.observation) == 4 + 3 * len(JOINTS)
    joints = [each["bodies"][0]["joints"] for each in frames]
    np.testing.assert_allclose(found.next_observation[:, 4:], joints, atol=0.06)
    np.testing.assert_array_equal(found.observation[1:], found.next_observation[:-1])
    np.testing.assert_allclose(found.action, np.tile([0, SLOWEST, 0, 1, 0, 0, 0], (5, 1)), atol=1e-6)


def test_models_of_motion_are_found_with_a_pfnn_beside_them(tmp_path: Path) -> None:
    folder = tmp_path / "pfnn"
    motion_model().save(folder, {})
    named = find(str(folder))
    assert named == Named(folder, "pfnn", "motion")
    driven = DrivenMotion.load(named)
    assert (driven.beside, driven.names) == (None, ("model",))
    hello = driven.session(0, tmp_path).hello()
    assert (hello["members"], hello["bodies"], hello["rate"]) == (3, ["model"], 60)
