"""Trust beside latentplant's, a package for world models of plants: the same model, the same episodes, in one run.

latentplant (0.12.0, MIT) widens a rollout's own interval by a constant for each step and dimension (split conformal
prediction). It is no dependency: install it beside this package, or put it on PYTHONPATH. Both are given the rollouts
of the addressed ensemble, which has no intervals of its own: they are calibrated on validation episodes and judged on
test episodes.
"""

import argparse
import importlib.util
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from measuring import print_table

from addressed_dynamics.base.torch_runtime import prepare_torch
from addressed_dynamics.episodes.parquet import load_transitions
from addressed_dynamics.evaluation.transitions.calibration import Stretches, calibrate, follow, stretches
from addressed_dynamics.evaluation.transitions.candidates import (
    baseline_candidates,
    ensemble_candidates,
    load_ensembles,
)
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.trust_measures import break_even_steps, covered
from addressed_dynamics.evaluation.transitions.trusting import Pair, pair_of
from addressed_dynamics.simulators.delivery import ENSEMBLE, Choice

COVERAGES = (0.5, 0.9)
STARTS = 600
PEER = "latentplant"


def load(data: Path, name: str) -> tuple[Pair, dict[str, Points]]:
    """Return the delivered ensemble of an experiment with its second model, and the points of each split."""
    models = data / "models" / name
    ensembles, variants = load_ensembles(models)
    first = next(iter(ensembles))
    own = ensembles[first][variants[first]]
    candidates = [*ensemble_candidates(ensembles, variants), *baseline_candidates(models / "baselines", own)]
    pair = pair_of(candidates, Choice(ENSEMBLE, first, variants[first], "argmax"))
    if pair is None:
        raise SystemExit(f"{models}: there is no second model to hold the first against; train another seed")
    splits = ("train", "validation", "test")
    return pair, {
        each: Points.of(load_transitions(data / "tables" / name, split=each), own.features) for each in splits
    }


def whole(points: Points, steps: int, name: str) -> Stretches:
    """Return stretches that are all as long: the peer has no others."""
    found = stretches(points, steps, STARTS, name)
    long = torch.from_numpy(found.there[:, -1])
    if not long.any():
        raise SystemExit(f"no held-out episode has {steps} steps; ask for fewer with --steps")
    tensors = (found.history, found.actions, found.exogenous, found.states)
    rows = long.numpy()
    return Stretches(*(each[long] for each in tensors), found.there[rows], found.episode[rows])


def measure(data: Path, name: str, steps: int) -> dict[str, Any]:
    """Return what intervals of both cover and how wide they are, and their horizons."""
    from latentplant import imagination_gap
    from latentplant.calibrate import fit_conformal
    from latentplant.metrics.rollout import break_even_horizon, skill_vs_persistence
    from latentplant.models.base import Rollout

    pair, points = load(data, name)
    trust = calibrate(pair.model, pair.partner, points["train"], points["validation"], steps=steps)
    ways = {split: whole(points[split], steps, f"peers/{split}") for split in ("validation", "test")}
    followed = {
        split: follow(pair.model, pair.partner, trust.gauge, each.history, each.actions, each.exogenous)
        for split, each in ways.items()
    }
    scale = np.array(pair.model.features.scale)
    imagined = {split: Rollout(each.states.double().numpy()[None]) for split, each in followed.items()}
    truth = {split: each.states.double().numpy() for split, each in ways.items()}
    test, episode = followed["test"], ways["test"].episode
    rows = []
    for asked in COVERAGES:
        half = trust.half(test.scale, asked).double().numpy()
        widened = fit_conformal(imagined["validation"], truth["validation"], level=asked)
        ends = {"ours": (imagined["test"].mean - half, imagined["test"].mean + half)}
        ends[PEER] = widened.apply(imagined["test"])
        for step in sorted({1, min(10, steps), steps}):
            row = {"steps": step, "asked": asked}
            for whose, (low, high) in ends.items():
                found = covered(truth["test"][:, step - 1], low[:, step - 1], high[:, step - 1], episode)
                width = ((high - low)[:, step - 1] / scale / 2).mean(axis=1)
                row[whose] = {"covered": found.of_all, "error": found.error, "half_percent": 100 * float(width.mean())}
            rows.append(row)
    first = ways["test"].history.double().numpy().reshape(len(episode), -1, len(scale))
    skill = skill_vs_persistence(truth["test"], imagined["test"].mean, first, scale=scale)
    squared = ((truth["test"] - imagined["test"].mean) / scale) ** 2
    nothing = ((truth["test"] - first[:, -1:]) / scale) ** 2
    gaps = [
        imagination_gap(SimpleNamespace(imagined=Rollout(imagined["test"].samples[:, [row]])), truth["test"][row],
                        persistence_from=first[row], conformal=widened)
        for row in range(len(episode))
    ]  # fmt: skip
    inside = np.abs(imagined["test"].mean - truth["test"]) <= trust.half(test.scale, COVERAGES[-1]).double().numpy()
    return {
        "experiment": name,
        "steps": steps,
        "rollouts": len(episode),
        "episodes": len(np.unique(episode)),
        "intervals": rows,
        "break_even": {
            PEER: break_even_horizon(skill),
            "ours, of the same errors": break_even_steps(
                *(np.sqrt(each.mean(axis=(0, 2))) for each in (squared, nothing))
            ),
            "ours, of the median rollout": break_even_steps(
                *(np.median(np.sqrt(each.mean(axis=2)), axis=0) for each in (squared, nothing))
            ),
        },
        "imagination_gap": {
            "beats_doing_nothing": float(np.mean([each["beats_doing_nothing"] for each in gaps])),
            "realised_inside": {
                PEER: float(np.mean([each["realized_inside_calibrated_90_mean"] for each in gaps])),
                "ours": float(inside.mean()),
            },
        },
    }  # fmt: skip


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, default=Path("data"), help="models and tables of a finished run")
    parser.add_argument("--experiment", action="append", help="one of them; mountaincar and acrobot by default")
    parser.add_argument("--steps", type=int, default=100, help="of each rollout")
    parser.add_argument("--figures", type=Path, help="where the figures for docs/results.md go, as JSON")
    arguments = parser.parse_args()
    if importlib.util.find_spec(PEER) is None:
        print(f"{PEER} is not installed (pip install {PEER}==0.12.0, in an environment of its own): nothing to compare")
        return
    prepare_torch(threads=1)
    names = arguments.experiment or ["mountaincar", "acrobot"]
    if missing := [each for each in names if not (arguments.data / "models" / each).is_dir()]:
        print(f"{arguments.data / 'models'}: no models of {', '.join(missing)}; 'make run' trains them")
        return
    found = [measure(arguments.data, each, arguments.steps) for each in names]
    rows = [
        (f"{each['experiment']}, {row['steps']} steps, {row['asked']:.0%} asked",
         *(f"{row[whose]['covered']:.1%} ± {row[whose]['error'] or 0:.1%}, {row[whose]['half_percent']:.3g} %"
           for whose in ("ours", PEER)))
        for each in found
        for row in each["intervals"]
    ]  # fmt: skip
    print("Share that intervals cover on test episodes, and half of their width in % of the range.")
    print_table(("", "ours", PEER), rows)
    for each in found:
        print(
            f"{each['experiment']}: worse than no change after, steps: {each['break_even']}; {each['imagination_gap']}"
        )
    if arguments.figures:
        arguments.figures.write_text(json.dumps({"peers": found}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
