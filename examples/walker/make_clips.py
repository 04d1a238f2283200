"""Make up motion capture: a walker of 31 joints that stands, walks, turns, jogs and runs, in the published files.

Each clip comes with its mirror image, as `.bvh` at 120 Hz, `.phase`, `.gait`, `_footsteps.txt` and `_gait.txt`.
"""

import argparse
from pathlib import Path

from addressed_dynamics.recording.walker import make_walker_clips


def main() -> None:
    """Write the clips."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "clips", help="folder of the clips")
    parser.add_argument("--minutes", type=float, default=3.0, help="length of all clips together, with their mirrors")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    make_walker_clips(options.out, seed=options.seed, minutes=options.minutes)


if __name__ == "__main__":
    main()
