"""Small recordings of Acrobot, made with the environment itself."""

from collections.abc import Sequence

import gymnasium
import numpy as np

from addressed_dynamics.envs import ACROBOT
from addressed_dynamics.episodes.transitions import SpaceSpec, Transitions
from addressed_dynamics.recording.spaces import space_spec


def acrobot_spaces(time_step: float = 0.02) -> SpaceSpec:
    return space_spec(gymnasium.make(ACROBOT, time_step=time_step))


def acrobot_recording(
    lengths: Sequence[int], *, torque: Sequence[bool] = (True,), seed: int = 0, noise: float = 0.0
) -> Transitions:
    """Episodes from varied starts, under random torques or none: `torque` says which, in turns."""
    kwargs = {"start_angle": (-np.pi, np.pi), "start_velocity": (-3.0, 3.0), "torque_noise": noise}
    env = gymnasium.make(ACROBOT, ends_at_goal=False, max_episode_steps=max(lengths) + 1, **kwargs)
    generator = np.random.default_rng(seed)
    states, actions = [], []
    for episode, length in enumerate(lengths):
        shown = [env.reset(seed=1000 * seed + episode)[0]]
        draws = generator.integers(0, 3, length // 10 + 1).repeat(10)[:length]
        chosen = draws if torque[episode % len(torque)] else np.ones(length, dtype=np.int64)
        shown += [env.step(action)[0] for action in chosen.tolist()]
        states.append(np.array(shown))
        actions.append(chosen)
    total = sum(lengths)
    truncated = np.zeros(total, dtype=bool)
    truncated[np.cumsum(lengths) - 1] = True
    return Transitions(
        spec=acrobot_spaces(),
        episode=np.repeat(np.arange(len(lengths)), lengths),
        step=np.concatenate([np.arange(length, dtype=np.int32) for length in lengths]),
        time_ns=np.arange(total) * 20_000_000,
        observation=np.concatenate([shown[:-1] for shown in states]),
        action=np.concatenate(actions),
        reward=np.full(total, -1.0, dtype=np.float32),
        next_observation=np.concatenate([shown[1:] for shown in states]),
        terminated=np.zeros(total, dtype=bool),
        truncated=truncated,
    )
