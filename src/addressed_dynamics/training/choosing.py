"""`members: auto`: how many subnetworks there should be, by what brief trainings reach on validation samples."""

from __future__ import annotations

import math
from collections.abc import Mapping

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.params.training import AddressingTraining, EnsembleParams, EnsembleSection

NUMBERS = (1, 2, 4, 8)
"""How many subnetworks are tried."""
BRIEF_SHARE = 0.25
"""Share of the epochs that a brief training has."""
BRIEF_ADDRESSING = AddressingTraining(hidden=(64, 64), epochs=10)
"""How the subnetworks of a brief training are addressed: small, and the same whatever `addressing` says, which comes
after."""
ABOUT_AS_GOOD = 1.02
"""A loss that is no larger than so many times the lowest is about as good: seeds differ by as much."""


def brief(section: EnsembleSection, members: int) -> EnsembleParams:
    """Return how so many subnetworks are trained to be judged: as they would be, in fewer epochs."""
    epochs = max(math.ceil(BRIEF_SHARE * section.epochs), 1 + section.restart)
    clustering = min(section.cluster_epochs, max(epochs // 2, 1))
    update = {"epochs": epochs, "cluster_epochs": clustering}
    return section.with_members(members).model_copy(update=update)


def best_number(losses: Mapping[int, float]) -> int:
    """Return the smallest number of subnetworks whose loss is about as good as the lowest.

    Args:
        losses: by the number of subnetworks, the mean loss on validation samples of the one that is addressed. What is
            no number is no good.

    Raises:
        TrainingError: no loss is finite.
    """
    known = {number: loss for number, loss in losses.items() if math.isfinite(loss)}
    if not known:
        tried = ", ".join(map(str, losses))
        message = f"no brief training with {tried} subnetworks has a finite loss: lower the learning rate"
        raise TrainingError(message)
    lowest = min(known.values())
    return min(number for number, loss in known.items() if loss <= ABOUT_AS_GOOD * lowest)
