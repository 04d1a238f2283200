"""Acting side by side: how long an action is held, what a decision returns, and that every copy makes its steps."""

from collections.abc import Sequence

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.recording.acting import FrameSkip, act


class Lasting(gymnasium.Env):
    """Episodes of given lengths, over and over; the reward of step t is t, and every action is kept."""

    observation_space = spaces.Box(np.float32([0]), np.float32([np.inf]))
    action_space = spaces.Discrete(1_000)

    def __init__(self, lengths: Sequence[int], *, terminates: bool = True) -> None:
        self.lengths, self.terminates = lengths, terminates
        self.episodes: list[list[int]] = []

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed, options=options)
        self.episodes.append([])
        return self._observation(), {}

    def step(self, action):
        actions = self.episodes[-1]
        assert len(actions) < self._length(), "a step after the end of an episode"
        actions.append(int(action))
        ended = len(actions) == self._length()
        return self._observation(), len(actions), ended and self.terminates, ended and not self.terminates, {}

    def _length(self) -> int:
        return self.lengths[(len(self.episodes) - 1) % len(self.lengths)]

    def _observation(self):
        return np.array([len(self.episodes[-1])], dtype=np.float32)


class Numbered:
    """A policy that numbers its decisions and keeps what it saw."""

    def __init__(self) -> None:
        self.seen: list[list[float]] = []

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        self.seen.append(observations[:, 0].tolist())
        return np.full(len(observations), len(self.seen) - 1)


def acted(
    lengths: Sequence[Sequence[int]], frame_skip: int, steps: int
) -> tuple[list[list[list[int]]], Numbered, list[int]]:
    """Return the actions of each copy by episode, the policy that took them, and the progress."""
    copies = [FrameSkip(Lasting(each), frame_skip, steps) for each in lengths]
    for copy in copies:
        copy.reset()
    policy, progress = Numbered(), []
    act(copies, policy, progress.append)
    return [[episode for episode in copy.unwrapped.episodes if episode] for copy in copies], policy, progress


def test_a_decision_holds_its_action_sums_the_rewards_and_returns_what_its_last_step_returned() -> None:
    copy = FrameSkip(Lasting([10]), 4, 100)
    copy.reset()
    observation, reward, terminated, truncated, _ = copy.step(7)
    assert (observation.tolist(), reward, terminated, truncated) == ([4.0], 1 + 2 + 3 + 4, False, False)
    assert copy.unwrapped.episodes == [[7, 7, 7, 7]]
    assert copy.steps_left == 96


@pytest.mark.parametrize("terminates", [True, False])
def test_an_episode_that_ends_inside_a_decision_ends_the_decision(terminates: bool) -> None:
    copy = FrameSkip(Lasting([6], terminates=terminates), 4, 100)
    copy.reset()
    copy.step(1)
    _, reward, terminated, truncated, _ = copy.step(2)
    assert (reward, terminated, truncated) == (5 + 6, terminates, not terminates)
    copy.reset()
    copy.step(3)
    assert copy.unwrapped.episodes == [[1, 1, 1, 1, 2, 2], [3, 3, 3, 3]]


def test_a_decision_is_cut_short_where_no_step_is_left() -> None:
    (episodes,), policy, progress = acted([[100]], 4, 10)
    assert episodes == [[0] * 4 + [1] * 4 + [2] * 2]
    assert policy.seen == [[0.0], [4.0], [8.0]]
    assert progress == [4, 4, 2]


@given(st.lists(st.lists(st.integers(1, 9), min_size=1, max_size=3), min_size=1, max_size=3), st.integers(1, 6))
def test_every_copy_makes_its_steps_and_changes_its_action_only_at_decisions(
    lengths: list[list[int]], frame_skip: int
) -> None:
    copies, policy, progress = acted(lengths, frame_skip, 40)
    assert sum(progress) == 40 * len(lengths)
    assert max(progress) <= frame_skip * len(lengths)
    for episodes in copies:
        assert sum(map(len, episodes)) == 40
        for episode in episodes:
            # Decisions are numbered over all copies, one after another.
            assert episode == [episode[0] + step // frame_skip for step in range(len(episode))]
    assert len(policy.seen) >= -(-40 // frame_skip)


def test_without_frame_skip_all_copies_decide_at_every_step() -> None:
    copies, policy, progress = acted([[3], [5]], 1, 6)
    assert copies == [[[0, 1, 2], [3, 4, 5]], [[0, 1, 2, 3, 4], [5]]]
    assert policy.seen == [[0, 0], [1, 1], [2, 2], [0, 3], [1, 4], [2, 0]]
    assert progress == [2] * 6
