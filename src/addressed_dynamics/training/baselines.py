"""What the ensemble is compared with: how each baseline is made to train as long as the ensemble does."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from addressed_dynamics.base.params.experiments import ExperimentParams, FeatureParams
from addressed_dynamics.base.params.training import AddressingTraining, BaselinesParams, EnsembleParams
from addressed_dynamics.training.ensemble import Binning
from addressed_dynamics.training.epochs import updates_per_epoch

ABLATIONS: dict[str, Binning] = {"unequal_bins": "lowest_loss", "random_bins": "random"}
"""The ensembles that are binned in another way, and how."""


PAIR = "pair"
"""Name of the ensemble of two that is trained for a figure alone, and is no baseline."""
OTHER_RECIPE = {"default": "paper_recipe", "paper": "default_recipe"}
"""Name of the ensemble with the recipe that was not chosen, by the one that was."""
ONCE = (PAIR, *OTHER_RECIPE.values())
"""What is trained from the first seed alone."""


@dataclass(frozen=True)
class Baseline:
    """Something that is trained beside the ensemble."""

    features: FeatureParams
    """What its networks are given and asked for."""
    ensemble: EnsembleParams
    """How they are trained: a single network is an ensemble of one."""
    binning: Binning
    """How samples get their member."""
    addressing: AddressingTraining | None
    """How the network that addresses them is trained; None if there is nothing to choose."""


def plan_baselines(
    chosen: ExperimentParams, other: ExperimentParams, inputs: int, outputs: int, samples: int
) -> dict[str, Baseline]:
    """Return all that is to be trained, by name; the longest trainings, of large single networks, first.

    Args:
        chosen: the experiment with the recipe of the ensemble.
        other: the experiment with the other recipe.
        inputs: inputs of the ensemble's networks.
        outputs: outputs of these.
        samples: number of training samples.
    """
    params, recipe = chosen.baselines, chosen.ensemble
    plan = dict[str, Baseline]()
    for name in (*params.single_networks, *params.train):
        if name == "other_recipe":
            plan[OTHER_RECIPE[chosen.recipe]] = Baseline(
                other.features, other.ensemble, "equal", other.baselines.addressing
            )
        elif name in ABLATIONS:
            plan[name] = Baseline(chosen.features, recipe, ABLATIONS[name], params.addressing)
        else:
            single = single_network_params(name, recipe, params, inputs, outputs, samples)
            plan[name] = Baseline(chosen.features, single, "equal", None)
    if params.pair_epochs:
        pair = recipe.model_copy(update={"members": 2, "epochs": params.pair_epochs, "restart": False})
        plan[PAIR] = Baseline(chosen.features, pair, "equal", None)
    return plan


def single_network_params(
    name: str, ensemble: EnsembleParams, baselines: BaselinesParams, inputs: int, outputs: int, samples: int
) -> EnsembleParams:
    """Return the training of a single network, as the training of an ensemble of one.

    It makes as many updates as the ensemble, rounded up to whole epochs (with a member's batch size its epochs are n
    times as long, so there are fewer of them).

    Args:
        name: one of `baselines.single_networks`, or `total_parameters`.
        ensemble: training of the ensemble.
        baselines: what params say of baselines.
        inputs: inputs of the network.
        outputs: its outputs.
        samples: number of training samples.
    """
    if name in baselines.single_networks:
        shape = dict(baselines.single_networks[name])
    else:
        shape = {"hidden": hidden_of_total_parameters(inputs, outputs, ensemble.hidden, ensemble.members)}
    return as_single(ensemble, shape, samples)


def as_single(ensemble: EnsembleParams, shape: Mapping[str, Any], samples: int) -> EnsembleParams:
    """Return the training of one network that makes as many updates as the ensemble, up to a whole epoch.

    Args:
        ensemble: training of the ensemble.
        shape: in what the network differs from a member.
        samples: number of training samples.
    """
    updates = ensemble.epochs * updates_per_epoch(samples, ensemble.members, ensemble.batch_size)
    single = ensemble.model_copy(update={"members": 1, "cluster_epochs": 1, "restart": False, **shape})
    epochs = math.ceil(updates / updates_per_epoch(samples, 1, single.batch_size))
    return single.model_copy(update={"epochs": epochs})


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
