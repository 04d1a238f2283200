"""People of 31 joints in a report: their motion, and what all pictures of it have in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.episodes.layout import JOINTS
from addressed_dynamics.reporting.common.figures.style import ACTION, OWN, REACHED

BODIES = (OWN, "#5a5a5a")
"""Colour of the first person and of the second one."""
ASKED, TOUCHED = ACTION, REACHED
"""Colour of the command, and of what touches the ground."""
ARROW_FRAMES = 24
"""The command's arrow ends where one who obeys is after so many frames."""
CONTACT_JOINTS = [JOINTS.index(joint) for joint in ("LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase")]
"""The joints of `layout.CONTACTS`."""


@dataclass(frozen=True)
class Actor:
    """One person over time, at `layout.FRAME_RATE`."""

    title: str
    """Who moves it, for instance `addressed ensemble`."""
    positions: Float[np.ndarray, "time 31 3"]
    """Where the joints of `layout.SKELETON` are in the world, in cm, y upwards."""
    contacts: Float[np.ndarray, "time 4"] | None = None
    """Probability that each of `layout.CONTACTS` touches the ground; None if it is not known."""

    def touching(self) -> Bool[np.ndarray, "time 4"]:
        """Return which of `layout.CONTACTS` are more likely than not to touch the ground."""
        touching: Bool[np.ndarray, "time 4"] = (
            np.zeros((len(self.positions), 4), dtype=np.bool_) if self.contacts is None else self.contacts > 0.5
        )
        return touching


def check_actors(actors: Sequence[Actor], commands: Float[np.ndarray, "time 2"] | None) -> None:
    """Check that one or two people, and what they are told, can be shown side by side.

    Raises:
        ReportError: there are no actors or more than two, they differ in length or share a title, or a position is not
            finite.
    """
    lengths = {len(actor.positions) for actor in actors} | ({len(commands)} if commands is not None else set())
    if len(actors) not in (1, 2) or len(lengths) != 1 or 0 in lengths:
        message = (
            f"motion is shown of one or two actors, with commands of the same length, but there are {len(actors)} "
            f"actors and lengths {', '.join(str(length) for length in sorted(lengths))}"
        )
        raise ReportError(message)
    if len({actor.title for actor in actors}) < len(actors):
        message = f"both actors are called '{actors[0].title}': give each a title of its own"
        raise ReportError(message)
    for actor in actors:
        if actor.positions.shape[1:] != (len(JOINTS), 3) or not np.isfinite(actor.positions).all():
            message = (
                f"'{actor.title}': expected finite positions of shape (time, {len(JOINTS)}, 3), but found shape "
                f"{actor.positions.shape}, or a value that is not finite: show it until the motion ends"
            )
            raise ReportError(message)


def facing(positions: Float[np.ndarray, "*time 31 3"]) -> Float64[np.ndarray, "*time"]:
    """Return where someone faces, from z towards x, in rad: perpendicular to the line through the hips."""
    across = positions[..., JOINTS.index("LeftUpLeg"), :] - positions[..., JOINTS.index("RightUpLeg"), :]
    angle: Float64[np.ndarray, "*time"] = np.arctan2(-across[..., 2], across[..., 0])
    return angle
