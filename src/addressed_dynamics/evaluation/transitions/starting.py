"""Which states of training episodes a learned environment starts at."""

import numpy as np
from jaxtyping import Int64

from addressed_dynamics.episodes.transitions import DiscreteAction, Transitions
from addressed_dynamics.features.transitions.windows import window_rows
from addressed_dynamics.simulators.starts import Starts

MOST = 1024
"""So many starts are kept, half of them where episodes begin if there are as many episodes."""


def starts_of(train: Transitions, history: int) -> Starts:
    """Choose starts from training transitions: where episodes begin, and rows anywhere, drawn evenly.

    Args:
        train: training transitions, at least one episode as long as the history.
        history: number of frames of a window.
    """
    generator = np.random.default_rng(0)
    rows = window_rows(train, history)
    bounds = [(each.start, each.stop) for each in train.episode_slices()]
    first = np.array([start + history - 1 for start, stop in bounds if stop - start >= history], np.int64)
    beginnings = _some(first, max(MOST // 2, MOST - (len(rows) - len(first))), generator)
    others = _some(np.setdiff1d(rows, first), MOST - len(beginnings), generator)
    chosen = np.concatenate([beginnings, others])
    frames = chosen[:, None] + np.arange(1 - history, 1)
    known = bool(train.spec.exogenous)
    ends = np.array([stop for _, stop in bounds], np.int64)
    discrete = isinstance(train.spec.action, DiscreteAction)
    return Starts(
        spaces=train.spec,
        observation=train.observation[frames],
        action=train.action[frames[:, :-1]],
        beginning=np.arange(len(chosen)) < len(beginnings),
        episode=train.episode[chosen],
        step=train.step[chosen],
        exogenous=train.exogenous if known else train.exogenous[:0],
        row=frames[:, 0] if known else np.zeros(len(chosen), np.int64),
        stop=ends[np.searchsorted(ends, chosen, side="right")] if known else np.zeros(len(chosen), np.int64),
        action_range=np.empty((2, 0), np.float32) if discrete else np.stack([train.action.min(0), train.action.max(0)]),
    )


def _some(rows: Int64[np.ndarray, " row"], most: int, generator: np.random.Generator) -> Int64[np.ndarray, " chosen"]:
    """Return at most so many of the rows, in their order."""
    return rows if len(rows) <= most else np.sort(generator.choice(rows, most, replace=False))
