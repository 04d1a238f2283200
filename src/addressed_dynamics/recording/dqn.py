"""A DQN (Mnih et al., 2015; stable-baselines3) that learns in environments which are recorded meanwhile."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.wrappers import TransformReward
from jaxtyping import Float
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from torch import Tensor

from addressed_dynamics.base.errors import RecordingError
from addressed_dynamics.base.params.recording import DqnBehaviour
from addressed_dynamics.base.threads import single_thread
from addressed_dynamics.base.torch_runtime import CPU
from addressed_dynamics.recording.acting import FrameSkip, Progress, act
from addressed_dynamics.recording.behaviours import HeldActions, Policy


def learn(
    environments: Sequence[gymnasium.Env[Any, Any]],
    behaviour: DqnBehaviour,
    *,
    transitions: int,
    seed: int,
    progress: Progress,
) -> Policy:
    """Train a DQN for `transitions` steps in all `environments` together, and return its greedy policy.

    Copy i is first reset with the seed `seed` + i. The learner decides every `frame_skip` steps. As an episode may end
    inside a decision, copies come to their last step at different times: learning ends with the first of them, and the
    others go on with what has been learned.

    Args:
        environments: copies of one environment.
        behaviour: the learner's settings.
        transitions: simulated steps over all copies; a multiple of their number, which share them equally.
        seed: seed of everything random in the learner.
        progress: called with the number of simulated steps made since its last call.

    Raises:
        RecordingError: the environment's actions are not discrete.
    """
    if not isinstance(environments[0].action_space, spaces.Discrete):
        message = f"a dqn needs discrete actions, but the environment has {environments[0].action_space}"
        raise RecordingError(message)
    steps = transitions // len(environments)
    copies = [FrameSkip(environment, behaviour.frame_skip, steps) for environment in environments]
    with generators_given_back(), single_thread():
        model = _model(copies, behaviour, seed)
        # There are at most as many decisions as transitions; the counter ends the training.
        model.learn(transitions, callback=_Counter(copies, progress), log_interval=None)
        act(copies, lambda observations: model.predict(observations)[0], progress)
    return _greedy(model)


class ExploringDQN(DQN):  # type: ignore[misc] # stable-baselines3 is not checked
    """DQN whose copies explore each for itself, with random actions that they hold.

    The library's DQN draws once for all copies whether to explore, and a new random action at every step.
    """

    def explore_with(self, held: HeldActions) -> None:
        """Take random actions from `held`."""
        self._held_actions = held

    def predict(
        self,
        observation: Float[np.ndarray, "copy observation"],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Return the actions of all copies, the greedy ones or those it explores with."""
        actions, state = self.policy.predict(observation, state, episode_start, deterministic=True)
        return (actions if deterministic else self._held_actions.replace(actions, self.exploration_rate)), state


class ScaledByBounds(BaseFeaturesExtractor):  # type: ignore[misc] # stable-baselines3 is not checked
    """Observations scaled to [-1, 1] by the bounds of their space; a dimension without bounds stays as it is."""

    def __init__(self, observation_space: spaces.Box) -> None:
        super().__init__(observation_space, features_dim=observation_space.shape[0])
        low, high = observation_space.low.astype(np.float64), observation_space.high.astype(np.float64)
        bounded = np.isfinite(low) & np.isfinite(high)
        centre, reach = np.zeros_like(low), np.ones_like(low)
        centre[bounded] = (low[bounded] + high[bounded]) / 2
        reach[bounded] = (high[bounded] - low[bounded]) / 2
        self.register_buffer("centre", torch.as_tensor(centre, dtype=torch.float32))
        self.register_buffer("reach", torch.as_tensor(reach, dtype=torch.float32))

    def forward(self, observations: Float[Tensor, "batch observation"]) -> Float[Tensor, "batch observation"]:
        """Return observations inside their bounds in [-1, 1]."""
        scaled: Float[Tensor, "batch observation"] = (observations - self.centre) / self.reach
        return scaled


class _Counter(BaseCallback):  # type: ignore[misc] # stable-baselines3 is not checked
    """Reports progress, and stops the learner as soon as a copy has made its last step."""

    def __init__(self, copies: Sequence[FrameSkip], progress: Progress) -> None:
        super().__init__()
        self._copies, self._progress = copies, progress
        self._steps_left = self._count()

    def _on_step(self) -> bool:
        before, self._steps_left = self._steps_left, self._count()
        self._progress(before - self._steps_left)
        return all(copy.steps_left for copy in self._copies)

    def _count(self) -> int:
        return sum(copy.steps_left for copy in self._copies)


def _model(copies: Sequence[FrameSkip], behaviour: DqnBehaviour, seed: int) -> ExploringDQN:
    environments = DummyVecEnv([lambda copy=copy: TransformReward(copy, _scaled(behaviour)) for copy in copies])
    # The library takes the share of the transitions, but counts decisions.
    return dqn_of(environments, behaviour, seed, exploration_share=behaviour.exploration_share / behaviour.frame_skip)


def _scaled(behaviour: DqnBehaviour) -> Callable[[SupportsFloat], float]:
    return lambda reward: float(reward) * behaviour.reward_scale


def dqn_of(
    environments: VecEnv,
    behaviour: DqnBehaviour,
    seed: int,
    *,
    exploration_share: float,
    device: torch.device = CPU,
) -> ExploringDQN:
    """Return a learner that has not yet learned anything.

    Args:
        environments: where it learns, with decisions for steps and rewards as it is to be given them.
        behaviour: its settings.
        seed: seed of everything random in it.
        exploration_share: share of the steps that it is asked to learn for over which epsilon falls.
        device: where its networks are; what it has seen stays on the CPU, and what is random is drawn there.
    """
    model = ExploringDQN(
        "MlpPolicy",
        environments,
        learning_rate=behaviour.learning_rate,
        buffer_size=behaviour.buffer_size,
        learning_starts=behaviour.learning_starts,
        batch_size=behaviour.batch_size,
        gamma=behaviour.discount,
        n_steps=behaviour.return_steps,
        train_freq=behaviour.train_every,
        gradient_steps=behaviour.gradient_steps,
        target_update_interval=behaviour.target_update_interval,
        exploration_fraction=exploration_share,
        exploration_final_eps=behaviour.exploration_final,
        policy_kwargs={
            "net_arch": list(behaviour.hidden),
            "features_extractor_class": ScaledByBounds,
            "optimizer_kwargs": {"fused": True},
        },
        seed=seed,
        device=device,
    )
    held = HeldActions(
        environments.action_space, environments.num_envs, behaviour.exploration_hold_steps, np.random.default_rng(seed)
    )
    model.explore_with(held)
    # The library's own logger would make an empty folder among the temporary files each time, and leave it there.
    model.set_logger(Logger(None, []))
    return model


def _greedy(model: ExploringDQN) -> Policy:
    network = model.policy  # not the model: that would keep the replay buffer alive

    def act(observations: Float[np.ndarray, "copy observation"]) -> Any:
        with single_thread():
            return network.predict(observations, deterministic=True)[0]

    return act


@contextmanager
def generators_given_back() -> Iterator[None]:
    """Leave the global generators as they were: the library seeds Python's, NumPy's and PyTorch's and uses them."""
    python_state, numpy_state = random.getstate(), np.random.get_state()  # noqa: NPY002 - the library's
    torch_state = torch.get_rng_state()
    try:
        yield
    finally:
        random.setstate(python_state)
        np.random.set_state(numpy_state)  # noqa: NPY002 - as above
        torch.set_rng_state(torch_state)
