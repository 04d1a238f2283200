"""Make transitions of a pendulum with a longer arm, on which the example's model should trust itself less.

In the root of the repository: `python -m examples.pendulum.longer_arm --out FOLDER` leaves logs of transitions there.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from addressed_dynamics.base.params.experiments import load_source_params
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.importing import import_logs
from addressed_dynamics.sources.transitions.reading import read_transitions
from examples.pendulum.make_logs import write_logs

ROOT = Path(__file__).parents[2]


def arm_transitions(
    length: float, folder: Path, *, episodes: int = 4, seconds: float = 20.0, seed: int = 1
) -> Transitions:
    """Return transitions of a pendulum whose arm has `length` (m), and leave their logs in `folder`.

    Everything else is as in the example (0.5 m): sensors, commands, and what its section of params.yaml makes of them.

    Args:
        length: of the arm, in m.
        folder: an empty one.
        episodes: in each of the three encodings.
        seconds: length of the longest episodes.
        seed: of the starts, the commands and the noise.
    """
    source = load_source_params(ROOT / "params.yaml", "pendulum", "transitions")
    with TemporaryDirectory() as raw:
        write_logs(Path(raw), episodes=episodes, seconds=seconds, seed=seed, length=length)
        here = source.model_copy(update={"files": (f"{raw}/*.mcap",)})
        import_logs(here, folder, name="pendulum", progress=lambda _: None)
    return read_transitions(folder)


def main() -> None:
    """Write the logs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of the logs of transitions")
    parser.add_argument("--length", type=float, default=0.7, help="length of the arm in m; the example's is 0.5 m")
    parser.add_argument("--episodes", type=int, default=4, help="episodes in each of the three encodings")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of the longest episodes")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    sizes = {"episodes": options.episodes, "seconds": options.seconds, "seed": options.seed}
    arm_transitions(options.length, options.out, **sizes)


if __name__ == "__main__":
    main()
