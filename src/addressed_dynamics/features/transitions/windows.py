"""Windows: the consecutive frames of one episode that a network with a history is given."""

import numpy as np
import torch
from jaxtyping import Int64, Shaped
from torch import Tensor

from addressed_dynamics.episodes.transitions import Transitions


def window_rows(transitions: Transitions, history: int) -> Int64[np.ndarray, " sample"]:
    """Return the rows whose episode holds at least `history` - 1 rows before them: the last rows of all windows."""
    place = np.arange(len(transitions))
    for rows in transitions.episode_slices():
        place[rows] -= rows.start
    return np.flatnonzero(place >= history - 1).astype(np.int64)


def windows(
    values: Shaped[Tensor, "row ..."], rows: Int64[Tensor, " sample"], history: int
) -> Shaped[Tensor, "sample ..."]:
    """Return the values of the `history` rows up to each of `rows`, oldest first, (sample, history, ...).

    Without a history, that is with one row in a window, the values of `rows` themselves: (sample, ...).
    """
    if history == 1:
        return values[rows]
    return values[rows.unsqueeze(1) + torch.arange(1 - history, 1)]
