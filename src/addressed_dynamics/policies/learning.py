"""A DQN (stable-baselines3) that learns in copies of a world, and of what it was at times the best is kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from gymnasium.vector import VectorEnv
from gymnasium.wrappers.vector import TransformReward
from jaxtyping import Float
from stable_baselines3.common.callbacks import BaseCallback

from addressed_dynamics.base.params.recording import DqnBehaviour
from addressed_dynamics.base.threads import single_thread
from addressed_dynamics.base.torch_runtime import CPU
from addressed_dynamics.episodes.transitions import SpaceSpec
from addressed_dynamics.policies.policy import Policy
from addressed_dynamics.recording.acting import Progress
from addressed_dynamics.recording.dqn import ExploringDQN, dqn_of, generators_given_back
from addressed_dynamics.simulators.stable_baselines import StableBaselinesEnvironments


@dataclass(frozen=True)
class Check:
    """What the policy was worth at a time while it was learned."""

    decisions: int
    """Decisions made before, over all copies."""
    mean_return: float
    """Mean return of the episodes of the check."""
    ended: float
    """Share of them that ended inside the task."""


@dataclass(frozen=True)
class Learned:
    """What came of learning."""

    policy: Policy
    """As it was at the check that is kept."""
    checks: tuple[Check, ...]
    """All of them, in order."""
    kept: int
    """Number of the one with the highest mean return; the first of several."""


Scored = Callable[[Policy], tuple[float, float]]
"""Plays some episodes and returns their mean return, and the share that ended inside the task."""


def learn_policy(
    environments: VectorEnv[Any, Any, Any],
    spaces: SpaceSpec,
    learner: DqnBehaviour,
    *,
    decisions: int,
    checks: int,
    seed: int,
    score: Scored,
    progress: Progress,
    device: torch.device = CPU,
) -> Learned:
    """Let a DQN learn in copies of a world, which start anew in the same step.

    Args:
        environments: the copies; a step of them is a decision.
        spaces: what their numbers mean.
        learner: the learner's settings.
        decisions: how many it makes, over all copies.
        checks: how often its greedy policy is scored, at equal distances, the last time at the end.
        seed: of everything random in the learner; copy i starts with this seed plus i.
        score: says what a policy is worth.
        progress: called with the number of decisions made since its last call.
        device: where the learner's networks are.
    """
    scaled = TransformReward(environments, _scaling(learner.reward_scale))
    with generators_given_back(), single_thread():
        model = dqn_of(
            StableBaselinesEnvironments(scaled), learner, seed, exploration_share=learner.exploration_share,
            device=device,
        )  # fmt: skip
        rounds = max(decisions // environments.num_envs, 1)
        at = {round(rounds * (each + 1) / checks) for each in range(checks)}
        watching = _Watching(at, lambda: greedy_policy(model, spaces, learner.frame_skip), score, progress)
        model.learn(rounds * environments.num_envs, callback=watching, log_interval=None)
    kept = int(np.argmax([check.mean_return for check in watching.checks]))
    return Learned(watching.policies[kept], tuple(watching.checks), kept)


def greedy_policy(model: ExploringDQN, spaces: SpaceSpec, hold: int) -> Policy:
    """Return what a learner would do without exploring, as it is now."""
    found = {name: tensor.detach().cpu().numpy().copy() for name, tensor in model.policy.q_net.state_dict().items()}
    scaling = "features_extractor."
    numbers = sorted({int(name.split(".")[1]) for name in found if name.startswith("q_net.")})
    layers = tuple((found[f"q_net.{number}.weight"], found[f"q_net.{number}.bias"]) for number in numbers)
    return Policy(spaces, hold, found[f"{scaling}centre"], found[f"{scaling}reach"], layers)


class _Watching(BaseCallback):  # type: ignore[misc] # stable-baselines3 is not checked
    """Scores the policy at times, and reports progress."""

    def __init__(self, at: set[int], policy: Callable[[], Policy], score: Scored, progress: Progress) -> None:
        super().__init__()
        self.checks: list[Check] = []
        self.policies: list[Policy] = []
        self._at, self._policy, self._score, self._progress = at, policy, score, progress

    def _on_step(self) -> bool:
        self._progress(self.training_env.num_envs)
        if self.n_calls in self._at:
            policy = self._policy()
            self.policies.append(policy)
            self.checks.append(Check(self.num_timesteps, *self._score(policy)))
        return True


def _scaling(scale: float) -> Callable[[Float[np.ndarray, " copy"]], Float[np.ndarray, " copy"]]:
    return lambda rewards: rewards * scale
