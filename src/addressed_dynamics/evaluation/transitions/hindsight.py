"""What hindsight is worth: the best of several guesses, picked with knowledge of the truth.

The best of n guesses is better than each of them, however little the guesses know. So what the best member of each
point reaches bounds what addressing can, and is a feat of the members only as far as it lies below what as many random
guesses of the same spread reach.
"""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.suite import one_step_errors
from addressed_dynamics.simulators.addressed import AddressedDynamics

GUESSES_SEED = 0
"""Seed of the random guesses."""


def evaluate_oracle(model: AddressedDynamics, points: Points, loss: str) -> dict[str, Any]:
    """Return size and one-step errors of the ensemble with the best member picked in hindsight for every point."""
    return _best(f"hindsight over {_count(model)} (the members)", points.outputs(model), model, points, loss)


def evaluate_guesses(model: AddressedDynamics, points: Points, loss: str) -> dict[str, Any]:
    """Return the same with the best of as many random guesses as there are members."""
    return _best(
        f"hindsight over {_count(model, 'random ')}", random_guesses(points.outputs(model)), model, points, loss
    )


def random_guesses(outputs: Float[Tensor, "member point output"]) -> Float[Tensor, "member point output"]:
    """Return independent normal draws, as many as there are members, with their mean and covariance at every point.

    A draw is the members' mean plus their differences from it, each times a normal number of its own and divided by the
    root of the number of members. With one member there is no spread, and the guess is what it says. The draws are the
    same every time.
    """
    members, rows, _ = outputs.shape
    mean = outputs.mean(dim=0)
    generator = torch.Generator().manual_seed(GUESSES_SEED)
    weights = torch.randn(members, members, rows, generator=generator) / members**0.5
    return mean + torch.einsum("gmp,mpo->gpo", weights, outputs - mean)


def _best(
    label: str, guesses: Float[Tensor, "guess point output"], model: AddressedDynamics, points: Points, loss: str
) -> dict[str, Any]:
    observation, after = (torch.from_numpy(each) for each in (points.observation, points.next_observation))
    error = (guesses - model.features.encode_target(observation, after)).double()
    losses = (error.square() if loss == "mse" else error.abs()).mean(dim=-1)
    best = guesses[losses.argmin(dim=0), torch.arange(len(points))]
    return {
        "label": label,
        "parameters": model.ensemble.parameters_total,
        "multiply_adds": model.ensemble.multiply_adds(),
        "one_step": one_step_errors(model.features.decode(best, observation), points, loss),
    }


def _count(model: AddressedDynamics, kind: str = "") -> str:
    members = model.ensemble.members
    return f"{members} {kind}guesses" if members > 1 else f"one {kind}guess"
