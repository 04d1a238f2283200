"""Where the results come from: what the report says was run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Generic, Literal, TypeVar

from addressed_dynamics.base.params.training import AddressingParams, EnsembleParams
from addressed_dynamics.features.common.training_data import Features
from addressed_dynamics.networks.files import SavedNetwork, addressed_folders, load_network
from addressed_dynamics.reporting.common.blocks import Facts
from addressed_dynamics.reporting.common.numbers import listed
from addressed_dynamics.reporting.common.settings import (
    addressing_words,
    bins_words,
    dropout_words,
    optimiser_words,
    subnetwork_words,
)
from addressed_dynamics.reporting.common.written import Subject

LIBRARIES = ("addressed-dynamics", "numpy", "torch")
"""Libraries that results of any kind of data depend on."""
Described = TypeVar("Described")
"""What a kind knows of the inputs and outputs of its networks."""


@dataclass(frozen=True)
class Trained(Generic[Features]):
    """The ensemble that a report is about with the network that addresses it."""

    ensemble: SavedNetwork[Features]
    addressing: SavedNetwork[Features]


@dataclass(frozen=True)
class Origin(Generic[Described]):
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
    features: Described
    """What the networks are given and asked for."""
    ensemble: EnsembleParams
    """Recipe of phase 1."""
    addressing: AddressingParams
    """Recipe of phase 2."""
    runs: Mapping[str, str]
    """Digests of what was trained, with which MLflow's runs are tagged, by the outputs' names."""
    experiment: str = ""
    """Name of the experiment, in MLflow too; empty if it is not known."""
    drawn: str = ""
    """When the report was drawn, and on which machine; empty if nobody says."""
    trained: str = ""
    """How long the trainings took; empty if it is not known."""


@dataclass(frozen=True)
class ModelWords:
    """What a kind says of its networks, among all that was run; what is empty is left out."""

    given: Mapping[str, str] = field(default_factory=dict)
    """Facts on what they are given."""
    predicted: str = ""
    """What they predict."""
    formed: Mapping[str, str] = field(default_factory=dict)
    """Facts on what is made of inputs and predictions."""
    mode: str = ""
    """How that ensemble uses the outputs of the addressing network."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """Facts that stand near the end."""


def load_trained(
    subject: Subject, form: type[Features], *, seed: int | None = None, variant: str | None = None
) -> Trained[Features]:
    """Read the networks that a report is about, with features of the class `form`.

    Args:
        subject: the experiment.
        form: class of its features.
        seed: which of the trained seeds; None for the first.
        variant: which addressing network; None for the one that training chose.

    Raises:
        ModelError: a network is missing or damaged, or models another kind of data.
    """
    ensemble, addressing = addressed_folders(subject.models, seed, variant)
    return Trained(load_network(ensemble, form), load_network(addressing, form))


def origin_of(
    subject: Subject, trained: Trained[Features], features: Described, libraries: Sequence[str] = LIBRARIES
) -> Origin[Described]:
    """Return where the results on `subject` come from, with the params that its networks were trained with."""
    return Origin(
        title=subject.params.title,
        params_file=subject.params_file,
        recipe=subject.params.recipe,
        commit=subject.commit,
        versions={name: version(name) for name in libraries},
        features=features,
        ensemble=EnsembleParams.model_validate(trained.ensemble.notes["params"]["ensemble"], strict=False),
        addressing=AddressingParams.model_validate(trained.addressing.notes["params"], strict=False),
        runs=subject.runs,
        experiment=subject.experiment,
        drawn=subject.drawn,
        trained=subject.trained,
    )


def run_facts(origin: Origin[Described], words: ModelWords, seed: int) -> Facts:
    """Return what was run, in a list.

    Args:
        origin: where the results come from.
        words: what the kind says of its networks.
        seed: the one that the report is about.
    """
    ensemble, addressing = origin.ensemble, origin.addressing
    predicted = f"; they predict {words.predicted}" if words.predicted else ""
    mode = f" with {words.mode} addressing" if words.mode else ""
    facts = {
        "Recipe": {"default": "the default", "paper": "the paper's"}[origin.recipe],
        **words.given,
        "Subnetworks": f"{subnetwork_words(ensemble)}{predicted}",
        **words.formed,
        "Phase 1": (
            f"{ensemble.epochs} epochs, bins by Algorithm 1 {bins_words(ensemble)}; loss {ensemble.loss}, "
            f"{ensemble.batch_size} samples per network and update, {optimiser_words(ensemble.optimiser)}"
            f"{dropout_words(ensemble.dropout)}"
        ),
        "Addressing": addressing_words(addressing, ensemble.members),
        "Phase 2": (
            f"{addressing.epochs} epochs, {addressing.batch_size} samples per update, "
            f"{optimiser_words(addressing.optimiser)}{dropout_words(addressing.dropout)}"
        ),
        "Seeds": f"{listed(list(map(str, ensemble.seeds)))}; the report is about seed {seed}{mode}",
        "Versions": ", ".join(f"{name} {number}" for name, number in origin.versions.items()),
        **words.notes,
    }
    return Facts({name: value for name, value in facts.items() if value})
