"""Swing the true Acrobot up by planning in the learned one. Run it in the root of the repository after `make run`."""

import argparse
import json
import sys
from pathlib import Path

import gymnasium
import numpy as np
from jaxtyping import Float

from addressed_dynamics import CEM, AddressedDynamics
from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.envs import ACROBOT
from addressed_dynamics.planning import Planner

NO_TORQUE = 1
"""Action while the model has not yet seen as many frames as it predicts from."""


def steps_to_the_goal(
    states: Float[np.ndarray, "plan step observation"],
    actions: np.ndarray,  # noqa: ARG001 - no action costs more than another
) -> Float[np.ndarray, " plan"]:
    """Return the steps before the tip is 1 m above the axis, or all of them and more the farther it stays below."""
    cosine_1, sine_1, cosine_2, sine_2 = np.moveaxis(states[..., :4], -1, 0)
    height = -cosine_1 - (cosine_1 * cosine_2 - sine_1 * sine_2)
    highest = np.maximum.accumulate(height, axis=1)
    missing: Float[np.ndarray, " plan"] = (highest <= 1.0).sum(axis=1) + 100.0 * np.maximum(1.0 - highest[:, -1], 0.0)
    return missing


def act(planner: Planner, state: Float[np.ndarray, " observation"]) -> int | np.ndarray:
    """Return what to do, which is nothing until the planner has seen enough frames."""
    if planner.missing:
        planner.observe(state, NO_TORQUE)
        return NO_TORQUE
    return planner.command(state)


def main() -> None:
    """Print the return of each episode and their mean."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", type=Path, default=Path("data/models/acrobot"))
    parser.add_argument("--candidate", help="a faster model than the one that is delivered, for instance relu_256")
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--figures", type=Path, help="where the figures for docs/results.md go, as JSON")
    options = parser.parse_args()
    model = AddressedDynamics.load(options.models, candidate=options.candidate)
    planner = CEM(model, steps_to_the_goal, horizon=200, hold=20, samples=60, iterations=2)
    env = gymnasium.make(ACROBOT)
    returns = []
    for episode in range(options.episodes):
        state, total, over = env.reset(seed=episode)[0], 0.0, False
        planner.reset(seed=episode)
        while not over:
            state, reward, terminated, truncated, _ = env.step(act(planner, state))
            total, over = total + float(reward), terminated or truncated
        returns.append(total)
        print(f"episode {episode}: {total:.0f}", flush=True)
    print(f"mean of {len(returns)}: {np.mean(returns):.1f} (solved: above -1000, which is -100 of Acrobot-v1's steps)")
    if options.figures:
        found = {"candidate": options.candidate, "returns": returns}
        options.figures.write_text(json.dumps(found), encoding="utf-8")


if __name__ == "__main__":
    try:
        main()
    except AddressedDynamicsError as error:
        sys.exit(f"error: {error}")
