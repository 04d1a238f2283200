"""Make transitions of a pendulum with a longer arm, on which the example's model should trust itself less.

In the root of the repository: `python -m examples.pendulum.longer_arm --out FOLDER` leaves logs of transitions there.
After `make example`, `--figures docs/figures/longer-arm.json` measures how well the scores of the delivered model tell
bad rollouts from good ones, with them among those of the usual arm.
"""

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from addressed_dynamics.base.errors import AddressedDynamicsError, EvaluationError
from addressed_dynamics.base.params.experiments import load_experiment, load_source_params
from addressed_dynamics.episodes.parquet import load_transitions
from addressed_dynamics.episodes.splits import Split
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.evaluation.transitions.calibration import calibrate, reachable
from addressed_dynamics.evaluation.transitions.candidates import (
    baseline_candidates,
    ensemble_candidates,
    load_ensembles,
)
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.trusting import judge_trust, pair_of
from addressed_dynamics.importing import import_logs
from addressed_dynamics.simulators.delivery import read_delivered
from addressed_dynamics.sources.transitions.params import ShiftParams
from addressed_dynamics.sources.transitions.reading import read_transitions
from examples.pendulum.make_logs import write_logs

ROOT = Path(__file__).parents[2]
USUAL = 0.5
"""Length of the example's arm, in m."""
SPLITS: tuple[Split, ...] = ("train", "validation", "test")


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


def auroc(longer: Transitions, tables: Path, models: Path) -> Mapping[str, float | None]:
    """Return how well each score of the delivered model tells bad rollouts from good ones, as the evaluation judges it.

    Args:
        longer: transitions with the longer arm.
        tables: those of the example.
        models: its models.

    Raises:
        AddressedDynamicsError: the example was not run, or a file of it is damaged.
    """
    ensembles, chosen = load_ensembles(models)
    first = next(iter(ensembles))
    model = ensembles[first][chosen[first]]
    candidates = [*ensemble_candidates(ensembles, chosen), *baseline_candidates(models / "baselines", model)]
    pair = pair_of(candidates, read_delivered(models).choice)
    if pair is None:
        message = f"{models}: no second model was trained that could be held against one; train a second seed"
        raise EvaluationError(message)
    points = {split: Points.of(load_transitions(tables, split=split), model.features) for split in SPLITS}
    params = load_experiment(ROOT / "params.yaml", "pendulum", "transitions").evaluation
    steps = reachable(points["validation"], params.rollouts.steps)
    trust = calibrate(pair.model, pair.partner, points["train"], points["validation"], steps=steps)
    shift = ShiftParams.model_construct(name="longer_arm", kind="mechanics")
    record, _ = judge_trust(pair, trust, points, {shift.name: longer}, [shift], {})
    found: Mapping[str, float | None] = record["shifts"][shift.name]["auroc"]
    return found


def main() -> None:
    """Write the logs, and what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of the logs of transitions")
    parser.add_argument("--length", type=float, default=0.7, help=f"length of the arm in m; the example's is {USUAL} m")
    parser.add_argument("--episodes", type=int, default=4, help="episodes in each of the three encodings")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of the longest episodes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--tables", type=Path, default=Path("data/tables/pendulum"))
    parser.add_argument("--models", type=Path, default=Path("data/models/pendulum"))
    parser.add_argument("--figures", type=Path, help="where the figures for docs/results.md go, as JSON")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    sizes = {"episodes": options.episodes, "seconds": options.seconds, "seed": options.seed}
    longer = arm_transitions(options.length, options.out, **sizes)
    if options.figures:
        scores = auroc(longer, options.tables, options.models)
        found = {"length": options.length, "usual": USUAL, "auroc": dict(scores)}
        options.figures.write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    try:
        main()
    except AddressedDynamicsError as error:
        sys.exit(f"error: {error}")
