"""The recording plan: its segments in order, all environment copies of a segment side by side."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import numpy as np
from filelock import FileLock, Timeout

from addressed_dynamics.base.errors import RecordingError
from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.base.params.recording import (
    DqnBehaviour,
    GaitBehaviour,
    GreedyBehaviour,
    RecordParams,
    SegmentParams,
)
from addressed_dynamics.recording.acting import FrameSkip, Progress, act
from addressed_dynamics.recording.behaviours import HeldActions, Policy, mostly, unlearned_policy
from addressed_dynamics.recording.dqn import learn
from addressed_dynamics.recording.environments import Environment, make_environment
from addressed_dynamics.recording.gait import GaitPolicy
from addressed_dynamics.recording.provenance import run_info
from addressed_dynamics.recording.recorder import TransitionRecorder
from addressed_dynamics.recording.spaces import space_spec

_LOCK = ".lock"
"""File in a folder of a recording that is going on."""

EPISODES_PER_COPY = 10_000_000
COPIES_PER_SEGMENT = 1_000
"""Room in the numbering of episodes: segment 2, copy 3, 17th episode is 2_003_0000016 (segments and copies from 0)."""


def record_plan(plan: RecordParams, folder: Path, *, progress: Progress) -> None:
    """Carry out `plan` and leave its logs in `folder`; the same plan makes the same transitions.

    The files are `<segment>-env<copy>-<shard>.mcap`, numbered from 0.

    Raises:
        RecordingError: a segment cannot be carried out, for instance because its environment cannot be made.
        SpaceError: an environment has spaces that cannot be recorded.
        LogError: a log cannot be written.
    """
    learned: dict[str, Policy] = {}
    for index, segment in enumerate(plan.segments):
        with ExitStack() as stack:
            environments = [
                stack.enter_context(closing(_recorded(segment, index, copy, folder, plan.shard_transitions)))
                for copy in range(segment.environments)
            ]
            if isinstance(segment.behaviour, DqnBehaviour):
                learned[segment.name] = learn(
                    environments,
                    segment.behaviour,
                    transitions=segment.transitions,
                    seed=segment.seed,
                    progress=progress,
                )
            else:
                policy = _policy(segment, environments[0], learned)
                frame_skip = _frame_skip(segment, plan)
                steps = segment.transitions // segment.environments
                copies = [FrameSkip(environment, frame_skip, steps) for environment in environments]
                for copy, environment in enumerate(copies):
                    environment.reset(seed=segment.seed + copy)
                began = policy.begin if isinstance(policy, GaitPolicy) else lambda _: None
                act(copies, policy, progress, began)


@contextmanager
def recording_folder(target: Path) -> Iterator[Path]:
    """Yield a folder to record into; it becomes `target`, replacing an earlier one, if the block ends well.

    Otherwise the logs, if there are any, stay in a hidden folder beside `target` until the next recording, and the
    exception carries a note that says where.

    Raises:
        RecordingError: another process is recording for the same target.
    """
    partial = target.with_name(f".{target.name}.partial")
    with _alone_in(partial):
        try:
            yield partial
        except BaseException as error:
            if any(each.name != _LOCK for each in partial.iterdir()):
                error.add_note(
                    f"what was recorded stays in {partial} until the next recording; "
                    "'addressed-dynamics recover FILE' saves the whole episodes of a file that was cut off"
                )
            raise
        (partial / _LOCK).unlink()
        with atomic_path(target) as temporary:
            partial.replace(temporary)


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Let no other process work in a folder, which is emptied first; remove it if it is empty in the end."""
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / _LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        message = f"{folder}: another process is recording there; wait until it ends, or end it"
        raise RecordingError(message) from error
    try:
        for each in folder.iterdir():
            if each.name != _LOCK:
                shutil.rmtree(each) if each.is_dir() else each.unlink()
        yield
    finally:
        lock.release()
        (folder / _LOCK).unlink(missing_ok=True)
        if folder.exists() and not any(folder.iterdir()):
            folder.rmdir()


def first_episode(segment_index: int, copy: int) -> int:
    """Return the number of the first episode of a copy; those of different copies and segments never meet."""
    return (segment_index * COPIES_PER_SEGMENT + copy) * EPISODES_PER_COPY


def _recorded(
    segment: SegmentParams, index: int, copy: int, folder: Path, shard_transitions: int
) -> TransitionRecorder:
    if segment.environments > COPIES_PER_SEGMENT or segment.transitions // segment.environments > EPISODES_PER_COPY:
        message = (
            f"segment '{segment.name}': expected at most {COPIES_PER_SEGMENT} environments with "
            f"{EPISODES_PER_COPY} transitions each; split it into several segments"
        )
        raise RecordingError(message)
    return TransitionRecorder(
        make_environment(segment.environment),
        folder / f"{segment.name}-env{copy:02d}.mcap",
        shard_transitions=shard_transitions,
        first_episode=first_episode(index, copy),
        run=run_info(segment),
        topic=f"/env_{copy:02d}",
    )


def _policy(segment: SegmentParams, environment: Environment, learned: Mapping[str, Policy]) -> Policy:
    generator = np.random.default_rng(segment.seed)
    match segment.behaviour:
        case GaitBehaviour() as gait:
            spec, space = space_spec(environment), environment.action_space
            return GaitPolicy(gait, spec, space, segment.environments, generator)
        case GreedyBehaviour(segment=earlier, epsilon=epsilon):
            held = HeldActions(environment.action_space, segment.environments, mean_hold_steps=1.0, generator=generator)
            return mostly(learned[earlier], held, epsilon)
        case DqnBehaviour():
            message = f"segment '{segment.name}': nobody knows how to act as '{segment.behaviour.kind}'"
            raise RecordingError(message)
        case unlearned:
            return unlearned_policy(unlearned, environment, segment.environments, generator)


def _frame_skip(segment: SegmentParams, plan: RecordParams) -> int:
    """Return the simulated steps in a decision: a learned policy acts as often as it did while it learned."""
    behaviour = segment.behaviour
    if isinstance(behaviour, GreedyBehaviour):
        behaviour = next(each.behaviour for each in plan.segments if each.name == behaviour.segment)
    return behaviour.frame_skip if isinstance(behaviour, DqnBehaviour) else 1
