"""Actions that are held for several steps of a model: one step of an environment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int64

from addressed_dynamics.simulators.copies import Stepped

if TYPE_CHECKING:
    from addressed_dynamics.simulators.copies import Copies
    from addressed_dynamics.simulators.motion_environment import MotionCopies


def held_step(copies: Copies | MotionCopies, actions: Any, rows: Int64[np.ndarray, " chosen"], steps: int) -> Stepped:
    """Step some of the copies, each so often under the same action, or until its episode ends.

    Args:
        copies: copies of a world.
        actions: one for each of those that are stepped.
        rows: which ones.
        steps: for how many steps of the model an action is held.

    Returns:
        What the last step of each returned, with the sum of the rewards of all; `info` has the least `trust` of all,
        and whether one was `clipped`.

    Raises:
        ModelError: as in `Copies.step`.
    """
    whole = copies.step(actions, rows)
    taken = np.asarray(actions)
    for _ in range(steps - 1):
        going = np.flatnonzero(~(whole.terminated | whole.truncated))
        if not len(going):
            break
        part = copies.step(taken[going], rows[going])
        whole.observation[going] = part.observation
        whole.reward[going] += part.reward
        whole.terminated[going], whole.truncated[going] = part.terminated, part.truncated
        for name, values in part.info.items():
            whole.info[name][going] = _JOINED.get(name, _last)(whole.info[name][going], values)
    return whole


def _last(_: np.ndarray, after: np.ndarray) -> np.ndarray:
    return after


_JOINED = {"trust": np.minimum, "clipped": np.logical_or}
"""How what is said of two steps in turn becomes one; of anything else what is said of the last counts."""
