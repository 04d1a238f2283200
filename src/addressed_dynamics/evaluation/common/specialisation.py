"""How an ensemble divides the samples among its members, and how sure its addressing is (Figs. 8 to 11)."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from addressed_dynamics.base.errors import EvaluationError

LOSS_INTERVALS = 10
"""Intervals of the histogram of losses, as many as in Fig. 10."""
OUTPUT_INTERVALS = 20
"""Intervals of the histogram of the addressing network's outputs."""
LOWEST_QUANTILE = 0.001
"""The intervals of losses begin at this quantile: a few losses near 0 would stretch a logarithmic axis over nothing."""
SMALLEST_LOSS = 1e-30
"""The intervals of losses begin no lower, even if all losses are 0."""


def specialisation(
    losses: Float[Tensor, "member sample"], probabilities: Float[Tensor, "sample member"]
) -> dict[str, Any]:
    """Count and average over the samples what Figs. 8 to 11 show of each member.

    Args:
        losses: loss of every sample under every member, of states scaled to [0, 1].
        probabilities: softmax of the addressing network's outputs; the highest selects a member.

    Returns:
        `samples`; `agreement`: share of the samples whose selected member has the lowest loss; `lowest_loss` and
        `addressed`: for each member, the samples on which it has the lowest loss and those for which it is selected
        (Fig. 8); `mean_loss`: for each member its mean loss over `all` samples and over its `own`, those for which it
        is selected, null if there are none (Fig. 9); `loss_edges` and `loss_counts`: bounds of ten intervals, equally
        wide on a logarithmic scale, and how many of each member's own losses fall into each; the first and the last
        take what lies beyond (Fig. 10); `output_edges` and `output_counts`: the same for the probabilities of each
        member over all samples, in twenty intervals of [0, 1] (Fig. 11).

    Raises:
        EvaluationError: there are no samples, the shapes do not fit each other, or a number is not finite.
    """
    _check(losses, probabilities)
    members, samples = losses.shape
    chosen, best = probabilities.argmax(dim=1), losses.argmin(dim=0)
    own = [losses[member][chosen == member].double().numpy() for member in range(members)]
    loss_edges = _loss_edges(np.concatenate(own))
    output_edges = np.linspace(0.0, 1.0, OUTPUT_INTERVALS + 1)
    return {
        "samples": samples,
        "agreement": float((best == chosen).double().mean()),
        "lowest_loss": _counts(best, members),
        "addressed": _counts(chosen, members),
        "mean_loss": {
            "all": losses.double().mean(dim=1).tolist(),
            "own": [float(values.mean()) if len(values) else None for values in own],
        },
        "loss_edges": loss_edges.tolist(),
        "loss_counts": [_histogram(values, loss_edges) for values in own],
        "output_edges": output_edges.tolist(),
        "output_counts": [_histogram(column, output_edges) for column in probabilities.T.double().numpy()],
    }


def _check(losses: Tensor, probabilities: Tensor) -> None:
    if not losses.numel() or tuple(probabilities.shape) != tuple(losses.T.shape):
        message = (
            "specialisation needs losses (member, sample) and probabilities (sample, member) of at least one sample, "
            f"but got shapes {tuple(losses.shape)} and {tuple(probabilities.shape)}"
        )
        raise EvaluationError(message)
    if not (torch.isfinite(losses).all() and torch.isfinite(probabilities).all()):
        message = "a loss or an output of the addressing network is not finite: its training diverged"
        raise EvaluationError(message)


def _counts(members: Int64[Tensor, " sample"], number: int) -> list[int]:
    return [int(count) for count in torch.bincount(members, minlength=number)]


def _loss_edges(own: Float64[np.ndarray, " sample"]) -> Float64[np.ndarray, " edge"]:
    positive = own[own > SMALLEST_LOSS]
    low, high = np.quantile(positive, (LOWEST_QUANTILE, 1.0)) if len(positive) else (SMALLEST_LOSS, SMALLEST_LOSS)
    return np.geomspace(low, max(high, 2.0 * low), LOSS_INTERVALS + 1)


def _histogram(values: Float64[np.ndarray, " sample"], edges: Float64[np.ndarray, " edge"]) -> list[int]:
    counts, _ = np.histogram(values.clip(edges[0], edges[-1]), bins=edges)
    return [int(count) for count in counts]
