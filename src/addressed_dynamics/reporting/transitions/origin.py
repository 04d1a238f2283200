"""Where the results come from: what the report says was run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from addressed_dynamics.base.params.training import AddressingParams, EnsembleParams
from addressed_dynamics.evaluation.transitions.records import Recipe
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.reporting.common.blocks import Facts
from addressed_dynamics.reporting.common.numbers import listed
from addressed_dynamics.reporting.common.settings import addressing_words, bins_words, optimiser_words, subnetwork_words
from addressed_dynamics.reporting.transitions.settings import (
    angle_sentence,
    exogenous_words,
    frames_words,
    target_words,
)


@dataclass(frozen=True)
class Origin:
    """Where the results come from."""

    title: str
    """Title of the experiment."""
    params_file: str
    """Params file of the run."""
    recipe: Literal["default", "paper"]
    """Which recipe of it was chosen."""
    commit: str
    """Git commit of the code; empty if it is not known."""
    versions: Mapping[str, str]
    """Versions of the libraries that the results depend on."""
    features: FeatureSpec
    """What the networks are given and asked for, and what states and actions mean."""
    ensemble: EnsembleParams
    """Recipe of phase 1."""
    addressing: AddressingParams
    """Recipe of phase 2."""
    runs: Mapping[str, str]
    """Digests of what was trained, with which MLflow's runs are tagged, by the outputs' names."""
    experiment: str = ""
    """Name of the experiment, in MLflow too; empty if it is not known."""

    @property
    def settings(self) -> Recipe:
        """The recipe of the delivered model."""
        return Recipe(features=self.features.params, ensemble=self.ensemble, addressing=self.addressing)


def run_facts(origin: Origin, delivered_seed: int) -> Facts:
    """Return what was run, in a list."""
    ensemble, addressing, features = origin.ensemble, origin.addressing, origin.features.params
    facts = {
        "Params": origin.params_file,
        "Recipe": {"default": "the default", "paper": "the paper's"}[origin.recipe],
        "Inputs": frames_words(features),
        "Subnetworks": f"{subnetwork_words(ensemble)}; they predict {target_words(features)}",
    }
    if exogenous := exogenous_words(origin.features.spaces.exogenous):
        facts["Exogenous inputs"] = exogenous
    if angles := angle_sentence(features):
        facts["Angles"] = angles
    facts |= {
        "Phase 1": (
            f"{ensemble.epochs} epochs, bins by Algorithm 1 {bins_words(ensemble)}; loss {ensemble.loss}, "
            f"{ensemble.batch_size} samples per network and update, {optimiser_words(ensemble.optimiser)}"
        ),
        "Addressing": addressing_words(addressing, ensemble.members),
        "Phase 2": (
            f"{addressing.epochs} epochs, {addressing.batch_size} samples per update, "
            f"{optimiser_words(addressing.optimiser)}"
        ),
        "Seeds": f"{listed(list(map(str, ensemble.seeds)))}; delivered is seed {delivered_seed}",
        "Versions": ", ".join(f"{name} {version}" for name, version in origin.versions.items()),
    }
    dimensions = origin.features.spaces.observation
    if unbounded := [each.name for each in dimensions if not np.isfinite([each.low, each.high]).all()]:
        facts["Scale"] = f"of {listed(unbounded)}: the range of the training data, for lack of bounds"
    if origin.commit:
        facts["Git commit"] = origin.commit
    return Facts(facts)
