import math

import numpy as np
import pytest
import torch
from closed_loop_oracle import run_by_loops
from hypothesis import given, settings
from hypothesis import strategies as st
from moving_fakes import a_pose, failing, lively, steady
from pfnn_data import PFNN_DATA, needs_pfnn_data
from released_network import recorded_motion
from torch import Tensor

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.episodes.layout import INPUT, JOINTS, OFFSETS, OUTPUT
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.evaluation.motion.closed_loop.commands import Script, Segment, script, validation_scripts
from addressed_dynamics.evaluation.motion.closed_loop.run import Trace, closed_loop, start_pose
from addressed_dynamics.simulators.motion_loop import FARTHEST
from addressed_dynamics.simulators.motion_predictor import MotionPredictor

POSE = a_pose()
WALK = script([Segment(1.0, stick=1.0)])


def mixed_script(heading: float = 0.0) -> Script:
    """Everything a script can ask for, in 70 frames."""
    segments = [
        Segment(10 / 60),
        Segment(10 / 60, stick=1.0, turn=90.0),
        Segment(10 / 60, stick=0.8, run=0.3, turn=-200.0),
        Segment(15 / 60, stick=0.8, turn=100.0, strafe=0.7),
        Segment(10 / 60, stick=0.4, crouch=0.9),
        Segment(15 / 60),
    ]
    return script(segments, heading=heading)


def run_one(predictor: MotionPredictor, commands: Script) -> Trace:
    return closed_loop({"model": predictor}, [commands], POSE)["model"]


@pytest.mark.parametrize("heading", [0.0, 2.5])
def test_the_controller_does_what_its_description_says_entry_by_entry(heading: float) -> None:
    commands = mixed_script(heading)
    expected = run_by_loops(lively(POSE), commands, POSE)
    trace = run_one(lively(POSE), commands)
    assert trace.joint_position[0] == pytest.approx(expected["joints"], abs=0.02)
    assert trace.root[0].imag == pytest.approx(expected["root"][:, 0], abs=0.01)
    assert trace.root[0].real == pytest.approx(expected["root"][:, 2], abs=0.01)
    assert np.abs(trace.heading[0] - np.exp(1j * expected["heading"])).max() < 1e-3
    assert trace.phase[0] == pytest.approx(expected["phase"], abs=1e-4)
    assert np.ptp(expected["heading"]) > 0.5


def test_walking_straight_at_a_constant_velocity_ends_where_it_should() -> None:
    commands = script([Segment(2.0, stick=1.0)], heading=math.pi / 2)
    trace = run_one(steady(POSE, forward=2.0), commands)
    assert trace.root[0, -1] == pytest.approx(2.0j * 119, abs=1e-6)
    hips = trace.joint_position[0, :, JOINTS.index("Hips")]
    assert hips[-1] == pytest.approx([2.0 * 119, 90.0, 0.0], abs=2.1)


def test_turning_left_at_a_constant_rate_goes_around_a_circle_to_the_left() -> None:
    frames = 180
    commands = script([Segment(frames / 60, stick=1.0)])
    trace = run_one(steady(POSE, forward=2.0, turn=2 * math.pi / frames), commands)
    expected = 2.0 * np.cumsum(np.exp(2j * math.pi * np.arange(frames) / frames))
    assert trace.root[0, 1:] == pytest.approx(expected[:-1], abs=1e-3)
    assert trace.root[0].imag.max() > 50.0


def test_a_standing_character_goes_nowhere_even_if_the_model_says_so() -> None:
    trace = run_one(steady(POSE, forward=2.0), script([Segment(10.0)]))
    assert np.abs(np.diff(trace.root[0]))[-60:].max() < 0.001


def test_the_phase_goes_round_by_what_the_model_says() -> None:
    trace = run_one(steady(POSE, phase=0.03), WALK)
    assert trace.phase[0] == pytest.approx(0.03 * np.arange(60) % 1.0, abs=1e-5)
    backwards = run_one(steady(POSE, phase=-1e-9), WALK)
    assert backwards.phase.max() < 1.0


@given(st.floats(-math.pi, math.pi))
@settings(max_examples=10, deadline=None)
def test_turning_all_commands_turns_the_whole_motion(angle: float) -> None:
    trace, turned = (
        run_one(lively(POSE), commands) for commands in (mixed_script(0.4), mixed_script(0.4).rotated(angle))
    )
    turn = np.exp(1j * angle)
    assert np.abs(turned.root - trace.root * turn).max() < 0.01
    assert np.abs(turned.heading - trace.heading * turn).max() < 0.001
    assert turned.joint_position[..., 1] == pytest.approx(trace.joint_position[..., 1], abs=0.01)


def test_runs_side_by_side_are_as_they_would_be_alone() -> None:
    scripts = validation_scripts(seed=1, number=3, seconds=2.0)
    models = {"first": lively(POSE, 1), "second": lively(POSE, 2)}
    together = closed_loop(models, scripts, POSE)
    for name, model in models.items():
        for index, commands in enumerate(scripts):
            alone = run_one(model, commands)
            assert together[name].root[index] == pytest.approx(alone.root[0], abs=0.01)
            assert together[name].joint_position[index] == pytest.approx(alone.joint_position[0], abs=0.05)
            assert together[name].phase[index] == pytest.approx(alone.phase[0], abs=1e-4)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e30, 1.01 * FARTHEST])
def test_a_run_that_fails_is_dead_and_stays_put_and_disturbs_no_other(value: float) -> None:
    models = {"failing": failing(20, value, lively(POSE)), "well": lively(POSE)}
    traces = closed_loop(models, [WALK], POSE)
    dead, well = traces["failing"], traces["well"]
    assert (dead.lived[0], well.lived[0]) == (20, 60)
    assert dead.joint_position[0, :20] == pytest.approx(well.joint_position[0, :20])
    assert (dead.joint_position[0, 20:] == dead.joint_position[0, 20]).all()
    assert (dead.root[0, 20:] == dead.root[0, 20]).all()
    assert np.isfinite(dead.joint_position).all()
    assert well.joint_position[0] == pytest.approx(run_one(lively(POSE), WALK).joint_position[0], abs=0.01)


def test_a_run_whose_joints_are_carried_off_little_by_little_is_dead() -> None:
    def carried(x: Tensor, phase: Tensor) -> Tensor:
        y = steady(POSE)(x, phase)
        y[:, OUTPUT.joint_velocity] = 600.0
        return y

    trace = run_one(carried, WALK)
    # Half of the way to the prediction, and half of 6 m more with every frame: 3 m, 4.5 m, 5.25 m …, times sqrt(2).
    assert trace.lived[0] == 60
    trace = run_one(lambda x, phase: 1.3 * carried(x, phase), WALK)
    assert 1 < trace.lived[0] < 10
    assert np.abs(trace.joint_position).max() <= FARTHEST


def test_the_trace_as_arrays_is_of_real_numbers_and_one_run_a_script() -> None:
    arrays = closed_loop({"model": lively(POSE)}, [WALK, WALK.rotated(1.0)], POSE)["model"].arrays()
    assert arrays["joint_position"].shape == (2, 60, 31, 3)
    assert arrays["root_position"].shape == arrays["commanded_velocity"].shape == (2, 60, 2)
    assert arrays["commanded_velocity"][0] == pytest.approx(np.tile([0.0, 2.5], (60, 1)))
    assert arrays["root_heading"][1, 0] == pytest.approx(1.0)
    assert not any(np.iscomplexobj(values) for values in arrays.values())


def test_runs_that_cannot_be_made_are_refused() -> None:
    with pytest.raises(EvaluationError, match="found 0"):
        closed_loop({}, [WALK], POSE)
    with pytest.raises(EvaluationError, match="frames: none"):
        closed_loop({"model": lively(POSE)}, [], POSE)
    with pytest.raises(EvaluationError, match="frames: 60, 30"):
        closed_loop({"model": lively(POSE)}, [WALK, script([Segment(0.5)])], POSE)
    with pytest.raises(EvaluationError, match=r"predictor 'narrow' should return outputs of shape \(1, 311\)"):
        closed_loop({"narrow": lambda x, _: x}, [WALK], POSE)
    nothing = Motion(
        *(np.zeros(shape, np.float32) for shape in ((0, 342), (0, 311), (0,))),
        *(np.zeros(0, kind) for kind in ("U1", np.int64, np.int64)),
    )
    with pytest.raises(EvaluationError, match="no frames"):
        start_pose(nothing)


@needs_pfnn_data
def test_a_model_that_replays_a_recording_is_given_the_recorded_inputs() -> None:
    motion = recorded_motion(PFNN_DATA)
    rows = np.flatnonzero(motion.clip == "LocomotionFlat04_000")
    rows = rows[np.append(True, np.diff(motion.frame[rows]) > 0)]
    rows = rows[: 1 + np.flatnonzero(np.append(np.diff(motion.frame[rows]), 2) != 1)[0]][:200]
    given: list[Tensor] = []

    def replay(x: Tensor, _: Tensor) -> Tensor:
        given.append(x)
        return torch.from_numpy(motion.y[rows[len(given) - 1], None])

    closed_loop({"replay": replay}, [script([Segment(len(rows) / 60, stick=1.0)])], start_pose(motion))
    # Until the whole past is replayed, some of it is that of the reset; the future is mixed with commands.
    difference = (torch.cat(given).numpy() - motion.x[rows])[60:]
    past = slice(None, OFFSETS.index(0) + 1)
    for axis in "xz":
        assert np.abs(difference[:, INPUT[f"trajectory_position_{axis}"]][:, past]).max() < 1e-3
        assert np.abs(difference[:, INPUT[f"trajectory_direction_{axis}"]][:, past]).max() < 1e-3
    assert np.abs(difference[:, INPUT.joint_velocity]).max() < 1e-4
    # Joints are half-way between the prediction and where velocities lead: not quite where they were.
    assert np.abs(difference[:, INPUT.joint_position]).mean() < 0.2
