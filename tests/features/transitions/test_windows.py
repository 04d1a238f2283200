import numpy as np
import pytest
import torch
from builders import car_transitions
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import TransitionsError
from addressed_dynamics.features.common.samples import Dropped
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.features.transitions.windows import episode_lengths, shorter_episodes, window_rows, windows
from addressed_dynamics.sources.transitions.params import FeatureParams


@given(lengths=st.lists(st.integers(1, 9), min_size=1, max_size=6), history=st.integers(1, 7))
def test_windows_are_all_stretches_of_frames_that_lie_in_one_episode(lengths: list[int], history: int) -> None:
    transitions = car_transitions(lengths)
    expected = [
        row
        for row in range(history - 1, len(transitions))
        if len(set(transitions.episode[row - history + 1 : row + 1].tolist())) == 1
    ]
    assert window_rows(transitions, history).tolist() == expected


def test_a_window_holds_its_rows_oldest_first() -> None:
    values = torch.arange(10)
    assert windows(values, torch.tensor([2, 7]), 3).tolist() == [[0, 1, 2], [5, 6, 7]]
    assert windows(values, torch.tensor([2, 7]), 1).tolist() == [2, 7]
    vectors = torch.arange(20.0).view(10, 2)
    assert windows(vectors, torch.tensor([4]), 2).tolist() == [[[6, 7], [8, 9]]]


@pytest.mark.parametrize("history", [2, 6])
def test_an_episode_shorter_than_the_history_has_no_window(history: int) -> None:
    assert len(window_rows(car_transitions([history - 1, history - 1]), history)) == 0


@given(lengths=st.lists(st.integers(1, 9), min_size=1, max_size=6), history=st.integers(1, 7))
def test_episodes_without_a_window_are_counted_with_their_rows(lengths: list[int], history: int) -> None:
    transitions = car_transitions(lengths)
    without = set(transitions.episode.tolist()) - set(transitions.episode[window_rows(transitions, history)].tolist())
    rows = int(np.isin(transitions.episode, list(without)).sum())
    assert shorter_episodes(episode_lengths([transitions]), history) == Dropped(len(without), rows)


def test_episodes_that_are_all_shorter_than_the_history_are_an_error_that_counts_them() -> None:
    params = FeatureParams(target="change", history=4)
    message = r"all 2 episodes are too short .*: features\.history asks for 4 steps, but the longest has 3; lower"
    with pytest.raises(TransitionsError, match=message):
        fit_features(car_transitions([2, 3]), params)
    features = fit_features(car_transitions([2, 4]), params)
    with pytest.raises(TransitionsError, match=r"the only episode is too short .* asks for 4 steps, but it has 1;"):
        features.samples(car_transitions([1]))
    assert len(features.samples(car_transitions([3, 4, 5]))) == 1 + 2
