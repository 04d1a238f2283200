"""Swing the simulated pendulum to an angle by planning in the learned one.

Run it in the root of the repository after `make example`: `python -m examples.planning.pendulum`.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from jaxtyping import Float

from addressed_dynamics import CEM, MPPI, AddressedDynamics
from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.planning import Planner
from examples.pendulum.make_logs import TICK, integrate

NEAR = 0.05
"""So close to the target counts as there, in rad."""


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
    options = parser.parse_args()
    model = AddressedDynamics.load(options.models)
    print("| planner | target, rad | first there after, s | mean distance in the last second, rad |")
    print("| --- | ---: | ---: | ---: |")
    for target in (0.35, -0.2):

        def cost(states: np.ndarray, actions: np.ndarray, target: float = target) -> Float[np.ndarray, "plan step"]:
            squared: Float[np.ndarray, "plan step"] = (states[..., 0] - target) ** 2 + 0.001 * actions[..., 0] ** 2
            return squared

        for planner in (
            CEM(model, cost, horizon=20, samples=100, iterations=3, trust=0.001, penalty=4.0),
            MPPI(model, cost, horizon=20, samples=100, iterations=3, temperature=0.02, trust=0.001, penalty=4.0),
        ):
            distance = np.abs(episode(planner, 80, model.features.spaces.step_seconds) - target)
            there = f"{(np.argmax(distance < NEAR) + 1) * model.features.spaces.step_seconds:.2f}"
            found = there if (distance < NEAR).any() else "never"
            print(f"| {type(planner).__name__} | {target} | {found} | {distance[-20:].mean():.3f} |")


if __name__ == "__main__":
    try:
        main()
    except AddressedDynamicsError as error:
        sys.exit(f"error: {error}")
