"""Episodes that a policy plays: in a model, from its starts or from true ones, and in the true environment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium.utils import seeding
from jaxtyping import Bool, Float32, Float64, Int64

from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.policies.policy import Policy
from addressed_dynamics.recording.environments import make_environment
from addressed_dynamics.simulators.copies import Copies, all_rows
from addressed_dynamics.simulators.given import Given
from addressed_dynamics.simulators.holding import held_step
from addressed_dynamics.simulators.worlds import World


@dataclass(frozen=True)
class Played:
    """What came of episodes."""

    returns: Float64[np.ndarray, " episode"]
    """Sum of the rewards of each."""
    steps: Int64[np.ndarray, " episode"]
    """Steps of each, of which a decision has several."""
    ended: Bool[np.ndarray, " episode"]
    """Whether each ended inside the task, and not by a limit."""

    @property
    def score(self) -> tuple[float, float]:
        """The mean return, and the share that ended inside the task."""
        return float(self.returns.mean()), float(self.ended.mean())


@dataclass(frozen=True)
class TrueEpisode:
    """An episode in the true environment."""

    states: Float32[np.ndarray, "time observation"]
    """The first state and those after each step, in the environment's units."""
    actions: Int64[np.ndarray, " step"]
    rewards: Float64[np.ndarray, " step"]
    ended: bool
    """Whether it ended inside the task."""


def play_in_model(world: World, policy: Policy, seeds: Sequence[int], limit: int, given: Given | None = None) -> Played:
    """Play an episode for each seed in copies of a world; those that have ended are not stepped any more.

    Args:
        world: the learned environment.
        policy: who acts.
        seeds: of the copies, each of which draws a start.
        limit: steps of an episode at most.
        given: starts in place of those that are drawn, one for each seed.
    """
    copies = Copies(world, len(seeds), limit)
    copies.generators = [seeding.np_random(seed)[0] for seed in seeds]
    rows = all_rows(len(seeds))
    states = copies.start(rows, given)[0].copy()
    returns, ended = np.zeros(len(seeds)), np.zeros(len(seeds), bool)
    while len(rows):
        stepped = held_step(copies, policy(states), rows, policy.hold)
        returns[rows] += stepped.reward
        ended[rows] = stepped.terminated
        going = ~(stepped.terminated | stepped.truncated)
        rows, states = rows[going], stepped.observation[going]
    return Played(returns, copies.steps.copy(), ended)


def play_in_truth(
    environment: EnvironmentParams, policy: Policy, seeds: Sequence[int], limit: int
) -> list[TrueEpisode]:
    """Play an episode for each seed in the true environment.

    Raises:
        RecordingError: the environment cannot be made.
    """
    made = make_environment(environment_with_limit(environment, limit))
    episodes = []
    for seed in seeds:
        state, _ = made.reset(seed=seed)
        states, actions, rewards = [state], [], []
        terminated = truncated = False
        while not (terminated or truncated):
            action = policy(state)
            for _ in range(policy.hold):
                state, reward, terminated, truncated, _ = made.step(action)
                states.append(state)
                actions.append(action)
                rewards.append(float(reward))
                if terminated or truncated:
                    break
        taken = np.array(actions, np.int64)
        episodes.append(TrueEpisode(np.array(states, np.float32), taken, np.array(rewards), bool(terminated)))
    made.close()
    return episodes


def environment_with_limit(environment: EnvironmentParams, limit: int) -> EnvironmentParams:
    """Return the environment with a limit of so many steps."""
    return environment.model_copy(update={"kwargs": {**environment.kwargs, "max_episode_steps": limit}})


def played(episodes: Sequence[TrueEpisode]) -> Played:
    """Return what came of true episodes."""
    return Played(
        np.array([each.rewards.sum() for each in episodes]),
        np.array([len(each.actions) for each in episodes], np.int64),
        np.array([each.ended for each in episodes], bool),
    )


def play_beside(world: World, policy: Policy, episodes: Sequence[TrueEpisode], limit: int) -> Played:
    """Play true episodes again in the model, each from its first state on.

    A model of several frames is given those of the true episode, to the first decision that has as many before it, and
    goes on from there; what was earned before counts. An episode that had ended by then is as it was.
    """
    past = world.history - 1
    begin = -(-past // policy.hold) * policy.hold
    found = played(episodes)
    rows = np.flatnonzero([len(each.actions) > begin for each in episodes])
    if not len(rows):
        return found
    longer = [episodes[row] for row in rows.tolist()]
    given = Given(
        np.stack([each.states[begin - past : begin + 1] for each in longer]),
        np.stack([each.actions[begin - past : begin] for each in longer]),
        None,
    )
    after = play_in_model(world, policy, rows.tolist(), limit - begin, given)
    earned = np.array([each.rewards[:begin].sum() for each in longer])
    found.returns[rows], found.steps[rows], found.ended[rows] = earned + after.returns, begin + after.steps, after.ended
    return found


def trust_along(
    world: World, episodes: Sequence[TrueEpisode], hold: int
) -> list[Float64[np.ndarray, " decision"]] | None:
    """Return the trust of the model in the first step of each decision in true episodes.

    It is NaN where the model has not seen enough frames before.

    None if nobody calibrated the trust.
    """
    model, past = world.model, world.history - 1
    if model.trusted_if_calibrated() is None:
        return None
    found = []
    for each in episodes:
        rows = np.arange(0, len(each.actions), hold)
        trust = np.full(len(rows), np.nan)
        seen = rows >= past
        if seen.any():
            frames = rows[seen, None] + np.arange(-past, 1) if past else rows
            trust[seen] = model.trust(each.states[frames], each.actions[frames])
        found.append(trust)
    return found
