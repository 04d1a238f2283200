import dataclasses
import json

import numpy as np
import pytest
from moving_fakes import a_pose, failing, follower, reference_of, steady
from pfnn_data import PFNN_DATA, needs_pfnn_data
from released_network import recorded_motion, released_network

from addressed_dynamics.evaluation.motion.closed_loop.commands import Script, Segment, script, standard_script
from addressed_dynamics.evaluation.motion.closed_loop.judging import courses, judge
from addressed_dynamics.evaluation.motion.closed_loop.measures import FEET, data_reference
from addressed_dynamics.evaluation.motion.closed_loop.run import Trace, closed_loop, start_pose
from addressed_dynamics.evaluation.motion.closed_loop.score import closed_loop_score

POSE = a_pose()
REFERENCE = reference_of(POSE)
TURNING = script([Segment(2.5, stick=1.0), Segment(2.5, stick=0.8, run=0.0, turn=60.0)], heading=1.0)


def moving_trace(commands: Script, *, limb_speed: float = 0.0, planted: bool = False) -> Trace:
    """A pose that goes as commanded; its arms go up and down, at 60 frames/s; one toe can stay where it is."""
    root = np.append(0.0, np.cumsum(commands.velocity))[:-1]
    joints = np.zeros((len(commands), 31, 3))
    turned = commands.facing[:, None] * (POSE.position[:, 2] + 1j * POSE.position[:, 0]) + root[:, None]
    joints[..., 0], joints[..., 1], joints[..., 2] = turned.imag, POSE.position[:, 1], turned.real
    # Ten of 31 joints move, each 3.1 times as fast as the mean.
    joints[:, 21:, 1] += (np.arange(len(commands)) % 2)[:, None] * 3.1 * limb_speed / 60
    if planted:
        joints[:, FEET[1]] = [5.0, 1.0, 5.0]
    contact = np.zeros((1, len(commands), 4), np.float32)
    contact[..., 1] = 1.0
    zeros = np.zeros((1, len(commands)), np.float32)
    return Trace(
        (commands,),
        joints[None].astype(np.float32),
        root[None],
        commands.facing[None],
        contact,
        zeros,
        np.array([len(commands)]),
    )


def test_a_model_that_goes_exactly_as_commanded_follows_perfectly() -> None:
    trace = closed_loop({"model": follower(TURNING, POSE)}, [TURNING], POSE)["model"]
    walk, jog = (judge(trace, REFERENCE)[0].of(kind) for kind in ("walk", "jog_turn"))
    assert (walk.speed, walk.commanded_speed) == pytest.approx((150.0, 150.0), abs=1e-3)
    assert walk.speed_ratio == pytest.approx(1.0, abs=1e-5)
    # Velocities are averaged over half a second, in which a turn bends the path: a chord is shorter than its arc.
    assert jog.speed_ratio == pytest.approx(np.sin(np.pi / 12) / (np.pi / 12), abs=1e-3)
    assert max(walk.facing_error or 0.0, walk.velocity_error or 0.0) < 0.01
    assert jog.facing_error == pytest.approx(0.0, abs=0.01)
    assert jog.course_error == pytest.approx(0.0, abs=1.0)


def test_a_pose_that_slides_along_is_frozen_and_skates_and_scores_nothing() -> None:
    commands = script([Segment(4.0, stick=1.0)])
    (judgement,) = judge(moving_trace(commands), REFERENCE)
    walk = judgement.of("walk")
    assert walk.frozen_share == 1.0
    assert walk.limb_speed == pytest.approx(0.0, abs=0.01)
    assert (walk.skate_speed, walk.slowest_foot_speed) == pytest.approx((150.0, 150.0), abs=0.1)
    assert not judgement.alive
    assert closed_loop_score([judgement]) == 0.0


def test_moving_limbs_and_a_standing_foot_score_everything_but_the_bone_of_the_foot() -> None:
    commands = script([Segment(4.0, stick=1.0)])
    (judgement,) = judge(moving_trace(commands, limb_speed=60.0, planted=True), REFERENCE)
    walk = judgement.of("walk")
    # The toe that stays behind moves relative to the root, too: 150 / 31 cm/s on average.
    assert walk.limb_speed == pytest.approx(60.0 + 150.0 / 31, rel=0.01)
    assert (walk.skate_speed, walk.slowest_foot_speed) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert walk.contact_share == 0.25
    assert judgement.alive
    assert closed_loop_score([judgement]) == pytest.approx(0.75, abs=0.01)


@pytest.mark.parametrize(("limb_speed", "expected"), [(0.0, 0.0), (30.0, 0.75), (120.0, 0.75), (300.0, 0.0)])
def test_freezing_and_shaking_are_punished(limb_speed: float, expected: float) -> None:
    # Three quarters for following, facing and shape; none for grip, as both feet slide along.
    (judgement,) = judge(moving_trace(script([Segment(4.0, stick=1.0)]), limb_speed=limb_speed), REFERENCE)
    drift = judgement.of("walk").bone_drift or 0.0
    assert closed_loop_score([judgement]) == pytest.approx(expected * (1 - drift / 0.75), abs=0.05)


def test_standing_still_is_right_when_told_to_stand_and_worth_nothing_when_told_to_walk() -> None:
    stand, walk = (script([Segment(4.0, stick=stick)]) for stick in (0.0, 1.0))
    traces = [closed_loop({"still": steady(POSE)}, [each], POSE)["still"] for each in (stand, walk)]
    standing, walking = (judge(trace, REFERENCE)[0] for trace in traces)
    assert closed_loop_score([standing]) == pytest.approx(1.0)
    assert standing.alive
    assert standing.of("stand").speed_ratio is None
    assert closed_loop_score([walking]) == 0.0
    assert not walking.alive
    assert walking.of("walk").speed_ratio == 0.0
    assert walking.of("walk").course_error == 90.0
    assert closed_loop_score([standing, walking]) == pytest.approx(0.5)


def test_what_comes_after_death_counts_as_lost() -> None:
    stand = script([Segment(4.0)])
    trace = closed_loop({"model": failing(120, np.nan, steady(POSE))}, [stand], POSE)["model"]
    (judgement,) = judge(trace, REFERENCE)
    assert (judgement.lived_seconds, judgement.seconds, judgement.alive) == (2.0, 4.0, False)
    assert (judgement.of("stand").frames, judgement.of("stand").lost) == (59, 106)
    assert closed_loop_score([judgement]) == pytest.approx(59 / 165)


def test_a_run_that_dies_before_anything_counts_can_still_be_judged() -> None:
    trace = closed_loop({"model": failing(0, np.nan, steady(POSE))}, [TURNING], POSE)["model"]
    (judgement,) = judge(trace, REFERENCE)
    assert judgement.largest_bone_drift is None
    assert judgement.of("walk").speed is None
    assert closed_loop_score([judgement]) == 0.0
    assert json.loads(json.dumps(dataclasses.asdict(judgement), allow_nan=False))["lived_seconds"] == 0.0


def test_a_body_that_grows_shows_as_drift_of_its_bones_and_hips_at_a_wrong_height() -> None:
    trace = moving_trace(script([Segment(4.0)]))
    grown = dataclasses.replace(trace, joint_position=trace.joint_position * np.float32(1.2))
    (judgement,) = judge(grown, REFERENCE)
    stand = judgement.of("stand")
    assert stand.bone_drift == pytest.approx(0.2, abs=1e-4)
    assert judgement.largest_bone_drift == pytest.approx(0.2, abs=1e-3)
    assert stand.plausible_height_share == 0.0
    assert not judgement.alive


def test_the_course_of_a_run_has_an_entry_for_every_frame_but_the_last() -> None:
    (course,) = courses(moving_trace(TURNING), REFERENCE)
    assert {values.shape for values in course.arrays().values()} == {(len(TURNING) - 1,)}


@needs_pfnn_data
def test_recorded_motion_moves_its_limbs_and_does_not_skate() -> None:
    reference = data_reference(recorded_motion(PFNN_DATA))
    everything, *gaits = reference.gaits
    assert everything.frames == 2899
    jog = next(gait for gait in gaits if gait.gait == "jog")
    assert jog.limb_speed == pytest.approx(74.0, abs=1.0)
    assert jog.root_speed == pytest.approx(127.0, abs=1.0)
    assert 3.0 < (jog.skate_speed or 0.0) < 4.0
    assert len(reference.bone_length) == 31
    assert 70.0 < reference.lowest_hips < reference.highest_hips < 120.0


@needs_pfnn_data
@pytest.mark.slow
def test_the_released_network_walks_jogs_and_turns_as_told_for_a_minute() -> None:
    motion = recorded_motion(PFNN_DATA)
    trace = closed_loop({"released": released_network(PFNN_DATA)}, [standard_script()], start_pose(motion))["released"]
    (judgement,) = judge(trace, data_reference(motion))
    walk, jog, turn, stand = (judgement.of(kind) for kind in ("walk", "jog", "walk_turn", "stand"))
    assert judgement.alive
    assert (walk.limb_speed or 0.0) > 35.0
    assert (jog.limb_speed or 0.0) > 55.0
    assert (stand.limb_speed or 0.0) < 10.0
    assert 0.7 < (walk.speed_ratio or 0.0) < 1.0
    assert (walk.facing_error or 90.0) < 5.0
    assert (turn.facing_error or 90.0) < 30.0
    assert (walk.skate_speed or 90.0) < 20.0
    assert (walk.bone_drift or 1.0) < 0.05
    assert closed_loop_score([judgement]) == pytest.approx(0.87, abs=0.03)
