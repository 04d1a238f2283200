"""What hindsight is worth: the best of several guesses, picked with knowledge of the truth.

The best of n guesses is better than each of them, however little the guesses know. So what the best member of each
point reaches bounds what addressing can, and is a feat of the members only as far as it lies below what as many random
guesses of the same spread reach.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.suite import one_step_errors
from addressed_dynamics.features.common.spool import IN_MEMORY, Scratch
from addressed_dynamics.simulators.addressed import AddressedDynamics

GUESSES_SEED = 0
"""Seed of the random guesses."""


def evaluate_oracle(model: AddressedDynamics, points: Points, loss: str) -> dict[str, Any]:
    """Return size and one-step errors of the ensemble with the best member picked in hindsight for every point."""
    outputs = points.outputs(model)
    return _best(f"hindsight over {_count(model)} (the members)", lambda rows: outputs[:, rows], model, points, loss)


def evaluate_guesses(model: AddressedDynamics, points: Points, loss: str) -> dict[str, Any]:
    """Return the same with the best of as many random guesses as there are members."""
    guesses = random_guesses(points.outputs(model), points.scratch)
    return _best(f"hindsight over {_count(model, 'random ')}", guesses, model, points, loss)


def random_guesses(
    outputs: Float[Tensor, "member point output"], scratch: Scratch = IN_MEMORY
) -> Callable[[slice], Float[Tensor, "member chosen output"]]:
    """Return independent normal draws, as many as there are members, with their mean and covariance at every point.

    A draw is the members' mean plus their differences from it, each times a normal number of its own and divided by the
    root of the number of members. With one member there is no spread, and the guess is what it says. The draws are the
    same every time, whichever points are asked for.

    Args:
        outputs: of the members.
        scratch: where the numbers that are drawn lie.

    Returns:
        A function that takes the numbers of consecutive points.
    """
    members, rows, _ = outputs.shape
    drawn = scratch((members, members, rows)).normal_(generator=torch.Generator().manual_seed(GUESSES_SEED))

    def guesses(chosen: slice) -> Tensor:
        own = outputs[:, chosen]
        mean = own.mean(dim=0)
        return mean + torch.einsum("gmp,mpo->gpo", drawn[..., chosen] / members**0.5, own - mean)

    return guesses


def _best(
    label: str, guesses: Callable[[slice], Tensor], model: AddressedDynamics, points: Points, loss: str
) -> dict[str, Any]:
    def best(rows: slice) -> Tensor:
        guessed = guesses(rows)
        error = (guessed - points.targets(model, rows)).double()
        losses = (error.square() if loss == "mse" else error.abs()).mean(dim=-1)
        chosen = guessed[losses.argmin(dim=0), torch.arange(guessed.shape[1])]
        return model.features.decode(chosen, torch.from_numpy(points.observation[rows]))

    return {
        "label": label,
        "parameters": model.ensemble.parameters_total,
        "multiply_adds": model.ensemble.multiply_adds(),
        "one_step": one_step_errors(points.each(best), points, loss),
    }


def _count(model: AddressedDynamics, kind: str = "") -> str:
    members = model.ensemble.members
    return f"{members} {kind}guesses" if members > 1 else f"one {kind}guess"
