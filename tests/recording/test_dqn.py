"""The learner: it learns, it explores copy by copy, and scales what it sees."""

import tempfile
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from example_params import DQN
from gymnasium import spaces

from addressed_dynamics.base.params.recording import DqnBehaviour
from addressed_dynamics.recording.acting import FrameSkip
from addressed_dynamics.recording.dqn import ScaledByBounds, _model, learn


class Corridor(gymnasium.Env):
    """Ten cells; the reward of 1 lies at the right end, and every step costs a little."""

    observation_space = spaces.Box(np.float32([0]), np.float32([10]))
    action_space = spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed, options=options)
        self.cell, self.steps = int(self.np_random.integers(0, 10)), 0
        return self._observation(), {}

    def step(self, action):
        self.cell = max(self.cell + (1 if action else -1), 0)
        self.steps += 1
        arrived = self.cell >= 10
        return self._observation(), 1.0 if arrived else -0.1, arrived, self.steps >= 30, {}

    def _observation(self):
        return np.array([self.cell], dtype=np.float32)


class Counted(gymnasium.Wrapper):
    """Counts the steps, and keeps the rewards."""

    def __init__(self, env):
        super().__init__(env)
        self.steps, self.rewards = 0, []

    def step(self, action):
        self.steps += 1
        result = self.env.step(action)
        self.rewards.append(result[1])
        return result


def behaviour(**changes) -> DqnBehaviour:
    return DqnBehaviour.model_validate(DQN | {"hidden": (16,), "train_every": 1, "gradient_steps": 1} | changes)


@pytest.mark.slow
def test_the_learner_finds_the_way_through_a_corridor() -> None:
    copies = [Corridor() for _ in range(2)]
    policy = learn(copies, behaviour(learning_rate=5e-3), transitions=2_000, seed=0, progress=lambda _: None)
    everywhere = np.arange(10, dtype=np.float32)[:, None]
    assert policy(everywhere).tolist() == [1] * 10


def test_the_same_seed_learns_the_same_policy_whatever_the_global_generators_say() -> None:
    observations = np.linspace(0, 10, 50, dtype=np.float32)[:, None]
    learned = []
    for noise in (1, 2):
        torch.manual_seed(noise)
        policy = learn([Corridor()], behaviour(), transitions=150, seed=3, progress=lambda _: None)
        learned.append(policy(observations).tolist())
    assert learned[0] == learned[1]


def test_copies_with_unequally_many_decisions_make_equally_many_steps_and_leave_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    counted = [Counted(Corridor()) for _ in range(3)]
    made: list[int] = []
    learn(counted, behaviour(frame_skip=7, learning_starts=10), transitions=600, seed=0, progress=made.append)
    assert [copy.steps for copy in counted] == [200] * 3
    assert sum(made) == 600
    assert list(tmp_path.iterdir()) == []


def test_the_learner_alone_is_given_scaled_rewards() -> None:
    counted = Counted(Corridor())
    model = _model([FrameSkip(counted, 3, 100)], behaviour(reward_scale=0.5), seed=0)
    model.env.reset()
    _, rewards, _, _ = model.env.step(np.array([0]))
    assert rewards.tolist() == pytest.approx([-0.15])
    assert counted.rewards == [-0.1] * 3


def test_observations_are_scaled_by_their_bounds_and_left_alone_without() -> None:
    space = spaces.Box(np.float32([-1.2, -np.inf, 0]), np.float32([0.6, np.inf, np.inf]))
    scaled = ScaledByBounds(space)(torch.tensor([[-1.2, 5.0, 3.0], [0.6, -2.0, 0.5], [-0.3, 0.0, 0.0]]))
    expected = [[-1.0, 5.0, 3.0], [1.0, -2.0, 0.5], [0.0, 0.0, 0.0]]
    torch.testing.assert_close(scaled, torch.tensor(expected))
