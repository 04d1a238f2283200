"""How an ensemble divides the samples among its members, and how sure its addressing is (Figs. 8 to 11)."""

from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.features.common.spool import IN_MEMORY, Scratch

LOSS_INTERVALS = 10
"""Intervals of the histogram of losses, as many as in Fig. 10."""
OUTPUT_INTERVALS = 20
"""Intervals of the histogram of the addressing network's outputs."""
LOWEST_QUANTILE = 0.001
"""The intervals of losses begin at this quantile: a few losses near 0 would stretch a logarithmic axis over nothing."""
SMALLEST_LOSS = 1e-30
"""The intervals of losses begin no lower, even if all losses are 0."""


def specialisation(
    losses: Float[Tensor, "member sample"], probabilities: Float[Tensor, "sample member"], scratch: Scratch = IN_MEMORY
) -> dict[str, Any]:
    """Count and average over the samples what Figs. 8 to 11 show of each member.

    Args:
        losses: loss of every sample under every member, of states scaled to [0, 1].
        probabilities: softmax of the addressing network's outputs; the highest selects a member.
        scratch: where a few numbers of each sample may lie.

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
    members, samples = _checked_shape(losses, probabilities)
    values = losses if losses.dtype == torch.float64 else losses.double()
    chosen = scratch.filled(samples, lambda rows: probabilities[rows].argmax(dim=1).numpy())
    counts = np.zeros((3, members), dtype=np.int64)
    output_edges = np.linspace(0.0, 1.0, OUTPUT_INTERVALS + 1)
    output_counts = np.zeros((members, OUTPUT_INTERVALS), dtype=np.int64)
    for rows in scratch.blocks(samples):
        _check_finite(losses[:, rows], probabilities[rows])
        best = losses[:, rows].argmin(dim=0).numpy()
        for row, each in zip(counts, (best, chosen[rows], best[best == chosen[rows]]), strict=True):
            row += np.bincount(each, minlength=members)
        output_counts += [_histogram(column, output_edges) for column in probabilities[rows].T.double().numpy()]
    lowest, addressed, agreed = counts
    own, stops = scratch.array(samples), np.cumsum(addressed)
    parts = [own[stop - size : stop] for stop, size in zip(stops, addressed, strict=True)]
    for member, part in enumerate(parts):
        part[:] = scratch.selected(values[member].numpy(), partial(_equal, chosen, member))
    loss_edges = _loss_edges(own, scratch)
    return {
        "samples": samples,
        "agreement": int(agreed.sum()) / samples,
        "lowest_loss": lowest.tolist(),
        "addressed": addressed.tolist(),
        "mean_loss": {
            "all": values.mean(dim=1).tolist(),
            "own": [float(part.mean()) if len(part) else None for part in parts],
        },
        "loss_edges": loss_edges.tolist(),
        "loss_counts": [
            sum(
                (_histogram(part[rows], loss_edges) for rows in scratch.blocks(len(part))),
                np.zeros(LOSS_INTERVALS, int),
            ).tolist()
            for part in parts
        ],
        "output_edges": output_edges.tolist(),
        "output_counts": output_counts.tolist(),
    }


def _checked_shape(losses: Tensor, probabilities: Tensor) -> tuple[int, int]:
    if not losses.numel() or tuple(probabilities.shape) != tuple(losses.T.shape):
        message = (
            "specialisation needs losses (member, sample) and probabilities (sample, member) of at least one sample, "
            f"but got shapes {tuple(losses.shape)} and {tuple(probabilities.shape)}"
        )
        raise EvaluationError(message)
    return losses.shape[0], losses.shape[1]


def _check_finite(losses: Tensor, probabilities: Tensor) -> None:
    if not (torch.isfinite(losses).all() and torch.isfinite(probabilities).all()):
        message = "a loss or an output of the addressing network is not finite: its training diverged"
        raise EvaluationError(message)


def _equal(chosen: Int64[np.ndarray, " sample"], member: int, rows: slice) -> Bool[np.ndarray, " sample"]:
    equal: Bool[np.ndarray, " sample"] = chosen[rows] == member
    return equal


def _loss_edges(own: Float64[np.ndarray, " sample"], scratch: Scratch) -> Float64[np.ndarray, " edge"]:
    positive = scratch.selected(own, lambda rows: own[rows] > SMALLEST_LOSS)
    low, high = (
        np.quantile(positive, (LOWEST_QUANTILE, 1.0), overwrite_input=True)
        if len(positive)
        else (SMALLEST_LOSS, SMALLEST_LOSS)
    )
    return np.geomspace(low, max(high, 2.0 * low), LOSS_INTERVALS + 1)


def _histogram(
    values: Float64[np.ndarray, " sample"], edges: Float64[np.ndarray, " edge"]
) -> Int64[np.ndarray, " bin"]:
    counts: Int64[np.ndarray, " bin"] = np.histogram(values.clip(edges[0], edges[-1]), bins=edges)[0]
    return counts
