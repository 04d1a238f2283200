"""All that is compared: the ensemble of every seed in every addressing mode, its references, and the baselines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.params.training import AddressingTraining, EnsembleParams
from addressed_dynamics.evaluation.common.sizes import total_size
from addressed_dynamics.evaluation.transitions.one_step import Predictor
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.networks.addressing import multiply_adds_a_step
from addressed_dynamics.networks.files import SavedNetwork, load_network, read_index
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.delivery import ENSEMBLE, Origin, parts_in
from addressed_dynamics.simulators.modes import MODES, Mode
from addressed_dynamics.training.baselines import OTHER_RECIPE
from addressed_dynamics.training.references import (
    LAST_CHANGE,
    LINEAR,
    LINEAR_FRAME,
    PERSISTENCE,
    UNTRAINED,
    reference_costs,
)

MEAN = "ensemble/mean"
"""Name of the candidate that averages the members."""
SAMPLING_SEED = 0
"""Seed of the members that the mode `sample` draws."""


@dataclass(frozen=True)
class Candidate:
    """One thing to evaluate."""

    name: str
    """Unique, for instance `ensemble/argmax` or `wide/seed-0`."""
    label: str
    """What a reader should see."""
    parameters: int
    """Parameters of the subnetworks and of the addressing network, if it is used."""
    predictor: Predictor
    """One step ahead."""
    model: AddressedDynamics | None
    """For rollouts; None if it needs the truth."""
    mode: Mode
    """Addressing mode of its rollouts."""
    multiply_adds: int | None = None
    """Multiply-adds of one prediction, with those of the addressing network, if it is used; None if unknown."""


def origin_of(candidate: Candidate) -> Origin | None:
    """Return which of an experiment's models a candidate is; None if it is one that cannot be loaded."""
    if candidate.model is None:
        return None
    kind, *rest = candidate.name.split("/")
    if kind == ENSEMBLE:
        return candidate.model.origin
    return Origin(kind, int(rest[-1].removeprefix("seed-")))


def ensemble_candidates(models: dict[int, dict[str, AddressedDynamics]], delivered: dict[int, str]) -> list[Candidate]:
    """Return the first seed's ensemble in every mode and with every addressing network, its mean, and all other seeds.

    Args:
        models: for every seed, the ensemble with each variant of the addressing network.
        delivered: for every seed, the variant that is delivered.
    """
    first, *others = models
    best = models[first][delivered[first]]
    candidates = [_addressed(f"ensemble/{mode}", f"ensemble, {mode} addressing", best, mode) for mode in MODES]
    for variant, model in models[first].items():
        if variant != delivered[first]:
            label = f"ensemble, argmax, {variant.replace('_', '-')} addressing"
            candidates.append(_addressed(f"ensemble/argmax/{variant}", label, model, "argmax"))
    candidates.append(
        Candidate(
            MEAN,
            "ensemble, mean of the members",
            best.ensemble.parameters_total,
            lambda points, point: _decoded(best, points, point, points.outputs(best)[:, point].mean(dim=0)),
            None,
            "argmax",
            best.ensemble.multiply_adds(),
        )
    )
    for seed in others:
        model = models[seed][delivered[seed]]
        candidates.append(_addressed(f"ensemble/argmax/seed-{seed}", f"ensemble, argmax, seed {seed}", model, "argmax"))
    return candidates


TOTAL = "total_parameters"
"""Name of the one network that is as large as the whole model."""
BASELINE_LABELS = {
    PERSISTENCE: "nothing changes",
    LAST_CHANGE: "the last change goes on",
    LINEAR: "linear least squares",
    LINEAR_FRAME: "linear least squares of the last frame",
    "same_size": "one network, as large as a member",
    "unequal_bins": "ensemble without equal bins",
    "random_bins": "ensemble with random bins",
    "paper_recipe": "ensemble, the paper's recipe",
    "default_recipe": "ensemble, the default recipe",
}
"""What a reader should see for each baseline; other single networks say what they are."""


def baseline_label(name: str, stack: StackedMLP) -> str:
    """Return what a reader should see for a baseline, for instance `one network, relu 512 × 512 × 512`."""
    hidden = " × ".join(map(str, stack.widths[1:-1]))
    return BASELINE_LABELS.get(name, f"one network, {stack.activation} {hidden}" if hidden else "one linear map")


def baseline_candidates(folder: Path, own: AddressedDynamics) -> list[Candidate]:
    """Load the baselines that were trained.

    Args:
        folder: where they are.
        own: the delivered model, whose size one of them has.

    Raises:
        ModelError: a file is missing or damaged.
    """
    candidates = []
    for key in read_index(folder, "baselines.json")["trained"]:
        name, seed = key.split("/seed-")
        network, model = _load_baseline(folder / key)
        label = baseline_label(name, network.stack)
        if name == TOTAL:
            label = f"one network, {total_size(network.stack.parameters_total, _size(own))}"
        if name in UNTRAINED:
            features = model.features
            last_frame = None if features.history == 1 else features.frame_inputs
            parameters, products = reference_costs(name, features.inputs, features.outputs, last_frame)
            found = _addressed(key, label, model, "argmax")
            candidates.append(replace(found, parameters=parameters, multiply_adds=products))
        else:
            candidates.append(_addressed(key, f"{label}, seed {seed}", model, "argmax"))
    return candidates


def recorded_change(features: FeatureSpec) -> list[Candidate]:
    """Return the reference by which the last change goes on, where a model is given one frame; else nothing.

    One frame does not say how the state changed before, so it is no model, cannot be rolled out, and is read from what
    was recorded: one step ahead. In the first step of an episode, before which nothing is known, nothing changes.
    """
    if features.history > 1:
        return []

    def predict(points: Points, point: Tensor) -> Tensor:
        rows = torch.from_numpy(points.rows)[point]
        states, episode = (
            torch.from_numpy(each) for each in (points.transitions.observation, points.transitions.episode)
        )
        before = (rows - 1).clamp(min=0)
        known = (before < rows) & (episode[before] == episode[rows])
        now = states[rows]
        return torch.where(known.unsqueeze(1), 2 * now - states[before], now)

    return [Candidate(LAST_CHANGE, BASELINE_LABELS[LAST_CHANGE], 0, predict, None, "argmax", 0)]


@dataclass(frozen=True)
class OtherRecipe:
    """The ensemble with the recipe that was not chosen."""

    name: str
    """Name of the baseline: `paper_recipe` or `default_recipe`."""
    model: AddressedDynamics
    """The ensemble with its addressing network."""
    ensemble: EnsembleParams
    """How the ensemble was trained."""
    addressing: AddressingTraining
    """How the addressing network was trained."""


def load_other_recipe(folder: Path, candidates: Sequence[Candidate] = ()) -> OtherRecipe | None:
    """Load the ensemble with the recipe that was not chosen; None if it was not trained.

    Args:
        folder: the baselines' folder.
        candidates: what was loaded already: if the ensemble is among them, it is the same object.

    Raises:
        ModelError: a file is missing or damaged.
    """
    for key in read_index(folder, "baselines.json")["trained"]:
        name = key.partition("/seed-")[0]
        if name in OTHER_RECIPE.values():
            network, model = _load_baseline(folder / key)
            model = next((each.model for each in candidates if each.name == key and each.model is not None), model)
            try:
                ensemble = EnsembleParams.model_validate(network.notes["params"]["ensemble"], strict=False)
                addressing = AddressingTraining.model_validate(network.notes["params"]["addressing"], strict=False)
            except (KeyError, TypeError, ValueError) as error:
                config = folder / key / "network" / "config.json"
                message = f"{config}: its notes should have the recipe under 'params'; run train_baselines again"
                raise ModelError(message) from error
            return OtherRecipe(name, model, ensemble, addressing)
    return None


def load_pair(folder: Path) -> tuple[StackedMLP, int] | None:
    """Load the ensemble of two that a figure shows, with the seed it was trained from; None if there is none.

    Raises:
        ModelError: a file is missing or damaged.
    """
    keys = read_index(folder, "baselines.json")["pair"]
    return (
        (load_network(folder / keys[0] / "network", FeatureSpec).stack, int(keys[0].split("/seed-")[1]))
        if keys
        else None
    )


def load_ensembles(folder: Path) -> tuple[dict[int, dict[str, AddressedDynamics]], dict[int, str]]:
    """Load every seed's ensemble with each addressing network, and say which one is delivered.

    Raises:
        ModelError: a file is missing or damaged.
    """
    index = read_index(folder / "addressing", "addressing.json")
    delivered = {int(seed): variant for seed, variant in index["delivered"].items()}
    return {seed: _variants(folder, seed, index["variants"]) for seed in delivered}, delivered


def _variants(folder: Path, seed: int, names: Sequence[str]) -> dict[str, AddressedDynamics]:
    """Load the ensemble of a seed with each of the addressing networks; all have the same ensemble, as one object."""
    loaded = {name: AddressedDynamics.load(folder, seed=seed, variant=name) for name in names}
    ensemble = next(iter(loaded.values())).ensemble
    return {
        name: AddressedDynamics(each.features, ensemble, each.addressing, mode=each.mode, origin=each.origin)
        for name, each in loaded.items()
    }


def _load_baseline(folder: Path) -> tuple[SavedNetwork[FeatureSpec], AddressedDynamics]:
    network = load_network(folder / "network", FeatureSpec)
    return network, AddressedDynamics.of(parts_in(folder))


def _addressed(name: str, label: str, model: AddressedDynamics, mode: Mode) -> Candidate:
    # One generator for all chunks of points: seeded for each, it would draw the same members in all of them.
    generator = torch.Generator().manual_seed(SAMPLING_SEED) if mode == "sample" else None

    cost = multiply_adds_a_step(model.ensemble, model.addressing, mode)
    return Candidate(name, label, _size(model), predictor_of(model, mode, generator), model, mode, cost)


def _size(model: AddressedDynamics) -> int:
    """Return the parameters of the members and of the network that addresses them."""
    return model.ensemble.parameters_total + (0 if model.addressing is None else model.addressing.parameters_total)


def predictor_of(model: AddressedDynamics, mode: Mode, generator: torch.Generator | None = None) -> Predictor:
    """Return a model in a mode as a predictor, which says what `AddressedDynamics.predict` does."""

    def predict(points: Points, point: Tensor) -> Tensor:
        return _decoded(model, points, point, points.combined(model, point, mode, generator))

    return predict


def _decoded(model: AddressedDynamics, points: Points, point: Tensor, output: Tensor) -> Tensor:
    return model.decode(output, points.inputs(point)[0])
