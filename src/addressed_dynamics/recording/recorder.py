"""The wrapper that logs every step of an environment."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, NoReturn, SupportsFloat

import gymnasium
import numpy as np

from addressed_dynamics.base.errors import LogError, RecordingError
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.logs import RunInfo, TransitionLogWriter
from addressed_dynamics.recording.spaces import check_single, environment_name, space_spec

_LARGEST_REWARD = float(np.finfo(np.float32).max)
_LARGEST_SEED = 2**63 - 1


class TransitionRecorder(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Logs every transition that the wrapped environment makes, and changes nothing about it.

    Put it outside a time limit, so that truncations are seen, and inside anything that changes observations or actions,
    so that the log has the environment's own. Close it to complete the file. A step after the end of an episode that no
    reset precedes is taken for the reset of an environment that resets itself: its observation begins the next episode.
    An episode that is not finished when the environment is reset or closed stays in the log, cut.

    Of a vectorised environment each part has a recorder and a file of its own, inside the vectorisation:
    `SyncVectorEnv([lambda i=i: TransitionRecorder(make("CartPole-v1"), f"logs/{i}.mcap") for i in range(3)])`. They may
    all number their episodes from 0: `read_transitions` and the stage `convert` tell recordings in one folder apart.

    Args:
        env: the environment, with a Box observation space and a Discrete or Box action space.
        path: the log; with `shard_transitions`, logs are called `<stem>-000.mcap`, `<stem>-001.mcap`, … instead.
        shard_transitions: a log is complete at the end of the episode in which it reaches this many transitions; None
            writes everything to one.
        first_episode: number of the first episode; the next ones follow.
        run: where the data comes from; by default what the environment tells.
        topic: prefix of the transitions' topic; must differ between environments that are viewed together.

    Raises:
        SpaceError: the environment's spaces cannot be recorded, or it is a vectorised one.
        LogError: the file cannot be created.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        path: Path | str,
        *,
        shard_transitions: int | None = None,
        first_episode: int = 0,
        run: RunInfo | None = None,
        topic: str = "/env_00",
    ) -> None:
        check_single(env)
        super().__init__(env)
        self.space_spec = space_spec(env)
        """What the recorded numbers mean."""
        self.paths: list[Path] = []
        """The logs begun so far; all but the last are complete."""
        self.transitions = 0
        """Transitions recorded so far, over all logs."""
        self._path = Path(path)
        self._shard_transitions = shard_transitions
        self._run = run or _run_info(env)
        self._topic = topic
        action = self.space_spec.action
        self._action_count = action.count if isinstance(action, DiscreteAction) else None
        self._sizes = {
            "observation": len(self.space_spec.observation),
            "action": 1 if isinstance(action, DiscreteAction) else len(action.dimensions),
        }
        self._episode, self._step = first_episode, 0
        self._seed: int | None = None
        self._observation: list[float] | None = None
        self._failure: str | None = None
        self._writer: TransitionLogWriter | None = self._open()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment; an episode that has not ended is cut.

        Raises:
            RecordingError: as in `step`; or the seed is too large to be recorded.
        """
        if seed is not None and seed > _LARGEST_SEED:
            message = f"the seed {seed} cannot be recorded: give one below 2**63"
            raise RecordingError(message)
        self._end_episode(cut=True)
        observation, info = self.env.reset(seed=seed, options=options)
        self._start_episode(observation, seed)
        return observation, info

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Advance the environment and log the transition.

        Raises:
            RecordingError: the log cannot be written (the message says how many transitions are safe), the action does
                not belong to the action space's shape or range, or a number is not finite.
        """
        given = self._given_action(action)
        observation, reward, terminated, truncated, info = self.env.step(action)
        before = self._observation
        if before is None:
            self._start_episode(observation, seed=None)
        else:
            self._record(before, given, observation, float(reward), bool(terminated), bool(truncated), info)
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Complete the log and close the environment; an episode that has not ended is cut.

        Raises:
            RecordingError: the log cannot be written; an error that `step` has already raised is not raised again.
        """
        try:
            if self._failure is None:
                self._end_episode(cut=True)
                self._close_log()
        finally:
            super().close()

    def _record(
        self,
        before: list[float],
        action: int | list[float],
        observation: Any,
        reward: float,
        terminated: bool,
        truncated: bool,
        info: Mapping[str, Any],
    ) -> None:
        ended = terminated or truncated
        # An environment that resets itself within the step returns the next episode's first observation.
        resets_itself = ended and "final_obs" in info
        next_observation = self._flat(info["final_obs"] if resets_itself else observation, "observation")
        if not -_LARGEST_REWARD <= reward <= _LARGEST_REWARD:
            self._refuse(f"the reward is {reward}, which is not a finite float32")
        try:
            if self._writer is None:
                self._writer = self._open()
            self._writer.append(
                self._episode, self._step, before, action, reward, next_observation, terminated, truncated
            )
        except LogError as error:
            self._fail(error)
        self.transitions += 1
        self._step += 1
        self._observation = next_observation
        if ended:
            self._end_episode(cut=False)
        if resets_itself:
            self._start_episode(observation, seed=None)

    def _start_episode(self, observation: Any, seed: int | None) -> None:
        self._step, self._seed = 0, seed
        self._observation = self._flat(observation, "observation")

    def _end_episode(self, *, cut: bool) -> None:
        self._check_failure()
        self._observation = None
        if self._step == 0 or self._writer is None:
            return
        self._step = 0
        self._episode += 1
        try:
            self._writer.end_episode(self._seed, cut=cut)
        except LogError as error:
            self._fail(error)
        if self._shard_transitions is not None and self._writer.count >= self._shard_transitions:
            self._close_log()

    def _open(self) -> TransitionLogWriter:
        path = self._path
        if self._shard_transitions is not None:
            path = path.with_name(f"{path.stem}-{len(self.paths):03d}.mcap")
        writer = TransitionLogWriter(
            path, self.space_spec, topic=self._topic, run=self._run, first_step=self.transitions
        )
        self.paths.append(path)
        return writer

    def _close_log(self) -> None:
        if self._writer is not None:
            try:
                self._writer.close()
            except LogError as error:
                self._fail(error)
            self._writer = None

    def _given_action(self, action: Any) -> int | list[float]:
        self._check_failure()
        if self._action_count is None:
            # A copy before the step: an environment may clip the action in place.
            return self._flat(action, "action")
        number = self._whole(action)
        if not 0 <= number < self._action_count:
            self._refuse(f"the action is {number}, but actions are 0..{self._action_count - 1}")
        return number

    def _whole(self, action: Any) -> int:
        if isinstance(action, numbers.Integral):
            return int(action)
        array = np.asarray(action)
        if array.ndim:
            hint = "give its one element, action[0]" if array.size == 1 else "give one action at a time"
            self._refuse(f"the action is an array of shape {array.shape}, but should be one whole number: {hint}")
        if array.dtype.kind not in "biuf" or not float(array).is_integer():
            self._refuse(f"the action is {action!r}, but should be a whole number")
        return int(array)

    def _flat(self, value: Any, what: str) -> list[float]:
        """Return the components, rounded to float32, as a list: a copy, and cheaper than an array to check and pack."""
        flat: list[float] = np.asarray(value, dtype=np.float32).ravel().tolist()
        size = self._sizes[what]
        if len(flat) != size:
            self._refuse(f"the {what} has {len(flat)} components, but its space has {size}")
        # No sum of finite float32 values overflows Python's floats.
        if not math.isfinite(sum(flat)):
            self._refuse(f"the {what} is not finite: {flat}")
        return flat

    def _refuse(self, problem: str) -> NoReturn:
        where = f"{self._path}: {environment_name(self.env)}, episode {self._episode}, step {self._step}"
        self._end_episode(cut=True)
        message = f"{where}: {problem}; nothing from this step on is recorded until the environment is reset"
        raise RecordingError(message)

    def _check_failure(self) -> None:
        if self._failure is not None:
            raise RecordingError(self._failure)

    def _fail(self, error: LogError) -> NoReturn:
        self._failure, self._writer = str(error), None
        raise RecordingError(self._failure) from error


def _run_info(env: gymnasium.Env[Any, Any]) -> RunInfo:
    return RunInfo(
        environment=environment_name(env),
        kwargs={} if env.spec is None else env.spec.kwargs,
        versions=dict(_versions()),
        started=datetime.now(UTC).isoformat(timespec="microseconds"),
    )


@lru_cache(maxsize=1)
def _versions() -> tuple[tuple[str, str], ...]:
    return tuple((name, version(name)) for name in ("addressed-dynamics", "gymnasium", "numpy"))
