"""Drive the true MountainCar by planning in the learned one. Run it in the root of the repository after `make run`."""

import argparse
import json
import sys
from pathlib import Path

import gymnasium
import numpy as np
from jaxtyping import Float

from addressed_dynamics import CEM, AddressedDynamics
from addressed_dynamics.base.errors import AddressedDynamicsError


def steps_to_the_goal(
    states: Float[np.ndarray, "plan step observation"],
    actions: np.ndarray,  # noqa: ARG001 - no action costs more than another
) -> Float[np.ndarray, " plan"]:
    """Return the steps before the position is 0.5 m, or all of them and more the farther it stays away."""
    farthest = np.maximum.accumulate(states[..., 0].clip(max=0.5), axis=1)
    missing: Float[np.ndarray, " plan"] = (farthest < 0.5).sum(axis=1) + 100 * (0.5 - farthest[:, -1])
    return missing


def main() -> None:
    """Print the return of each episode and their mean."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", type=Path, default=Path("data/models/mountaincar"))
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--figures", type=Path, help="where the figures for docs/results.md go, as JSON")
    options = parser.parse_args()
    model = AddressedDynamics.load(options.models)
    planner = CEM(model, steps_to_the_goal, horizon=120, hold=5, samples=100, iterations=3)
    env = gymnasium.make("MountainCar-v0")
    returns = []
    for episode in range(options.episodes):
        state, total, over = env.reset(seed=episode)[0], 0.0, False
        planner.reset(seed=episode)
        while not over:
            state, reward, terminated, truncated, _ = env.step(planner.command(state))
            total, over = total + float(reward), terminated or truncated
        returns.append(total)
        print(f"episode {episode}: {total:.0f}", flush=True)
    print(f"mean of {len(returns)}: {np.mean(returns):.1f} (solved: above -110)")
    if options.figures:
        options.figures.write_text(json.dumps({"candidate": None, "returns": returns}), encoding="utf-8")


if __name__ == "__main__":
    try:
        main()
    except AddressedDynamicsError as error:
        sys.exit(f"error: {error}")
