"""A DQN (Mnih et al., 2015; stable-baselines3) that learns in environments which are recorded meanwhile."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from jaxtyping import Float
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv
from torch import Tensor

from addressed_dynamics.errors import RecordingError
from addressed_dynamics.params import DqnBehaviour
from addressed_dynamics.recording.behaviours import HeldActions, Policy


def learn(
    environments: Sequence[gymnasium.Env[Any, Any]],
    behaviour: DqnBehaviour,
    *,
    transitions: int,
    seed: int,
    progress: Callable[[int], object],
) -> Policy:
    """Train a DQN for `transitions` steps in all `environments` together, and return its greedy policy.

    Copy i is first reset with the seed `seed` + i.

    Args:
        environments: copies of one environment.
        behaviour: the learner's settings.
        transitions: steps over all copies; a multiple of their number.
        seed: seed of everything random in the learner.
        progress: called with the number of transitions made since its last call.

    Raises:
        RecordingError: the environment's actions are not discrete.
    """
    if not isinstance(environments[0].action_space, spaces.Discrete):
        message = f"a dqn needs discrete actions, but the environment has {environments[0].action_space}"
        raise RecordingError(message)
    with _generators_given_back(), single_thread():
        model = _model(environments, behaviour, seed)
        model.learn(transitions, callback=_Counter(transitions, progress), log_interval=None)
    return _greedy(model)


@contextmanager
def single_thread() -> Iterator[None]:
    """Let PyTorch compute in one thread meanwhile: a learner's networks are too small to gain from more."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class _ExploringDQN(DQN):  # type: ignore[misc] # stable-baselines3 is not checked
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
        actions, state = self.policy.predict(observation, state, episode_start, deterministic=True)
        return (actions if deterministic else self._held_actions.replace(actions, self.exploration_rate)), state


class _ScaledByBounds(BaseFeaturesExtractor):  # type: ignore[misc] # stable-baselines3 is not checked
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
        scaled: Float[Tensor, "batch observation"] = (observations - self.centre) / self.reach
        return scaled


class _Counter(BaseCallback):  # type: ignore[misc] # stable-baselines3 is not checked
    """Reports progress, and stops the learner at its last transition instead of at the end of a training round."""

    def __init__(self, transitions: int, progress: Callable[[int], object]) -> None:
        super().__init__()
        self._transitions, self._progress = transitions, progress

    def _on_step(self) -> bool:
        self._progress(self.training_env.num_envs)
        return bool(self.num_timesteps < self._transitions)


def _model(environments: Sequence[gymnasium.Env[Any, Any]], behaviour: DqnBehaviour, seed: int) -> _ExploringDQN:
    model = _ExploringDQN(
        "MlpPolicy",
        DummyVecEnv([lambda environment=environment: environment for environment in environments]),
        learning_rate=behaviour.learning_rate,
        buffer_size=behaviour.buffer_size,
        learning_starts=behaviour.learning_starts,
        batch_size=behaviour.batch_size,
        gamma=behaviour.discount,
        n_steps=behaviour.return_steps,
        train_freq=behaviour.train_every,
        gradient_steps=behaviour.gradient_steps,
        target_update_interval=behaviour.target_update_interval,
        exploration_fraction=behaviour.exploration_share,
        exploration_final_eps=behaviour.exploration_final,
        policy_kwargs={
            "net_arch": list(behaviour.hidden),
            "features_extractor_class": _ScaledByBounds,
            "optimizer_kwargs": {"fused": True},
        },
        seed=seed,
        device="cpu",
    )
    generator = np.random.default_rng(seed)
    space = environments[0].action_space
    model.explore_with(HeldActions(space, len(environments), behaviour.exploration_hold_steps, generator))
    return model


def _greedy(model: _ExploringDQN) -> Policy:
    network = model.policy  # not the model: that would keep the replay buffer alive

    def act(observations: Float[np.ndarray, "copy observation"]) -> Any:
        with single_thread():
            return network.predict(observations, deterministic=True)[0]

    return act


@contextmanager
def _generators_given_back() -> Iterator[None]:
    """Leave the global generators as they were: the library seeds Python's, NumPy's and PyTorch's and uses them."""
    python_state, numpy_state = random.getstate(), np.random.get_state()  # noqa: NPY002
    torch_state = torch.get_rng_state()
    try:
        yield
    finally:
        random.setstate(python_state)
        np.random.set_state(numpy_state)  # noqa: NPY002
        torch.set_rng_state(torch_state)
