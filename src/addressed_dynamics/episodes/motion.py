"""THE CONTRACT of motion capture: frames of clips with their inputs, outputs and phase."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int64, Shaped

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.layout import INPUT, OUTPUT


@dataclass(frozen=True)
class Motion:
    """Frames of motion clips, one row a frame, in the order clip, cycle, frame. Validated on construction."""

    x: Float32[np.ndarray, "row 342"]
    """What a network is given, in the units and order of `layout.INPUT`; not normalised."""
    y: Float32[np.ndarray, "row 311"]
    """What it should answer, in the units and order of `layout.OUTPUT`; not normalised."""
    phase: Float32[np.ndarray, " row"]
    """Phase of the gait cycle, in [0, 1]; 0 at its first frame and 1 at its last."""
    clip: Shaped[np.ndarray, " row"]
    """Name of the clip that the row is from."""
    frame: Int64[np.ndarray, " row"]
    """Frame in the clip, at 60 Hz, from 0. The last frame of a cycle is the first of the next and occurs in both."""
    cycle: Int64[np.ndarray, " row"]
    """Gait cycle in the clip, from 0."""

    def __post_init__(self) -> None:
        """Check shapes and values.

        Raises:
            MotionError: a shape is wrong, a value is not finite, or a phase is outside [0, 1].
        """
        rows = len(self.phase)
        for name, width in {"x": INPUT.width, "y": OUTPUT.width}.items():
            if getattr(self, name).shape != (rows, width):
                message = f"{name} should have shape ({rows}, {width}), but has {getattr(self, name).shape}"
                raise MotionError(message)
        for name in ("phase", "clip", "frame", "cycle"):
            if getattr(self, name).shape != (rows,):
                message = f"{name} should have shape ({rows},), but has {getattr(self, name).shape}"
                raise MotionError(message)
        for name in ("x", "y", "phase"):
            values = getattr(self, name)
            finite = np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
            if not finite.all():
                message = f"{name} holds a value that is not finite, first in row {int(np.flatnonzero(~finite)[0])}"
                raise MotionError(message)
        if rows and not (self.phase.min() >= 0 and self.phase.max() <= 1):
            message = f"phases should lie in [0, 1], but lie in [{self.phase.min():g}, {self.phase.max():g}]"
            raise MotionError(message)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.phase)

    def select(self, rows: Bool[np.ndarray, " row"] | Int64[np.ndarray, " selected"] | slice) -> Motion:
        """Return some of the rows."""
        return Motion(self.x[rows], self.y[rows], self.phase[rows], self.clip[rows], self.frame[rows], self.cycle[rows])
