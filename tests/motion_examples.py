"""Made-up motion with the properties of real one, and databases of it with patches of terrain."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from addressed_dynamics.episodes.layout import INPUT, INPUT_HEIGHTS, OUTPUT
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.sources.motion.fingerprints import VERTICAL, Y_TERRAIN

JOINTS = ("joint_position", "joint_velocity")


def make_clip(name: str, lengths: Sequence[int], *, seed: int = 0, first_frame: int = 0) -> Motion:
    """Return cycles of so many rows, of random numbers; each begins with the frame that ended the one before it."""
    generator = np.random.default_rng(seed)
    frames = sum(lengths) - len(lengths) + 1
    x = generator.standard_normal((frames, INPUT.width)).astype(np.float32)
    y = generator.standard_normal((frames, OUTPUT.width)).astype(np.float32)
    x[:, INPUT_HEIGHTS] = 0.0
    for block in JOINTS:
        x[1:, INPUT[block]] = y[:-1, OUTPUT[block]]
    starts = np.cumsum([0, *(length - 1 for length in lengths[:-1])])
    rows = np.concatenate([np.arange(start, start + length) for start, length in zip(starts, lengths, strict=True)])
    phase = np.concatenate([np.linspace(0, 1, length, dtype=np.float32) for length in lengths])
    cycle = np.repeat(np.arange(len(lengths)), lengths)
    return Motion(x[rows], y[rows], phase, np.full(len(rows), name), rows + first_frame, cycle)


def concatenate(motions: Sequence[Motion]) -> Motion:
    """Return the motions, one after the other."""
    names = ("x", "y", "phase", "clip", "frame", "cycle")
    return Motion(**{name: np.concatenate([getattr(motion, name) for motion in motions]) for name in names})


def assert_same_motion(found: Motion, expected: Motion) -> None:
    for name in ("x", "y", "phase", "clip", "frame", "cycle"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


def on_patches(motion: Motion, patches: int, *, hilly: bool = False) -> tuple[Motion, np.ndarray[Any, Any]]:
    """Return every cycle once for each patch of terrain, and the patch of each row; flat patches are exact copies."""
    generator = np.random.default_rng(1)
    parts, numbers = [], []
    places = list(zip(motion.clip.tolist(), motion.cycle.tolist(), strict=True))
    for place in dict.fromkeys(places):
        cycle = motion.select(np.flatnonzero([each == place for each in places]))
        for patch in range(patches):
            copy = cycle.select(slice(None)) if not hilly else _on_hills(cycle, generator)
            parts.append(copy)
            numbers.append(np.full(len(copy), patch))
    return concatenate(parts), np.concatenate(numbers)


def _on_hills(cycle: Motion, generator: np.random.Generator) -> Motion:
    x, y = cycle.x.copy(), cycle.y.copy()
    height = generator.standard_normal((len(cycle), 1)).astype(np.float32)
    x[:, INPUT_HEIGHTS] = generator.standard_normal((len(cycle), 36))
    x[:, np.arange(INPUT.width)[INPUT.joint_position][VERTICAL]] -= height
    y[:, Y_TERRAIN] -= height
    return Motion(x, y, cycle.phase, cycle.clip, cycle.frame, cycle.cycle)


def arrays_of(motion: Motion, patch: np.ndarray[Any, Any] | None = None) -> dict[str, np.ndarray[Any, Any]]:
    """Return the arrays of a database of `motion`; with `meta` and `clips` if the patch of each row is given."""
    arrays: dict[str, np.ndarray[Any, Any]] = {"Xun": motion.x, "Yun": motion.y, "Pun": motion.phase}
    if patch is None:
        return arrays
    names = list(dict.fromkeys(motion.clip.tolist()))
    clip = np.array([names.index(name) for name in motion.clip.tolist()])
    meta = np.stack([clip, motion.frame, motion.cycle, patch], axis=1).astype(np.int32)
    return arrays | {"meta": meta, "clips": np.array(names)}


def save_database(
    path: Path, motion: Motion, patch: np.ndarray[Any, Any] | None = None, *, compressed: bool = False
) -> Path:
    """Write a database as anyone would, with NumPy."""
    # To mypy an array could be named as an option of NumPy's is.
    (np.savez_compressed if compressed else np.savez)(path, **arrays_of(motion, patch))  # type: ignore[arg-type]
    return path
