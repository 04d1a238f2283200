"""All that is compared: the ensemble of every seed in every addressing mode, its references, and the baselines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from addressed_dynamics.evaluation.one_step import Predictor
from addressed_dynamics.models.addressed import MODES, AddressedDynamics, Mode
from addressed_dynamics.models.files import load_network, read_index

MEAN = "ensemble/mean"
"""Name of the candidate that averages the members."""


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
    members = best.ensemble.members * best.ensemble.parameters_per_member
    candidates.append(
        Candidate(
            MEAN,
            "ensemble, mean of the members",
            members,
            lambda observation, action: best.member_predictions(observation, action).mean(dim=0),
            None,
            "argmax",
        )
    )
    for seed in others:
        model = models[seed][delivered[seed]]
        candidates.append(_addressed(f"ensemble/argmax/seed-{seed}", f"ensemble, argmax, seed {seed}", model, "argmax"))
    return candidates


BASELINE_LABELS = {
    "total_parameters": "one network, as many parameters",
    "wide": "one network, wide (the paper's)",
    "unequal_bins": "ensemble without equal bins",
    "random_bins": "ensemble with random bins",
}
"""What a reader should see for each baseline."""


def baseline_candidates(folder: Path) -> list[Candidate]:
    """Load the baselines that were trained.

    Raises:
        ModelError: a file is missing or damaged.
    """
    candidates = []
    for key in read_index(folder, "baselines.json")["trained"]:
        name, seed = key.split("/seed-")
        network = load_network(folder / key / "network")
        alone = network.stack.members == 1
        addressing = None if alone else load_network(folder / key / "addressing").stack
        model = AddressedDynamics(network.features, network.stack, addressing)
        candidates.append(_addressed(key, f"{BASELINE_LABELS[name]}, seed {seed}", model, "argmax"))
    return candidates


def load_ensembles(folder: Path) -> tuple[dict[int, dict[str, AddressedDynamics]], dict[int, str]]:
    """Load every seed's ensemble with each addressing network, and say which one is delivered.

    Raises:
        ModelError: a file is missing or damaged.
    """
    index = read_index(folder / "addressing", "addressing.json")
    delivered = {int(seed): variant for seed, variant in index["delivered"].items()}
    models = {
        seed: {variant: AddressedDynamics.load(folder, seed=seed, variant=variant) for variant in index["variants"]}
        for seed in delivered
    }
    return models, delivered


def _addressed(name: str, label: str, model: AddressedDynamics, mode: Mode) -> Candidate:
    addressing = 0 if model.addressing is None else model.addressing.parameters_per_member
    parameters = model.ensemble.members * model.ensemble.parameters_per_member + addressing

    def predict(observation: Tensor, action: Tensor) -> Tensor:
        return model.predict(observation, action, mode, generator=torch.Generator().manual_seed(0))

    return Candidate(name, label, parameters, predict, model, mode)
