"""What the ensemble is compared with: how each baseline is made to train exactly as long as the ensemble does.

As long is as many updates: the ensemble's total number, all of them counted, also those before a restart, which only
found the bins. An update is a batch for every network, so an ensemble sees n times as many samples in it as a single
network of the same batch size; reports show both, and the multiply-adds.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.params.training import (
    AddressingTraining,
    BaselinesParams,
    BlendedNetwork,
    BlendedTraining,
    EnsembleParams,
    EnsembleSection,
)
from addressed_dynamics.training.addressing import untrained_addressing
from addressed_dynamics.training.ensemble import Binning
from addressed_dynamics.training.epochs import updates_per_epoch

ABLATIONS: dict[str, Binning] = {"unequal_bins": "lowest_loss", "random_bins": "random"}
"""The ensembles that are binned in another way, and how."""


PAIR = "pair"
"""Name of the ensemble of two that is trained for a figure alone, and is no baseline."""
OTHER_RECIPE = {"default": "paper_recipe", "paper": "default_recipe"}
"""Name of the ensemble with the recipe that was not chosen, by the one that was."""
BLENDED = ("phase_functioned", "learned_blend")
"""The networks whose parameters are mixed for every sample, by its phase or by a gate."""


class Sections(Protocol):
    """The sections of an experiment's params that baselines are planned from, whatever kind of data it has."""

    @property
    def recipe(self) -> str:
        """Name of the recipe that was chosen."""

    @property
    def features(self) -> Any:
        """What networks are given and asked for: a section of its kind."""

    @property
    def ensemble(self) -> EnsembleSection:
        """How the ensemble is trained."""

    @property
    def baselines(self) -> BaselinesParams:
        """What is trained beside it."""


@dataclass(frozen=True)
class Baseline:
    """Something that is trained beside the ensemble."""

    sections: Sections
    """The experiment with the recipe that it belongs to."""
    features: Any
    """What its networks are given and asked for: a section of its kind."""
    training: EnsembleParams | BlendedTraining
    """How they are trained: a single network is an ensemble of one."""
    binning: Binning = "equal"
    """How samples get their member."""
    addressing: AddressingTraining | None = None
    """How the network that addresses them is trained; None if there is nothing to choose."""
    updates: int | None = None
    """After how many updates training stops; None: when its epochs end."""
    by_phase: bool = False
    """Whether the phase mixes the networks, which are then trained without augmentation, as PFNN is."""


def plan_baselines(
    chosen: Sections,
    other: Sections,
    members: int,
    inputs: int,
    outputs: int,
    samples: int,
    phase_features: Any = None,
) -> dict[str, Baseline]:
    """Return all that is to be trained, by name; the longest trainings, of large single networks, first.

    Args:
        chosen: the experiment with the recipe of the ensemble.
        other: the experiment with the other recipe.
        members: subnetworks of the ensemble, which were chosen if params say `auto`; the other recipe has as many then.
        inputs: inputs of the ensemble's networks.
        outputs: outputs of these.
        samples: number of training samples.
        phase_features: what a phase-functioned network is given and asked for; None if the data have no phase.

    Raises:
        ParamsError: a phase-functioned network is asked for, but the data have no phase.
    """
    params, recipe = chosen.baselines, _with_chosen(chosen.ensemble, members)
    updates = ensemble_updates(recipe, samples)
    plan = dict[str, Baseline]()
    for name in (*params.single_networks, *params.train):
        if name == "other_recipe":
            plan[OTHER_RECIPE[chosen.recipe]] = Baseline(
                other,
                other.features,
                _with_chosen(other.ensemble, members),
                addressing=other.baselines.addressing,
            )
        elif name in ABLATIONS:
            plan[name] = Baseline(chosen, chosen.features, recipe, ABLATIONS[name], params.addressing)
        elif name in BLENDED:
            by_phase = name == "phase_functioned"
            if by_phase and phase_features is None:
                message = (
                    "baselines.train: 'phase_functioned' needs data with a phase, but these have none; leave it out"
                )
                raise ParamsError(message)
            blended = blended_training(getattr(params, name), recipe, samples)
            features = phase_features if by_phase else chosen.features
            plan[name] = Baseline(chosen, features, blended, updates=updates, by_phase=by_phase)
        else:
            single = single_network_params(name, recipe, params, inputs, outputs, samples)
            plan[name] = Baseline(chosen, chosen.features, single, updates=updates)
    if params.pair_epochs:
        pair = recipe.model_copy(update={"members": 2, "epochs": params.pair_epochs, "restart": False})
        plan[PAIR] = Baseline(chosen, chosen.features, pair)
    return plan


def _with_chosen(section: EnsembleSection, members: int) -> EnsembleParams:
    return section.with_members(members if section.members == "auto" else section.members)


def single_network_params(
    name: str, ensemble: EnsembleParams, baselines: BaselinesParams, inputs: int, outputs: int, samples: int
) -> EnsembleParams:
    """Return the training of a single network, as the training of an ensemble of one.

    Its epochs are those that as many updates as the ensemble's begin (with a member's batch size they are n times as
    long, so there are fewer of them); it stops after `ensemble_updates`.

    Args:
        name: one of `baselines.single_networks`, `same_size` or `total_parameters`.
        ensemble: training of the ensemble.
        baselines: what params say of baselines.
        inputs: inputs of the network.
        outputs: its outputs.
        samples: number of training samples.
    """
    if name in baselines.single_networks:
        return as_single(ensemble, dict(baselines.single_networks[name]), samples)
    if name == "same_size":
        return same_size(ensemble, samples)
    return total_parameters(ensemble, baselines.addressing, inputs, outputs, samples)


def ensemble_updates(ensemble: EnsembleParams, samples: int) -> int:
    """Return how many updates an ensemble makes in all, those before a restart included."""
    return ensemble.epochs * updates_per_epoch(samples, ensemble.members, ensemble.batch_size)


def as_single(ensemble: EnsembleParams, shape: Mapping[str, Any], samples: int) -> EnsembleParams:
    """Return the training of one network, in the epochs that as many updates as the ensemble's begin.

    The last of them is to be cut short: the training stops after `ensemble_updates`.

    Args:
        ensemble: training of the ensemble.
        shape: in what the network differs from a member.
        samples: number of training samples.
    """
    single = ensemble.model_copy(update={"members": 1, "cluster_epochs": 1, "restart": False, **shape})
    epochs = math.ceil(ensemble_updates(ensemble, samples) / updates_per_epoch(samples, 1, single.batch_size))
    return single.model_copy(update={"epochs": epochs})


def same_size(ensemble: EnsembleParams, samples: int) -> EnsembleParams:
    """Return the training of one network as large as a member, as `as_single` does."""
    return as_single(ensemble, {}, samples)


def total_parameters(
    ensemble: EnsembleParams, addressing: AddressingTraining, inputs: int, outputs: int, samples: int
) -> EnsembleParams:
    """Return the training of one network with as many parameters as a whole model, as `as_single` does.

    A whole model is the members and a network like `addressing`, which picks one of them.
    """
    linear = inputs * outputs if ensemble.linear else 0
    picks = untrained_addressing(inputs, ensemble.members, addressing, seed=0).parameters_total
    hidden = hidden_of_total_parameters(
        inputs, outputs, ensemble.hidden, ensemble.members, linear=linear, addressing=picks
    )
    return as_single(ensemble, {"hidden": hidden}, samples)


def blended_training(network: BlendedNetwork, ensemble: EnsembleParams, samples: int) -> BlendedTraining:
    """Return the training of a blended network, in the epochs that as many updates as the ensemble's begin."""
    epochs = math.ceil(ensemble_updates(ensemble, samples) / updates_per_epoch(samples, 1, network.batch_size))
    return BlendedTraining(**network.model_dump(), epochs=epochs)


def hidden_of_total_parameters(
    inputs: int, outputs: int, hidden: tuple[int, ...], members: int, *, linear: int = 0, addressing: int = 0
) -> tuple[int, ...]:
    """Return hidden widths, in the proportions of `hidden`, of one network with as many parameters as a whole model.

    These are the members' and so many of the network that addresses them. Every network, the one and the members, has
    so many more in a linear part.
    """

    def count(widths: tuple[int, ...]) -> int:
        layers = zip((inputs, *widths), (*widths, outputs), strict=True)
        return linear + sum((width_in + 1) * width_out for width_in, width_out in layers)

    def stretched(percent: int) -> tuple[int, ...]:
        return tuple(max(1, round(width * percent / 100)) for width in hidden)

    wanted = members * count(hidden) + addressing
    most = math.ceil(100 * wanted / (count(hidden) - linear))
    candidates = [stretched(percent) for percent in range(100, most + 1)]
    return min(candidates, key=lambda widths: abs(count(widths) - wanted))
