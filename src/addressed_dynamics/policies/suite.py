"""A policy for an experiment: learned in its model, chosen there, and only then held against the truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.files import save_arrays, write_json, write_rows
from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.base.threads import single_thread
from addressed_dynamics.base.torch_runtime import CPU
from addressed_dynamics.episodes.transitions import DiscreteAction, SpaceSpec, Transitions
from addressed_dynamics.policies.learning import Learned, learn_policy
from addressed_dynamics.policies.offline import learn_offline
from addressed_dynamics.policies.playing import (
    Played,
    TrueEpisode,
    environment_with_limit,
    play_beside,
    play_in_model,
    play_in_truth,
    played,
    trust_along,
)
from addressed_dynamics.policies.policy import Policy, save_policy
from addressed_dynamics.policies.records import (
    ARRAYS,
    CURVE,
    FIGURES,
    LOW_TRUST,
    PolicyFigures,
    TrustAlong,
    mean_of,
    score_of,
)
from addressed_dynamics.recording.acting import FrameSkip, Progress
from addressed_dynamics.recording.environments import make_environment
from addressed_dynamics.recording.spaces import space_spec
from addressed_dynamics.simulators.environment import LearnedEnvironments
from addressed_dynamics.simulators.tasks import sources
from addressed_dynamics.simulators.worlds import World
from addressed_dynamics.sources.transitions.params import PolicyParams

CHECKED, MODEL, TRUTH = 1_000_000, 2_000_000, 3_000_000
"""Added to the seed for episodes that are played: in checks, and for the figures in the model and in truth."""
_ENDLESS = 1 << 60
_MANY_LOW = 0.1
"""Share of an episode's decisions with low trust from which on it is counted."""


@dataclass(frozen=True)
class Outcome:
    """What came of an experiment's policy."""

    policy: Policy
    figures: PolicyFigures
    curves: Mapping[str, Learned]
    """How it was learned, in the `model` and in `truth`."""
    arrays: Mapping[str, np.ndarray]
    """`returns_…` and `steps_…` of the episodes that are reported; `state`, `trust` and `episode` of true decisions."""
    seconds: Mapping[str, float]
    """What each part took."""


def train_policy(
    models: Path,
    train: Callable[[], Transitions],
    params: PolicyParams,
    progress: Progress,
    device: torch.device = CPU,
) -> Outcome:
    """Learn a policy inside a model, and score it.

    It is chosen by its return in the model alone, before anything is played in the true environment.

    Args:
        models: the experiment's folder of models.
        train: reads the training transitions.
        params: what to do.
        progress: called with the number of decisions made since its last call.
        device: where the model and the learners compute.

    Raises:
        TrainingError: the actions are not discrete, nobody says the reward, or the environment is of other spaces.
        ModelError: there is no such model, or it has no starts.
        RecordingError: the true environment cannot be made.
    """
    options: dict[str, Any] = {
        "model": models, "candidate": params.candidate, "reward": params.reward, "trust": False, "device": device,
    }  # fmt: skip
    world = World.of(**options)
    spaces = world.model.features.spaces
    _check(world, params, spaces)
    seconds: dict[str, float] = {}
    with single_thread():
        with _timed(seconds, "model"):
            copies = LearnedEnvironments(
                num_envs=params.copies, max_episode_steps=params.episode_steps // params.learner.frame_skip,
                autoreset_mode=AutoresetMode.SAME_STEP, begin=params.begin, hold=params.learner.frame_skip, **options,
            )  # fmt: skip
            checked = _seeds(params, CHECKED, params.check_episodes)
            inside = _learn(
                copies, spaces, params,
                lambda policy: play_in_model(world, policy, checked, params.episode_steps).score, progress, device,
            )  # fmt: skip
        with _timed(seconds, "score"):
            policy, seeds = inside.policy, _seeds(params, MODEL, params.episodes)
            alone = play_in_model(world, policy, seeds, params.episode_steps)
        with _timed(seconds, "offline"):
            offline, recorded = learn_offline(
                world, train(), params.learner, copies=params.copies, decisions=params.decisions, seed=params.seed,
                progress=progress, device=device,
            )  # fmt: skip
        common: dict[str, Any] = {
            "reward": sources(world.task)[0],
            "candidate": params.candidate,
            "environment": params.environment.id if params.environment else None,
            "hold": policy.hold,
            "decisions": params.decisions // params.copies * params.copies,
            "copies": params.copies,
            "episode_steps": params.episode_steps,
            "least_ended": params.least_ended,
            "kept_decisions": inside.checks[inside.kept].decisions,
            "model": score_of(alone),
            "offline_decisions": recorded,
        }
        arrays = _arrays("model", alone)
        if params.environment is None:
            without = play_in_model(world, offline, seeds, params.episode_steps)
            figures = PolicyFigures(**common, offline=score_of(without))
            return Outcome(policy, figures, {"model": inside}, arrays | _arrays("offline", without), seconds)
        with _timed(seconds, "truth"):
            there = _learn_in_truth(params.environment, spaces, params, progress, device)
        with _timed(seconds, "score"):
            compared, found = _compare(world, params.environment, params, policy, offline, there.policy)
    figures = PolicyFigures(**common, **compared)
    return Outcome(policy, figures, {"model": inside, "truth": there}, arrays | found, seconds)


def write_outcome(folder: Path, outcome: Outcome | None) -> None:
    """Write a policy with all that is known of it into a folder that becomes the experiment's; None if it has none."""
    folder.mkdir(parents=True)
    if outcome is None:
        save_policy(folder, None)
        return
    save_policy(folder, outcome.policy)
    write_json(folder / FIGURES, outcome.figures.to_json())
    rows = [
        {"learner": name, "decisions": check.decisions, "return": check.mean_return, "ended": check.ended}
        for name, learned in outcome.curves.items()
        for check in learned.checks
    ]
    write_rows(folder / CURVE, rows)
    save_arrays(folder / ARRAYS, dict(outcome.arrays))


def _learn(
    copies: Any,
    spaces: SpaceSpec,
    params: PolicyParams,
    score: Callable[[Policy], tuple[float, float]],
    progress: Progress,
    device: torch.device,
) -> Learned:
    return learn_policy(
        copies, spaces, params.learner, decisions=params.decisions, checks=params.checks, seed=params.seed, score=score,
        progress=progress, device=device,
    )  # fmt: skip


def _learn_in_truth(
    environment: EnvironmentParams, spaces: SpaceSpec, params: PolicyParams, progress: Progress, device: torch.device
) -> Learned:
    """Let the same learner learn in copies of the true environment, with as many steps, and choose by truth."""
    limited = environment_with_limit(environment, params.episode_steps)
    copies = SyncVectorEnv(
        [lambda: FrameSkip(make_environment(limited), params.learner.frame_skip, _ENDLESS)] * params.copies,
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
    seeds = _seeds(params, CHECKED, params.check_episodes)

    def score(policy: Policy) -> tuple[float, float]:
        return played(play_in_truth(environment, policy, seeds, params.episode_steps)).score

    learned = _learn(copies, spaces, params, score, progress, device)
    copies.close()
    return learned


def _compare(
    world: World, environment: EnvironmentParams, params: PolicyParams, policy: Policy, offline: Policy, there: Policy
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Play the policies in truth, and the one that was learned in the model from the same first states there, too."""
    limit, seeds = params.episode_steps, _seeds(params, TRUTH, params.episodes)
    episodes = play_in_truth(environment, policy, seeds, limit)
    true, beside = played(episodes), play_beside(world, policy, episodes, limit)
    others = {name: played(play_in_truth(environment, each, seeds, limit))
              for name, each in (("offline", offline), ("true_learner", there))}  # fmt: skip
    trust = trust_along(world, episodes, policy.hold)
    figures = {
        "truth": score_of(true),
        "beside": score_of(beside),
        "gap": mean_of(true.returns - beside.returns),
        "trust": None if trust is None else _trust_figures(trust),
        **{name: score_of(each) for name, each in others.items()},
    }
    arrays = _arrays("truth", true) | _arrays("beside", beside)
    for name, each in others.items():
        arrays |= _arrays(name, each)
    return figures, arrays | ({} if trust is None else _along(episodes, trust, policy.hold))


def _trust_figures(trust: Sequence[np.ndarray]) -> TrustAlong:
    known = [each[~np.isnan(each)] for each in trust]
    low = np.concatenate(known) < LOW_TRUST
    shares = [float((each < LOW_TRUST).mean()) for each in known if len(each)]
    return TrustAlong(
        len(low),
        float(low.mean()) if len(low) else 0.0,
        float(np.mean([share > _MANY_LOW for share in shares])) if shares else 0.0,
    )


def _along(episodes: Sequence[TrueEpisode], trust: Sequence[np.ndarray], hold: int) -> dict[str, np.ndarray]:
    number = [len(each) for each in trust]
    return {
        "state": np.concatenate([each.states[:-1:hold] for each in episodes]),
        "trust": np.concatenate(trust).astype(np.float32),
        "episode": np.repeat(np.arange(len(episodes), dtype=np.int32), number),
    }


def _arrays(name: str, found: Played) -> dict[str, np.ndarray]:
    return {f"returns_{name}": found.returns, f"steps_{name}": found.steps}


def _seeds(params: PolicyParams, base: int, number: int) -> range:
    return range(params.seed + base, params.seed + base + number)


def _check(world: World, params: PolicyParams, spaces: SpaceSpec) -> None:
    if not isinstance(spaces.action, DiscreteAction):
        message = (
            "policy: a dqn chooses among discrete actions, but this experiment's are continuous; leave 'policy' null"
        )
        raise TrainingError(message)
    if world.task is None:
        message = (
            "policy: nobody says the reward and the end of a step, and no log has them; name in evaluation.reward a "
            "function of state, action and next state as 'module:function', for instance "
            "addressed_dynamics.envs:mountain_car_reward"
        )
        raise TrainingError(message)
    if params.environment is None:
        return
    if spaces.exogenous:
        names = ", ".join(each.name for each in spaces.exogenous)
        message = (
            f"policy.environment: beside '{params.environment.id}' nobody knows the exogenous inputs ({names}) that "
            "the model needs; leave it null, and the policy is scored in the model"
        )
        raise TrainingError(message)
    found = space_spec(make_environment(params.environment))
    if found.observation_names != spaces.observation_names or found.action != spaces.action:
        message = (
            f"policy.environment: '{params.environment.id}' has states of {', '.join(found.observation_names)} and "
            f"other actions than, or not the states of, the model ({', '.join(spaces.observation_names)})"
        )
        raise TrainingError(message)


@contextmanager
def _timed(seconds: dict[str, float], part: str) -> Iterator[None]:
    begin = time.perf_counter()
    yield
    seconds[part] = seconds.get(part, 0.0) + time.perf_counter() - begin
