"""Environments as stable-baselines3 takes them: it has a vector environment of its own, and no other will do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from jaxtyping import Float32
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvStepReturn

from addressed_dynamics.base.errors import ModelError


class StableBaselinesEnvironments(VecEnv):  # type: ignore[misc] # stable-baselines3's types are not read
    """Copies of an environment, learned or not, that stable-baselines3 learns in.

    Of an episode's last step it needs the state that the episode ended with (`terminal_observation`), in place of which
    `step` returns the first of the next; and whether only a limit ended it (`TimeLimit.truncated`), after which there
    would have been more to come. Without these it learns other values, and says nothing.
    """

    def __init__(self, environments: VectorEnv[Any, Any, Any]) -> None:
        """Take over a vector environment that starts anew in the same step.

        Raises:
            ModelError: it starts anew in another step, or never.
        """
        mode = environments.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.SAME_STEP:
            found = mode.value if isinstance(mode, AutoresetMode) else mode
            message = (
                "stable-baselines3 needs copies that start anew in the step that ends them: make_vec(..., "
                f"autoreset_mode='SameStep'), but these have {found!r}"
            )
            raise ModelError(message)
        self.environments = environments
        self._actions: Any = None
        super().__init__(environments.num_envs, environments.single_observation_space, environments.single_action_space)

    def reset(self) -> Float32[np.ndarray, "copy observation"]:
        """Start all copies, by the seeds and options that were set last."""
        if any(each != self._options[0] for each in self._options):
            message = "all copies are reset with the same options; give arrays with a row for each copy in one of them"
            raise ModelError(message)
        seeds = None if all(each is None for each in self._seeds) else list(self._seeds)
        observation, infos = self.environments.reset(seed=seeds, options=self._options[0] or None)  # type: ignore[arg-type] # as SyncVectorEnv
        self.reset_infos = _split(infos, self.num_envs)
        self._reset_seeds()
        self._reset_options()
        found: Float32[np.ndarray, "copy observation"] = observation
        return found

    def step_async(self, actions: np.ndarray) -> None:
        """Remember actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Take the actions; return observations, rewards, which copies started anew, and `info` of each."""
        observation, reward, terminated, truncated, infos = self.environments.step(self._actions)
        final, states = infos.pop("final_info", {}), infos.pop("final_obs", None)
        for name in ("_final_info", "_final_obs"):
            infos.pop(name, None)
        each = _split(infos, self.num_envs)
        done = terminated | truncated
        last = _split(final, self.num_envs) if final else each
        for copy in np.flatnonzero(done).tolist():
            self.reset_infos[copy], each[copy] = each[copy], last[copy]
            each[copy]["terminal_observation"] = states[copy]
        for info, limited in zip(each, (truncated & ~terminated).tolist(), strict=True):
            info["TimeLimit.truncated"] = limited
        return observation, reward.astype(np.float32), done, each

    def close(self) -> None:
        """Close the environments."""
        self.environments.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the environments, which all copies share."""
        return [getattr(self.environments, attr_name)] * len(self._get_indices(indices))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refuse: the copies are no environments of their own.

        Raises:
            ModelError: always.
        """
        del value, indices
        message = f"copies that are stepped together have no attribute '{attr_name}' of their own that could be set"
        raise ModelError(message)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refuse: the copies are no environments of their own.

        Raises:
            ModelError: always.
        """
        del method_args, indices, method_kwargs
        message = f"copies that are stepped together have no method '{method_name}' of their own"
        raise ModelError(message)

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Return that no copy is wrapped."""
        del wrapper_class
        return [False] * len(self._get_indices(indices))

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return no images: nothing is drawn."""
        return [None] * self.num_envs


def _split(infos: dict[str, Any], number: int) -> list[dict[str, Any]]:
    """Return what is said of each copy of its own."""
    found: list[dict[str, Any]] = [{} for _ in range(number)]
    for name, values in infos.items():
        if name.startswith("_") and name[1:] in infos:
            continue
        told = infos.get(f"_{name}")
        for copy, value in enumerate(values.tolist() if values.ndim == 1 else values):
            if told is None or told[copy]:
                found[copy][name] = value
    return found
