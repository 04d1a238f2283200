"""Windows: the consecutive frames of one episode that a network with a history is given."""

from collections.abc import Iterable

import numpy as np
import torch
from jaxtyping import Int64, Shaped
from torch import Tensor

from addressed_dynamics.base.errors import TransitionsError
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.common.samples import Dropped
from addressed_dynamics.features.common.spool import IN_MEMORY, Scratch


class EpisodeLengths:
    """Lengths of episodes whose transitions come in parts, each of which may end inside an episode."""

    def __init__(self) -> None:
        self._known: list[Int64[np.ndarray, " episode"]] = []
        self._last: int | None = None
        self._begun = 0

    def places(self, episode: Int64[np.ndarray, " row"]) -> Int64[np.ndarray, " row"]:
        """Return how many rows of its episode lie before each row of the next part, whose episodes these are."""
        if not len(episode):
            return np.empty(0, np.int64)
        inner = np.flatnonzero(episode[1:] != episode[:-1]) + 1
        bounds = np.concatenate([[0], inner, [len(episode)]]).astype(np.int64)
        lengths = np.diff(bounds)
        places: Int64[np.ndarray, " row"] = np.arange(len(episode)) - np.repeat(bounds[:-1], lengths)
        if episode[0] == self._last:
            places[: lengths[0]] += self._begun
            lengths[0] += self._begun
        elif self._begun:
            self._known.append(np.array([self._begun]))
        self._known.append(lengths[:-1])
        self._last, self._begun = int(episode[-1]), int(lengths[-1])
        return places

    def all(self) -> Int64[np.ndarray, " episode"]:
        """Return the lengths of the episodes of all parts so far."""
        return np.concatenate([*self._known, np.array([self._begun] if self._begun else [], np.int64)])


def parts_of(transitions: Transitions | Iterable[Transitions]) -> Iterable[Transitions]:
    """Return transitions that are whole, or come in parts, as parts."""
    return [transitions] if isinstance(transitions, Transitions) else transitions


def episode_lengths(parts: Iterable[Transitions]) -> Int64[np.ndarray, " episode"]:
    """Return the lengths of the episodes of some transitions, which come in parts."""
    lengths = EpisodeLengths()
    for part in parts:
        for rows in IN_MEMORY.blocks(len(part)):
            lengths.places(part.episode[rows])
    return lengths.all()


def window_rows(transitions: Transitions, history: int, scratch: Scratch = IN_MEMORY) -> Int64[np.ndarray, " sample"]:
    """Return the rows whose episode holds at least `history` - 1 rows before them: the last rows of all windows."""
    lengths, found = EpisodeLengths(), scratch.array(len(transitions), torch.int64)
    count = 0
    for block in scratch.blocks(len(transitions)):
        rows = block.start + np.flatnonzero(lengths.places(transitions.episode[block]) >= history - 1)
        found[count : count + len(rows)] = rows
        count += len(rows)
    return found[:count]


def shorter_episodes(lengths: Int64[np.ndarray, " episode"], length: int) -> Dropped:
    """Count the episodes that have fewer rows than `length`, and these rows."""
    short = lengths[lengths < length]
    return Dropped(len(short), int(short.sum()))


def check_lengths(lengths: Int64[np.ndarray, " episode"], history: int) -> None:
    """Check that at least one of the episodes, if there are any, is long enough for a window.

    Raises:
        TransitionsError: none is; the message names how many they are and the longest.
    """
    if len(lengths) and lengths.max() < history:
        short = f"all {len(lengths)} episodes are" if len(lengths) > 1 else "the only episode is"
        longest = f"the longest has {lengths.max()}" if len(lengths) > 1 else f"it has {lengths.max()}"
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
