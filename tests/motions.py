"""Made-up frames of motion for tests: random numbers of plausible size, in cycles of clips."""

import numpy as np

from addressed_dynamics.episodes.layout import INPUT, INPUT_HEIGHTS, OUTPUT
from addressed_dynamics.episodes.motion import Motion


def make_motion(rows: int = 96, *, clips: tuple[str, ...] = ("walk", "jog"), seed: int = 0) -> Motion:
    """Return `rows` frames of every clip on flat ground, whose outputs depend on their inputs and their phase."""
    generator = np.random.default_rng(seed)
    mixing = np.random.default_rng(0).normal(size=(8, INPUT.width)), np.random.default_rng(1).normal(size=(10, 311))
    parts = []
    for _ in clips:
        phase = (np.arange(rows) % 24) / 23
        hidden = generator.normal(size=(rows, 8))
        x = hidden @ mixing[0]
        x[:, INPUT_HEIGHTS] = 0.0
        angle = 2 * np.pi * phase
        y = np.column_stack([np.tanh(hidden), np.sin(angle), np.cos(angle)]) @ mixing[1]
        parts.append((x, y, phase, np.arange(rows), np.arange(rows) // 24))
    x, y, phase, frame, cycle = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    assert y.shape[1] == OUTPUT.width
    return Motion(
        x.astype(np.float32), y.astype(np.float32), phase.astype(np.float32), np.repeat(np.array(clips), rows),
        frame.astype(np.int64), cycle.astype(np.int64),
    )  # fmt: skip
