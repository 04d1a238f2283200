from dataclasses import replace

import pytest
from learning import drive, sail, swing

from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.transitions.history import choose_history

TRAIN, VALIDATION = sail((60,) * 10), sail((60,) * 4, seed=1)


def without_speed(boat: Transitions) -> Transitions:
    """A boat of which nobody logs the speed: it shows in two positions."""
    return replace(
        boat,
        spec=replace(boat.spec, observation=boat.spec.observation[:1]),
        observation=boat.observation[:, :1],
        next_observation=boat.next_observation[:, :1],
    )


def test_a_whole_state_needs_no_frames_before_it() -> None:
    assert choose_history(TRAIN, VALIDATION).chosen == 1


def test_a_speed_that_nobody_logs_needs_one_frame_before() -> None:
    choice = choose_history(without_speed(TRAIN), without_speed(VALIDATION))
    assert choice.chosen == 2
    assert list(choice.tried) == ["1", "2", "4", "6"]
    assert choice.tried["1"]["mse"] > 10 * choice.tried["2"]["mse"]


def test_what_is_not_linear_in_the_last_frame_needs_none_before_it() -> None:
    assert choose_history(drive((60,) * 30), drive((60,) * 8, seed=1)).chosen == 1


def test_noise_needs_no_frames_before_it() -> None:
    assert choose_history(swing((200,) * 10), swing((200,) * 4, seed=1)).chosen == 1


@pytest.mark.parametrize(("length", "tried"), [(3, []), (15, ["1", "2"]), (60, ["1", "2", "4", "6"])])
def test_frames_that_many_transitions_lack_are_not_tried(length: int, tried: list[str]) -> None:
    assert list(choose_history(swing((length,) * 10), swing((60,) * 2, seed=1)).tried) == tried


def test_the_same_transitions_make_the_same_choice() -> None:
    assert choose_history(TRAIN, VALIDATION) == choose_history(TRAIN, VALIDATION)
