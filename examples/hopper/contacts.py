"""Say how large one-step errors are in the air, on the ground, and in the steps in which a contact begins or ends.

The state of the Hopper does not name contacts, but holds them: MuJoCo says which there are in a state. Run it in the
root of the repository after `make hopper`.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32

from addressed_dynamics import AddressedDynamics
from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.episodes.parquet import load_transitions
from addressed_dynamics.evaluation.transitions.candidates import (
    baseline_candidates,
    ensemble_candidates,
    load_ensembles,
)
from addressed_dynamics.evaluation.transitions.one_step import predict_all, scaled_losses
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.recording.environments import make_environment

SHOWN = ("ensemble/argmax", "ensemble/mixture", "same_size/", "total_parameters/", "linear/", "persistence/")
"""Beginnings of the names of candidates that have a line."""


def touching(states: Float32[np.ndarray, "sample observation"]) -> Bool[np.ndarray, " sample"]:
    """Return whether any part of the body touches the ground in these states.

    Raises:
        RecordingError: MuJoCo is not installed.
    """
    hopper: Any = make_environment(EnvironmentParams(id="Hopper-v5")).unwrapped
    import mujoco

    model, data = hopper.model, hopper.data
    found = np.zeros(len(states), dtype=np.bool_)
    positions = model.nq - 1
    for row, state in enumerate(states.astype(np.float64)):
        # Where it is does not matter, and is not in the state.
        data.qpos[:], data.qvel[:] = np.concatenate([[0.0], state[:positions]]), state[positions:]
        mujoco.mj_forward(model, data)
        found[row] = data.ncon > 0
    return found


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tables", type=Path, default=Path("data/tables/hopper"))
    parser.add_argument("--models", type=Path, default=Path("data/models/hopper"))
    parser.add_argument("--figures", type=Path, help="where the figures for docs/results.md go, as JSON")
    options = parser.parse_args()
    own = AddressedDynamics.load(options.models, candidate="ensemble")
    features = own.features
    points = Points.of(load_transitions(options.tables, split="test"), features)
    before, after = touching(points.observation), touching(points.next_observation)
    groups = {"in the air": ~before & ~after, "on the ground": before & after, "touching or leaving": before != after}
    print(
        "| one step, 10⁻⁵ | all | "
        + " | ".join(f"{name} ({group.mean():.0%})" for name, group in groups.items())
        + " |"
    )
    print("| --- |" + " ---: |" * (len(groups) + 1))
    found = dict[str, list[float]]()
    for candidate in [
        *ensemble_candidates(*load_ensembles(options.models)),
        *baseline_candidates(options.models / "baselines", own),
    ]:
        if candidate.name.startswith(SHOWN):
            losses = scaled_losses(predict_all(candidate.predictor, points), points, "mse").numpy()
            found[candidate.label] = [float(losses[group].mean()) for group in groups.values()]
            means = [losses.mean(), *found[candidate.label]]
            print(f"| {candidate.label} | " + " | ".join(f"{mean * 1e5:.3g}" for mean in means) + " |")
    if options.figures:
        shares = {name: float(group.mean()) for name, group in groups.items()}
        options.figures.write_text(json.dumps({"shares": shares, "candidates": found}), encoding="utf-8")


if __name__ == "__main__":
    try:
        main()
    except AddressedDynamicsError as error:
        sys.exit(f"error: {error}")
