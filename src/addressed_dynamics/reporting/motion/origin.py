"""Where the results on motion come from: what the report says was run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from addressed_dynamics.base.params.training import AddressingParams, EnsembleParams
from addressed_dynamics.evaluation.motion.records import Delivered
from addressed_dynamics.reporting.common.blocks import Facts
from addressed_dynamics.reporting.common.numbers import listed, percent
from addressed_dynamics.reporting.common.settings import addressing_words, bins_words, optimiser_words, subnetwork_words
from addressed_dynamics.sources.motion.params import AugmentationParams, MotionFeatureParams

TARGETS = {
    "absolute": "the outputs themselves",
    "change": "what the outputs add to persistence",
    "trajectory_change": "the joints themselves, and what the trajectory adds to persistence",
}
"""What networks are asked for."""


@dataclass(frozen=True)
class MotionOrigin:
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
    features: MotionFeatureParams
    """What the networks are given and asked for."""
    ensemble: EnsembleParams
    """Recipe of phase 1."""
    addressing: AddressingParams
    """Recipe of phase 2."""
    runs: Mapping[str, str]
    """Digests of what was trained, with which MLflow's runs are tagged, by the outputs' names."""
    paper: bool = False
    """Whether what the paper states of motion stands beside the figures."""
    experiment: str = ""
    """Name of the experiment, in MLflow too; empty if it is not known."""


def run_facts(origin: MotionOrigin, delivered: Delivered) -> Facts:
    """Return what was run, in a list."""
    ensemble, addressing = origin.ensemble, origin.addressing
    facts = {
        "Params": origin.params_file,
        "Recipe": {"default": "the default", "paper": "the paper's"}[origin.recipe],
        "Inputs": f"342, of one frame and the trajectory around it, without the phase{_weight(origin.features)}",
        "Augmentation": _augmentation(origin.features.augmentation),
        "Subnetworks": f"{subnetwork_words(ensemble)}; they predict {TARGETS[origin.features.target]}",
        "Phase 1": (
            f"{ensemble.epochs} epochs, bins by Algorithm 1 {bins_words(ensemble)}; loss {ensemble.loss}, "
            f"{ensemble.batch_size} samples per network and update, {optimiser_words(ensemble.optimiser)}"
            f"{_dropout(ensemble.dropout)}"
        ),
        "Addressing": addressing_words(addressing, ensemble.members),
        "Phase 2": (
            f"{addressing.epochs} epochs, {addressing.batch_size} samples per update, "
            f"{optimiser_words(addressing.optimiser)}{_dropout(addressing.dropout)}"
        ),
        "Seeds": (
            f"{listed(list(map(str, ensemble.seeds)))}; delivered is seed {delivered.seed} with {delivered.mode} "
            "addressing"
        ),
        "Versions": ", ".join(f"{name} {version}" for name, version in origin.versions.items()),
    }
    if origin.commit:
        facts["Git commit"] = origin.commit
    return Facts(facts)


def _weight(features: MotionFeatureParams) -> str:
    weight = features.joint_input_weight
    return "" if weight == 1 else f"; those of the joints count {weight:g} times"


def _augmentation(augmentation: AugmentationParams) -> str:
    parts = []
    if augmentation.pose_noise:
        parts.append(f"noise of {augmentation.pose_noise:g} deviations on the joints")
    if augmentation.pose_mix:
        parts.append(f"up to {percent(augmentation.pose_mix, 0)} of another frame's joints mixed in")
    if augmentation.gait_swap:
        parts.append(f"another frame's gaits for {percent(augmentation.gait_swap, 0)} of the samples")
    return f"of the inputs in training: {listed(parts)}" if parts else "none"


def _dropout(share: float) -> str:
    return f", dropout {share:g}" if share else ""
