"""A model as an environment: one that can be reset and stepped, alone or in many copies.

`gymnasium.make(LEARNED, model=...)` and `make_vec` make them (`addressed_dynamics.envs` registers them). The `info` of
a step has

* `network`: the member that the step is from, or that is weighted most,
* `trust`: as `AddressedDynamics.trust` has it, of the state and action of the step; no such key if none was calibrated,
* `clipped`: whether the model left the bounds of the space, so that the state was put at them,
* `stopped_by`: why the model cannot go on (and `truncated` is true): `trust`, for less than `least_trust`; `exogenous`,
  for the end of what is replayed; `not_finite`, for a prediction that is no number, in place of which the state stays;
  else empty, also where a time limit truncates,
* `reward_source`, `end_source`: the name of the function that says reward and end; `learned` if networks do, which were
  trained on the logs; `none` if nobody does: then the reward is 0, or no episode ends inside the task.

What an environment of motion says is in `addressed_dynamics.simulators.motion_environment`.

That of a reset has `episode` and `step` of the recording that the start is from, -1 if it was given, and `clipped`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool, Float32, Float64, Int64

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.copies import Copies, Info, all_rows, in_place, reset_seeds
from addressed_dynamics.simulators.given import given_starts
from addressed_dynamics.simulators.holding import held_step
from addressed_dynamics.simulators.motion import MotionModel
from addressed_dynamics.simulators.motion_environment import MotionCopies, MotionWorld, given_facings, is_motion
from addressed_dynamics.simulators.worlds import World, WorldOptions

State = Float32[np.ndarray, " observation"]
States = Float32[np.ndarray, "copy observation"]
Ends = Bool[np.ndarray, " copy"]


def world_of(
    model: AddressedDynamics | MotionModel | str | Path, **options: Unpack[WorldOptions]
) -> World | MotionWorld:
    """Return the world of a model, or of what is in its folder: of states and actions, or of motion and commands.

    Raises:
        ModelError: there is no such model, function or choice, or an option does not fit the model.
    """
    if isinstance(model, AddressedDynamics):
        return World.of(model, **options)
    if isinstance(model, MotionModel) or is_motion(model, options.get("candidate")):
        return MotionWorld.of(model, **options)
    return World.of(model, **options)


def copies_of(world: World | MotionWorld, number: int, limit: int | None = None) -> Copies | MotionCopies:
    """Return copies of a world that have not started, with a limit to the steps of an episode."""
    return MotionCopies(world, number, limit) if isinstance(world, MotionWorld) else Copies(world, number, limit)


def start_copies(
    copies: Copies | MotionCopies, rows: Int64[np.ndarray, " chosen"], options: Mapping[str, Any]
) -> tuple[States, Info]:
    """Start some copies anew, as options of `reset` say.

    Raises:
        ModelError: what is given is no start, or there is none to draw.
    """
    number = len(copies.ended)
    if isinstance(copies, MotionCopies):
        return copies.start(rows, given_facings(options, number))
    return copies.start(rows, given_starts(copies.world, options, number))


class LearnedEnvironment(gymnasium.Env[State, Any]):
    """One copy of a learned environment. Its observations are states; frames before them it keeps itself.

    Args:
        model: a model, or its folder, for instance `data/models/mountaincar`.
        options: see `WorldOptions`.

    Raises:
        ModelError: there is no such model or function, or an option does not fit it.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 # Gymnasium declares it without ClassVar

    def __init__(self, model: AddressedDynamics | MotionModel | str | Path, **options: Unpack[WorldOptions]) -> None:
        self.world = world_of(model, **options)
        self.observation_space = self.world.observation_space
        self.action_space = self.world.action_space
        self.metadata = self.world.described()
        self._copies = copies_of(self.world, 1)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[State, dict[str, Any]]:
        """Start at a state that is drawn from recorded ones, or given: `options={"state": ...}`.

        Raises:
            ModelError: there are no recorded starts, or what is given is no start.
        """
        super().reset(seed=seed)
        self._copies.generators = [self.np_random]
        observation, info = start_copies(self._copies, all_rows(1), options or {})
        return observation[0], _of_one(info)

    def step(self, action: Any) -> tuple[State, float, bool, bool, dict[str, Any]]:
        """Take an action.

        Raises:
            ModelError: it is outside the space, the episode has ended, or a function of the user's fails.
        """
        stepped = held_step(self._copies, np.asarray(action)[None], all_rows(1), self.world.hold)
        return (
            stepped.observation[0], float(stepped.reward[0]), bool(stepped.terminated[0]), bool(stepped.truncated[0]),
            _of_one(stepped.info),
        )  # fmt: skip


class LearnedEnvironments(VectorEnv[States, Any, np.ndarray]):
    """Copies of a learned environment that are stepped together, by one step of the model.

    Copy i of those that are seeded with s goes as one environment that is seeded with s + i.

    Args:
        model: a model, or its folder.
        num_envs: number of copies.
        max_episode_steps: number of steps after which an episode is truncated; None for no limit.
        autoreset_mode: when a copy whose episode has ended starts anew: in the next step, which then takes no action
            (`NextStep`); in the same step, with the last state in `final_obs` and `final_info` (`SameStep`); or when
            `reset` says so in `options["reset_mask"]` (`Disabled`).
        options: see `WorldOptions`.

    Raises:
        ModelError: there is no such model, function or mode, or an option does not fit the model.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012 # as above

    def __init__(
        self,
        model: AddressedDynamics | MotionModel | str | Path,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **options: Unpack[WorldOptions],
    ) -> None:
        if num_envs < 1:
            message = f"num_envs should be at least 1, but is {num_envs}"
            raise ModelError(message)
        if max_episode_steps is not None and max_episode_steps < 1:
            message = f"max_episode_steps should be at least 1, but is {max_episode_steps}"
            raise ModelError(message)
        self.world = world_of(model, **options)
        self.num_envs = num_envs
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self.metadata = {**self.world.described(), "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = self.world.observation_space
        self.single_action_space = self.world.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        limit = None if max_episode_steps is None else max_episode_steps * self.world.hold
        self._copies = copies_of(self.world, num_envs, limit)
        self._observation = np.zeros(self.observation_space.shape or (), np.float32)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[States, dict[str, Any]]:
        """Start all copies, or those in `options["reset_mask"]`, at states that are drawn or given.

        Raises:
            ModelError: there are no recorded starts, what is given is no start, or the mask or seeds do not fit.
        """
        seeds = reset_seeds(seed, self.num_envs)
        wanted = dict(options or {})
        rows = np.flatnonzero(_checked_mask(wanted.pop("reset_mask", None), self.num_envs))
        if not self._copies.generators:
            self._copies.generators = [seeding.np_random()[0] for _ in range(self.num_envs)]
        for row in rows:
            if seeds[row] is not None:
                self._copies.generators[row] = seeding.np_random(seeds[row])[0]
        infos: dict[str, Any] = {}
        started = start_copies(self._copies, rows, wanted)
        self._observation[rows] = started[0]
        self._tell(infos, started[1], rows)
        return self._observation.copy(), infos

    def step(self, actions: Any) -> tuple[States, Float64[np.ndarray, " copy"], Ends, Ends, dict[str, Any]]:
        """Take an action in every copy.

        Raises:
            ModelError: one is outside the space, a copy has ended and is not reset, or a function of the user's fails.
        """
        taken = np.asarray(actions)
        if taken.shape[:1] != (self.num_envs,):
            message = f"there should be an action for each of {self.num_envs} copies, but they have shape {taken.shape}"
            raise ModelError(message)
        next_step = self.autoreset_mode is AutoresetMode.NEXT_STEP
        anew = np.flatnonzero(self._copies.ended) if next_step else np.empty(0, np.int64)
        rows = all_rows(self.num_envs) if not len(anew) else np.flatnonzero(~self._copies.ended)
        reward, ends = np.zeros(self.num_envs), np.zeros((2, self.num_envs), bool)
        infos: dict[str, Any] = {}
        if len(rows):
            at = in_place(rows, self.num_envs)
            stepped = held_step(self._copies, taken[at], rows, self.world.hold)
            self._observation[at], reward[at], ends[0, at], ends[1, at], info = stepped
            done = ends[0, at] | ends[1, at]
            if self.autoreset_mode is AutoresetMode.SAME_STEP and done.any():
                anew = rows[done]
                self._tell_last(infos, {name: values[done] for name, values in info.items()}, anew)
                info, rows = {name: values[~done] for name, values in info.items()}, rows[~done]
            self._tell(infos, info, rows)
        if len(anew):
            started = self._copies.start(anew)
            self._observation[anew] = started[0]
            self._tell(infos, started[1], anew)
        return self._observation.copy(), reward, ends[0], ends[1], infos

    def _tell(self, infos: dict[str, Any], info: Info, rows: Int64[np.ndarray, " chosen"]) -> None:
        """Add what is said of some copies, beside which copies that are, as Gymnasium has it."""
        for name, values in info.items():
            if len(rows) == self.num_envs:
                infos[name], infos[f"_{name}"] = values, np.ones(self.num_envs, bool)
                continue
            if name not in infos:
                fill = None if values.dtype == object else 0
                infos[name] = np.full(self.num_envs, fill, values.dtype)
                infos[f"_{name}"] = np.zeros(self.num_envs, bool)
            infos[name][rows], infos[f"_{name}"][rows] = values, True

    def _tell_last(self, infos: dict[str, Any], info: Info, rows: Int64[np.ndarray, " chosen"]) -> None:
        """Add the last states of copies that start anew in the same step, and what is said of them."""
        last: dict[str, Any] = {}
        self._tell(last, info, rows)
        states, ended = np.full(self.num_envs, None, object), np.zeros(self.num_envs, bool)
        for row in rows:
            states[row] = self._observation[row].copy()
        ended[rows] = True
        infos |= {"final_obs": states, "_final_obs": ended, "final_info": last, "_final_info": ended.copy()}


def _of_one(info: Info) -> dict[str, Any]:
    return {name: values.tolist()[0] for name, values in info.items()}


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError as error:
        known = ", ".join(each.value for each in AutoresetMode)
        message = f"autoreset_mode should be one of {known}, but is {mode!r}"
        raise ModelError(message) from error


def _checked_mask(mask: Any, number: int) -> Bool[np.ndarray, " copy"]:
    if mask is None:
        return np.ones(number, bool)
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (number,) or not mask.any():
        message = f"option 'reset_mask' should be an array of {number} booleans, one of them true"
        raise ModelError(message)
    return mask
