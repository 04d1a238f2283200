"""Import of a motion clip, against a naive extraction that goes frame by frame."""

import sys
import tempfile
from pathlib import Path

from measuring import median_ratio, print_table, take_turns

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # the naive extraction is the oracle of a test

from motion_clips import write_clip
from naive_motion import read_naively

from addressed_dynamics.sources.motion.clips import read_clip

FRAMES = 2_400
ROUNDS = 3


def main() -> None:
    """Print frames per second at 60 Hz, and the ratio."""
    footsteps = "".join(f"{frame} {frame + 40}\n" for frame in range(130, FRAMES, 90))
    with tempfile.TemporaryDirectory() as folder:
        clip = write_clip(Path(folder), frames=FRAMES, footsteps=footsteps)
        contestants = {"import": lambda: read_clip(clip), "naive": lambda: read_naively(clip)}
        seconds = take_turns(contestants, rounds=ROUNDS)
    rates = {name: FRAMES / 2 / min(each.wall) for name, each in seconds.items()}
    ratio = median_ratio(seconds["naive"].wall, seconds["import"].wall)
    print_table(
        ["clip", "import, frames/s", "naive, frames/s", "faster by"],
        [[f"{FRAMES:,} frames at 120 Hz", f"{rates['import']:,.0f}", f"{rates['naive']:,.0f}", f"{ratio:.0f}x"]],
    )


if __name__ == "__main__":
    main()
