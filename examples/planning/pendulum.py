"""Swing the simulated pendulum to an angle by planning in the learned one.

Run it in the root of the repository after `make example`: `python -m examples.planning.pendulum`.
"""

import argparse
import json
import sys
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from addressed_dynamics import CEM, MPPI, AddressedDynamics
from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.planning import Cost, Planner
from examples.pendulum.make_logs import TICK, integrate

TRUST = 0.001
"""Least trust in a step of a plan that is believed."""
NEAR = 0.05
"""So close to the target counts as there, in rad."""


def staying(target: float) -> Cost:
    """Return the cost of angles (rad) away from the target, and a little of torques."""

    def cost(states: np.ndarray, actions: np.ndarray) -> Float[np.ndarray, "plan step"]:
        squared: Float[np.ndarray, "plan step"] = (states[..., 0] - target) ** 2 + 0.001 * actions[..., 0] ** 2
        return squared

    return cost


def reaching(target: float) -> Cost:
    """Return the cost of never coming near the target (rad), and a little of the steps until then."""

    def cost(states: np.ndarray, actions: np.ndarray) -> Float[np.ndarray, " plan"]:  # noqa: ARG001 - torques cost nothing
        distance = np.abs(states[..., 0] - target)
        nearest: Float[np.ndarray, " plan"] = distance.min(axis=1) + 0.001 * distance.argmin(axis=1)
        return nearest

    return cost


def episode(planner: Planner, steps: int, step_seconds: float) -> Float[np.ndarray, " step"]:
    """Return the angles (rad) at which the planner's torques bring the pendulum, which first hangs at rest."""
    ticks = round(step_seconds / TICK)
    torques, states = np.empty((0, 1)), np.zeros((1, 2))
    for _ in range(steps):
        if planner.missing:
            action: int | np.ndarray = np.zeros(1)
            planner.observe(states[-1], action)
        else:
            action = planner.command(states[-1])
        torques = np.concatenate([torques, np.full((ticks, 1), action)])
        states = integrate(torques, np.zeros(1))[::ticks, :, 0]
    return states[1:, 0]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", type=Path, default=Path("data/models/pendulum"))
    parser.add_argument("--figures", type=Path, help="where the figures for docs/results.md go, as JSON")
    options = parser.parse_args()
    model = AddressedDynamics.load(options.models)
    seconds = model.features.spaces.step_seconds
    cem = partial(CEM, model, samples=100, iterations=3)
    mppi = partial(MPPI, model, iterations=2, temperature=0.02)
    doubting = partial(cem, trust=TRUST, penalty=4.0)
    tasks = {
        "stay at 0.35 rad, CEM": (0.35, doubting(staying(0.35), horizon=20)),
        "stay at 0.35 rad, MPPI": (0.35, mppi(staying(0.35), horizon=20, trust=TRUST, penalty=4.0)),
        "stay at −0.2 rad, CEM": (-0.2, doubting(staying(-0.2), horizon=20)),
        "stay at −0.2 rad, MPPI": (-0.2, mppi(staying(-0.2), horizon=20, trust=TRUST, penalty=4.0)),
        "swing up to 1.2 rad, CEM that believes all": (1.2, cem(reaching(1.2), horizon=40, hold=2)),
        "swing up to 1.2 rad, CEM": (1.2, doubting(reaching(1.2), horizon=40, hold=2)),
    }
    print("| task | nearest, rad | there after, s | mean distance in the last second, rad |")
    print("| --- | ---: | ---: | ---: |")
    found = dict[str, dict[str, float | None]]()
    for name, (target, planner) in tasks.items():
        distance = np.abs(episode(planner, 80, seconds) - target)
        there = float(np.argmax(distance < NEAR) + 1) * seconds if (distance < NEAR).any() else None
        kept = float(distance[-20:].mean()) if name.startswith("stay") else None
        found[name] = {"nearest": float(distance.min()), "there": there, "kept": kept}
        when, where = "never" if there is None else f"{there:.2f}", "–" if kept is None else f"{kept:.3f}"
        print(f"| {name} | {distance.min():.3f} | {when} | {where} |", flush=True)
    if options.figures:
        options.figures.write_text(json.dumps({"trust": TRUST, "tasks": found}), encoding="utf-8")


if __name__ == "__main__":
    try:
        main()
    except AddressedDynamicsError as error:
        sys.exit(f"error: {error}")
