"""The same learner without a world: its replay buffer holds the recorded training transitions, and nothing is added."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64
from stable_baselines3.common.vec_env import DummyVecEnv

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.params.recording import DqnBehaviour
from addressed_dynamics.base.threads import single_thread
from addressed_dynamics.base.torch_runtime import CPU
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.policies.learning import greedy_policy
from addressed_dynamics.policies.policy import Policy
from addressed_dynamics.recording.acting import Progress
from addressed_dynamics.recording.dqn import dqn_of, generators_given_back
from addressed_dynamics.simulators.rewards import LearnedTask
from addressed_dynamics.simulators.tasks import Told, reward_and_end
from addressed_dynamics.simulators.worlds import World


@dataclass(frozen=True)
class Decisions:
    """Recorded transitions as a learner sees them that holds its actions."""

    first: Int64[np.ndarray, " decision"]
    """Row of the first transition of each."""
    last: Int64[np.ndarray, " decision"]
    """Row of the last."""
    reward: Float64[np.ndarray, " decision"]
    """Sum of the rewards of all."""
    terminated: Bool[np.ndarray, " decision"]
    """Whether the task ended in it."""
    broken: Bool[np.ndarray, " decision"]
    """Whether the next decision does not go on from it, though the task has not ended."""


def decisions_of(train: Transitions, task: Told | LearnedTask, hold: int) -> Decisions:
    """Return the decisions in recorded transitions: rows in a row under the same action, or to the end of the task.

    Rows that are in none, because the action changes sooner or the episode ends, are left out.

    Args:
        train: recorded transitions with discrete actions.
        task: says rewards and ends, which a recording may have of another task.
        hold: rows in a decision.
    """
    reward, ends = reward_and_end(task, train.observation, train.action, train.next_observation, train.exogenous)
    first, last = [], []
    for rows in train.episode_slices():
        action, end = train.action[rows], ends[rows]
        changes = np.append(np.flatnonzero(np.diff(action)) + 1, len(action))
        row = 0
        while row < len(action):
            until = min(row + hold, int(changes[np.searchsorted(changes, row, side="right")]))
            ended = np.flatnonzero(end[row:until])
            stop = row + int(ended[0]) + 1 if len(ended) else until
            if len(ended) or stop - row == hold:
                first.append(rows.start + row)
                last.append(rows.start + stop - 1)
            row = stop
    begins, stops = np.array(first, np.int64), np.array(last, np.int64)
    sums = np.concatenate([[0.0], np.cumsum(reward)])
    follows = np.zeros(len(begins), bool)
    follows[:-1] = (begins[1:] == stops[:-1] + 1) & (train.episode[begins[1:]] == train.episode[begins[:-1]])
    terminated = ends[stops]
    return Decisions(begins, stops, sums[stops + 1] - sums[begins], terminated, ~follows & ~terminated)


def learn_offline(
    world: World,
    train: Transitions,
    learner: DqnBehaviour,
    *,
    copies: int,
    decisions: int,
    seed: int,
    progress: Progress,
    device: torch.device = CPU,
) -> tuple[Policy, int]:
    """Let a DQN learn from recorded transitions alone, with as many gradient steps as in a world.

    The buffer of the library is filled once. Nobody acts, so nobody finds out what is overestimated, and no check can
    choose among what the policy was at times: the last is kept.

    Args:
        world: whose spaces and rewards they are; its model is not asked.
        train: training transitions.
        learner: the learner's settings.
        copies: of the world that it would learn in.
        decisions: which it would make there, over all copies.
        seed: of everything random in the learner.
        progress: called with the number of decisions, as if they were made.
        device: where the learner's networks are.

    Returns:
        The policy, and the number of decisions in the buffer.

    Raises:
        TrainingError: there is none in the recording.
    """
    assert world.task is not None
    found = decisions_of(train, world.task, learner.frame_skip)
    if not len(found.first):
        message = f"no action is held for {learner.frame_skip} recorded steps, so there is no decision to learn from"
        raise TrainingError(message)
    spaces = train.spec
    # One copy, so that decisions stand in the buffer one after the other: what counts all copies has a share of it.
    settings = learner.model_copy(
        update={
            "buffer_size": len(found.first),
            "target_update_interval": max(learner.target_update_interval // copies, 1),
        }
    )
    with generators_given_back(), single_thread():
        model = dqn_of(DummyVecEnv([lambda: _Nowhere(world)]), settings, seed, exploration_share=1.0, device=device)
        _fill(model.replay_buffer, train, found, learner.reward_scale)
        for step in range(max(decisions // copies, 1)):
            if step % learner.train_every == 0 and step * copies >= learner.learning_starts:
                model.train(learner.gradient_steps, learner.batch_size)
            model._on_step()  # counts, and copies the network to the target network
            progress(copies)
        return greedy_policy(model, spaces, learner.frame_skip), len(found.first)


def _fill(buffer: Any, train: Transitions, found: Decisions, scale: float) -> None:
    """Put decisions into an empty buffer of one copy; after one with a break behind it no return goes on."""
    every = slice(0, len(found.first))
    buffer.observations[every, 0] = train.observation[found.first]
    buffer.next_observations[every, 0] = train.next_observation[found.last]
    buffer.actions[every, 0, 0] = train.action[found.first]
    buffer.rewards[every, 0] = found.reward * scale
    buffer.dones[every, 0] = found.terminated | found.broken
    buffer.timeouts[every, 0] = found.broken
    buffer.pos, buffer.full = 0, True


class _Nowhere(gymnasium.Env[Any, Any]):
    """Spaces without a world."""

    def __init__(self, world: World) -> None:
        self.observation_space, self.action_space = world.observation_space, world.action_space
