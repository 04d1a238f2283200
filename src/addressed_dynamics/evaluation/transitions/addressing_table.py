"""Table 1 of the paper: how well each subnetwork serves the samples it is selected for, and what wrong choices cost."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from addressed_dynamics.evaluation.transitions.one_step import summarise
from addressed_dynamics.features.common.spool import IN_MEMORY, Scratch


def addressing_table(
    losses: Float[Tensor, "member sample"], chosen: Int64[Tensor, " sample"], scratch: Scratch = IN_MEMORY
) -> dict[str, Any]:
    """Return Table 1, the agreement with the best member, regret, and the confusion matrix.

    Args:
        losses: loss of every sample under every member, of states scaled to [0, 1].
        chosen: the member that the addressing network selects for each sample.
        scratch: where a few numbers of each sample may lie.

    Returns:
        For each member k: `share` of the samples for which it is selected; `selected` and `not_selected`: its mean
        loss on the samples for which it is selected and on the others (null if there are none); `misclassified`: the
        samples for which it is selected although another has a lower loss, per thousand of all samples and with the
        `median`, `mean` and `max` of their loss. Over all: `agreement` (share of samples whose selected member is the
        best), `misclassified_per_thousand`, `regret` (loss of the selected minus loss of the best member),
        `confusion` (rows: best member; columns: selected member; counts).
    """
    members, samples = losses.shape
    values, selected = losses.numpy(), chosen.numpy()
    best = scratch.filled(samples, lambda rows: values[:, rows].argmin(axis=0))
    confusion = np.zeros((members, members), dtype=np.int64)
    for rows in scratch.blocks(samples):
        np.add.at(confusion, (best[rows], selected[rows]), 1)
    rows_of_table = [_of_member(values[member], selected, best, member, scratch) for member in range(members)]

    def regret(rows: slice) -> np.ndarray:
        lowest = values[:, rows].min(axis=0)
        found: np.ndarray = np.take_along_axis(values[:, rows], selected[None, rows], axis=0)[0] - lowest
        return found

    agreed = int(confusion.trace())
    return {
        "samples": samples,
        "members": rows_of_table,
        "agreement": agreed / samples,
        "misclassified_per_thousand": 1000.0 * ((samples - agreed) / samples),
        "regret": summarise(torch.from_numpy(scratch.filled(samples, regret)), scratch),
        "confusion": confusion.tolist(),
    }


def _of_member(
    losses: Float[np.ndarray, " sample"],
    chosen: Int64[np.ndarray, " sample"],
    best: Int64[np.ndarray, " sample"],
    member: int,
    scratch: Scratch,
) -> dict[str, Any]:
    """Return a row of the table; the losses are those under its member."""
    selected = torch.from_numpy(scratch.selected(losses, lambda rows: chosen[rows] == member))
    others = torch.from_numpy(scratch.selected(losses, lambda rows: chosen[rows] != member))
    wrong = torch.from_numpy(scratch.selected(losses, lambda rows: (chosen[rows] == member) & (best[rows] != member)))
    return {
        "member": member,
        "share": len(selected) / len(losses),
        "selected": _mean(selected),
        "not_selected": _mean(others),
        "misclassified": {"per_thousand": 1000.0 * (len(wrong) / len(losses)), **summarise(wrong, scratch)},
    }


def _mean(values: Float[Tensor, " sample"]) -> float | None:
    return float(values.mean()) if len(values) else None
