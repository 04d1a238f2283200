"""Table 1 of the paper: how well each subnetwork serves the samples it is selected for, and what wrong choices cost."""

from typing import Any

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from addressed_dynamics.evaluation.transitions.one_step import summarise


def addressing_table(losses: Float[Tensor, "member sample"], chosen: Int64[Tensor, " sample"]) -> dict[str, Any]:
    """Return Table 1, the agreement with the best member, regret, and the confusion matrix.

    Args:
        losses: loss of every sample under every member, of states scaled to [0, 1].
        chosen: the member that the addressing network selects for each sample.

    Returns:
        For each member k: `share` of the samples for which it is selected; `selected` and `not_selected`: its mean
        loss on the samples for which it is selected and on the others (null if there are none); `misclassified`: the
        samples for which it is selected although another has a lower loss, per thousand of all samples and with the
        `median`, `mean` and `max` of their loss. Over all: `agreement` (share of samples whose selected member is the
        best), `misclassified_per_thousand`, `regret` (loss of the selected minus loss of the best member),
        `confusion` (rows: best member; columns: selected member; counts).
    """
    members, samples = losses.shape
    lowest, best = losses.min(dim=0)
    regret = losses.gather(0, chosen.unsqueeze(0)).squeeze(0) - lowest
    rows = []
    for member in range(members):
        own = chosen == member
        wrong = own & (best != member)
        rows.append(
            {
                "member": member,
                "share": float(own.double().mean()),
                "selected": _mean(losses[member][own]),
                "not_selected": _mean(losses[member][~own]),
                "misclassified": {
                    "per_thousand": 1000.0 * float(wrong.double().mean()),
                    **summarise(losses[member][wrong]),
                },
            }
        )
    confusion = torch.bincount(best * members + chosen, minlength=members**2).view(members, members)
    return {
        "samples": samples,
        "members": rows,
        "agreement": float((best == chosen).double().mean()),
        "misclassified_per_thousand": 1000.0 * float((best != chosen).double().mean()),
        "regret": summarise(regret),
        "confusion": confusion.tolist(),
    }


def _mean(values: Float[Tensor, " sample"]) -> float | None:
    return float(values.mean()) if len(values) else None
