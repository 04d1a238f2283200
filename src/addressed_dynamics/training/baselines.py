"""What the ensemble is compared with: how each baseline is made to train as long as the ensemble does."""

import math

from addressed_dynamics.features.samples import Samples
from addressed_dynamics.params import BaselinesParams, EnsembleParams
from addressed_dynamics.training.ensemble import Binning
from addressed_dynamics.training.epochs import updates_per_epoch

ABLATIONS: dict[str, Binning] = {"unequal_bins": "lowest_loss", "random_bins": "random"}
"""The ensembles that are binned in another way, and how."""


def baseline_params(name: str, ensemble: EnsembleParams, baselines: BaselinesParams, train: Samples) -> EnsembleParams:
    """Return the training of baseline `name`, as the training of an ensemble.

    An ablation trains as the ensemble does, but for its bins. A single network is an ensemble of one; it makes as many
    updates as the ensemble, rounded up to whole epochs (with a member's batch size its epochs are n times as long, so
    there are fewer of them).

    Args:
        name: one of the baselines that params may name.
        ensemble: training of the ensemble.
        baselines: what params say of baselines.
        train: the training samples.
    """
    if name in ABLATIONS:
        return ensemble
    updates = ensemble.epochs * updates_per_epoch(len(train), ensemble.members, ensemble.batch_size)
    if name == "wide":
        hidden, batch_size = baselines.wide_hidden, baselines.wide_batch_size
    else:
        hidden = hidden_of_total_parameters(train.x.shape[1], train.y.shape[1], ensemble.hidden, ensemble.members)
        batch_size = ensemble.batch_size
    epochs = math.ceil(updates / updates_per_epoch(len(train), 1, batch_size))
    single = {"members": 1, "epochs": epochs, "cluster_epochs": 1, "hidden": hidden, "batch_size": batch_size}
    return ensemble.model_copy(update=single)


def hidden_of_total_parameters(inputs: int, outputs: int, hidden: tuple[int, ...], members: int) -> tuple[int, ...]:
    """Return hidden widths, in the proportions of `hidden`, of one network with as many parameters as the members."""

    def count(widths: tuple[int, ...]) -> int:
        layers = zip((inputs, *widths), (*widths, outputs), strict=True)
        return sum((width_in + 1) * width_out for width_in, width_out in layers)

    def stretched(percent: int) -> tuple[int, ...]:
        return tuple(max(1, round(width * percent / 100)) for width in hidden)

    wanted = members * count(hidden)
    candidates = [stretched(percent) for percent in range(100, 100 * members + 1)]
    return min(candidates, key=lambda widths: abs(count(widths) - wanted))
