"""From transitions, which may come in parts, to the columns that samples are made of, and to the samples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.transitions import DiscreteAction, SpaceSpec, Transitions
from addressed_dynamics.features.common.samples import Samples, Windows
from addressed_dynamics.features.common.spool import Sink, release
from addressed_dynamics.features.transitions.courses import TransitionCourses
from addressed_dynamics.features.transitions.windows import EpisodeLengths, check_lengths

if TYPE_CHECKING:
    from addressed_dynamics.features.transitions.spec import FeatureSpec

EPISODES_AT_ONCE = 4096
"""Episodes whose rows are numbered together."""
MOST_ROWS = 2**31
"""Rows beyond which their numbers need 8 bytes."""


def bytes_per_row(spaces: SpaceSpec, *, courses: bool) -> int:
    """Return about how many bytes a transition takes as a sample."""
    states, action = len(spaces.observation), spaces.action
    actions = action.count if isinstance(action, DiscreteAction) else len(action.dimensions)
    floats = states + actions + len(spaces.exogenous) + states + (2 * states if courses else 0)
    return 4 * floats + 8 + 4 + 8 * (1 + courses)


def write_samples(
    features: FeatureSpec, parts: Iterable[Transitions], sink: Sink, *, courses: bool, rows: int = 0
) -> None:
    """Add the columns of the samples of some transitions to a sink: those that `samples_of` reads.

    Args:
        features: how networks see them.
        parts: the transitions, in parts, each of which may end inside an episode.
        sink: where the columns go.
        courses: whether networks are to go on from what they predict.
        rows: about how many rows there are, if they may be more than 2**31.

    Raises:
        ModelError: the transitions are of other spaces.
        TransitionsError: there are transitions, but no episode is as long as the history.
    """
    lengths, before, history = EpisodeLengths(), 0, features.history
    number = np.int32 if rows < MOST_ROWS else np.int64
    for part in parts:
        if part.spec != features.spaces:
            message = "the transitions' spaces are not those the features were made for"
            raise ModelError(message)
        place = lengths.places(part.episode)
        observation, following = torch.from_numpy(part.observation), torch.from_numpy(part.next_observation)
        frames = features.frames(observation, torch.from_numpy(part.action), torch.from_numpy(part.exogenous))
        chosen = np.flatnonzero(place >= history - 1)
        own = torch.from_numpy(chosen)
        columns = {
            "frames": frames.contiguous(),
            "y": features.encode_target(observation[own], following[own]),
            "episode": torch.from_numpy(part.episode)[own],
            "step": torch.from_numpy(part.step)[own],
        }
        if history > 1 or courses:
            columns["row"] = torch.from_numpy((chosen + before).astype(number))
        if courses:
            columns |= {"observation": observation, "next_observation": following}
        sink.add(**columns)
        before += len(part)
    known = lengths.all()
    check_lengths(known, history)
    sink.add(lengths=torch.from_numpy(known))
    if courses:
        sink.add(last=torch.empty(0, dtype=torch.from_numpy(np.empty(0, number)).dtype))
        ends = np.cumsum(known) - 1
        for first in range(0, len(known), EPISODES_AT_ONCE):
            some = slice(first, first + EPISODES_AT_ONCE)
            counts = np.maximum(known[some] - (history - 1), 0)
            sink.add(last=torch.from_numpy(np.repeat(ends[some], counts).astype(number)))


def samples_of(features: FeatureSpec, columns: Mapping[str, Tensor], *, courses: bool) -> Samples:
    """Return the samples that `write_samples` wrote the columns of."""
    frames, rows = columns["frames"], columns.get("row")
    x: Tensor | Windows = frames
    if features.history > 1:
        assert rows is not None
        x = Windows(frames, rows, features.constants.frame_weights)
    following = None
    if courses:
        assert rows is not None
        following = TransitionCourses(
            features, frames, columns["observation"], columns["next_observation"], rows, columns["last"]
        )
    samples = Samples(x, columns["y"], columns["episode"], columns["step"], following)
    release(*columns.values())
    return samples
