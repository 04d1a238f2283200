"""Windows: the consecutive frames of one episode that a network with a history is given."""

import numpy as np
import torch
from jaxtyping import Int64, Shaped
from torch import Tensor

from addressed_dynamics.base.errors import TransitionsError
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.common.samples import Dropped


def window_rows(transitions: Transitions, history: int) -> Int64[np.ndarray, " sample"]:
    """Return the rows whose episode holds at least `history` - 1 rows before them: the last rows of all windows."""
    place = np.arange(len(transitions))
    for rows in transitions.episode_slices():
        place[rows] -= rows.start
    return np.flatnonzero(place >= history - 1).astype(np.int64)


def last_rows(transitions: Transitions) -> Int64[np.ndarray, " row"]:
    """Return for each row the last row of its episode."""
    last = np.empty(len(transitions), dtype=np.int64)
    for rows in transitions.episode_slices():
        last[rows] = rows.stop - 1
    return last


def shorter_episodes(transitions: Transitions, length: int) -> Dropped:
    """Count the episodes that have fewer rows than `length`, and these rows."""
    lengths = [rows.stop - rows.start for rows in transitions.episode_slices()]
    short = [each for each in lengths if each < length]
    return Dropped(len(short), sum(short))


def check_lengths(transitions: Transitions, history: int) -> None:
    """Check that at least one of the episodes, if there are any, is long enough for a window.

    Raises:
        TransitionsError: none is; the message names how many they are and the longest.
    """
    lengths = [rows.stop - rows.start for rows in transitions.episode_slices()]
    if lengths and max(lengths) < history:
        short = f"all {len(lengths)} episodes are" if len(lengths) > 1 else "the only episode is"
        longest = f"the longest has {max(lengths)}" if len(lengths) > 1 else f"it has {max(lengths)}"
        message = (
            f"{short} too short to predict from: features.history asks for {history} steps, but {longest}; "
            "lower features.history or record longer episodes"
        )
        raise TransitionsError(message)


def windows(
    values: Shaped[Tensor, "row ..."], rows: Int64[Tensor, " sample"], history: int
) -> Shaped[Tensor, "sample ..."]:
    """Return the values of the `history` rows up to each of `rows`, oldest first, (sample, history, ...).

    Without a history, that is with one row in a window, the values of `rows` themselves: (sample, ...).
    """
    if history == 1:
        return values[rows]
    return values[rows.unsqueeze(1) + torch.arange(1 - history, 1)]
