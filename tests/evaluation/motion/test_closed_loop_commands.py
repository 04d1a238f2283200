import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.evaluation.motion.closed_loop.commands import (
    KINDS,
    Script,
    Segment,
    random_script,
    script,
    standard_script,
    validation_scripts,
)


def same(first: Script, second: Script) -> bool:
    return first.segments == second.segments and np.array_equal(first.stick, second.stick)


def test_the_script_models_are_judged_by_lasts_a_minute_and_asks_for_everything() -> None:
    commands = standard_script()
    assert len(commands) == 3600
    assert {segment.kind for segment in commands.segments} == set(KINDS)
    assert {np.sign(segment.turn) for segment in commands.segments if segment.run > -1} == {-1, 0, 1}
    assert same(commands, standard_script())


def test_validation_scripts_follow_from_their_seed_and_are_none_that_models_are_judged_by() -> None:
    scripts = validation_scripts(seed=3, number=4, seconds=15.0)
    assert [len(each) for each in scripts] == [900] * 4
    assert all(same(*pair) for pair in zip(scripts, validation_scripts(3, 4, 15.0), strict=True))
    assert not any(same(*pair) for pair in zip(scripts, validation_scripts(4, 4, 15.0), strict=True))
    assert not any(same(scripts[0], other) for other in [*scripts[1:], standard_script()])
    assert {segment.kind for each in validation_scripts(0, 20) for segment in each.segments} == set(KINDS)


@given(st.integers(0, 10_000), st.floats(5.0, 60.0))
def test_a_random_script_is_as_long_as_asked_and_within_what_a_stick_can_do(seed: int, seconds: float) -> None:
    commands = random_script(np.random.default_rng(seed), seconds)
    assert len(commands) == round(seconds * 60)
    assert np.abs(commands.stick).max() <= 1.0 + 1e-12
    assert np.abs(commands.facing) == pytest.approx(1.0)
    assert commands.run.min() >= -1.0
    assert commands.run.max() <= 1.0
    assert np.bincount(commands.segment).min() >= 59


def test_turning_left_leads_from_z_to_x_by_the_degrees_asked_for() -> None:
    commands = script([Segment(1.0, stick=1.0), Segment(2.0, stick=0.5, turn=45.0)])
    assert commands.facing[59] == pytest.approx(1.0)
    assert commands.facing[-1] == pytest.approx(1j)
    assert commands.stick[-1] == pytest.approx(0.5j)


def test_the_commanded_speed_is_from_2_5_to_7_5_centimetres_a_frame_at_full_stick() -> None:
    commands = script([Segment(1 / 60, stick=1.0, run=run) for run in (-1.0, 0.0, 1.0)])
    assert np.abs(commands.velocity) == pytest.approx([2.5, 5.0, 7.5])


def test_a_script_of_no_frames_is_refused() -> None:
    with pytest.raises(EvaluationError, match="at least one frame"):
        script([Segment(1.0), Segment(0.001)])
    with pytest.raises(EvaluationError, match="at least one frame"):
        script([])
