"""All models of motion that are compared: the ensemble of every seed in every mode, the baselines, and references."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.evaluation.common.sizes import total_size
from addressed_dynamics.evaluation.motion.baselines import mean_outputs, persistence_plus_velocity
from addressed_dynamics.networks.addressing import multiply_adds_a_step
from addressed_dynamics.networks.files import read_index
from addressed_dynamics.networks.ridge import fit_ridge
from addressed_dynamics.simulators.modes import MODES, Mode
from addressed_dynamics.simulators.motion import MotionModel
from addressed_dynamics.simulators.motion_predictor import MotionPredictor

ENSEMBLE = "ensemble"
"""First part of the group of our own candidates, followed by the mode: `ensemble/argmax`."""
BASELINE_LABELS = {
    "phase_functioned": "PFNN, trained here",
    "learned_blend": "parameters mixed by a gate (as MANN)",
    "same_size": "one network, as large as a member",
    "paper_recipe": "ensemble, the paper's recipe",
    "default_recipe": "ensemble, the default recipe",
}
"""What a reader should see for each baseline, but for the one network that is as large as the whole model."""
SAMPLING_SEED = 0
"""Seed of the members that the mode `sample` draws."""


@dataclass(frozen=True)
class MotionCandidate:
    """One model to evaluate."""

    group: str
    """What it is, whatever its seed: `ensemble/argmax`, `phase_functioned`, `ridge`."""
    seed: int | None
    """The seed it was trained from; None if it was not trained here from one."""
    label: str
    """What a reader should see for the group."""
    parameters: int
    """Parameters of all its networks, that of the addressing network included."""
    predictor: MotionPredictor
    """One step ahead."""
    multiply_adds: int | None = None
    """Multiply-adds of one prediction, with those of the addressing network; None if unknown."""

    @property
    def name(self) -> str:
        """A name of its own, for instance `phase_functioned/seed-0`."""
        return self.group if self.seed is None else f"{self.group}/seed-{self.seed}"


def load_motion_ensembles(folder: Path) -> dict[int, MotionModel]:
    """Load the ensemble of every seed, each with the addressing network that is delivered, from a folder of models.

    Raises:
        ModelError: a file is missing or damaged.
    """
    seeds = read_index(folder / "ensemble", "ensemble.json")["seeds"]
    return {seed: MotionModel.load(folder, seed=seed) for seed in seeds}


def ensemble_candidates(models: Mapping[int, MotionModel]) -> list[MotionCandidate]:
    """Return the ensembles of all seeds in every mode."""
    return [_addressed(model, mode, seed) for mode in MODES for seed, model in models.items()]


def baseline_candidates(folder: Path, own: int) -> list[MotionCandidate]:
    """Load the baselines that were trained.

    Args:
        folder: where they are.
        own: parameters of the ensemble with the network that addresses it, whose size one of them has.

    Raises:
        ModelError: a file is missing or damaged.
    """
    candidates = []
    for key in read_index(folder, "baselines.json")["trained"]:
        name, seed = key.split("/seed-")
        model = MotionModel.load(folder / key)
        total = name == "total_parameters"
        label = f"one network, {total_size(model.parameters, own)}" if total else BASELINE_LABELS[name]
        candidates.append(_trained(name, int(seed), label, model))
    return candidates


def reference_candidates(train: Motion, validation: Motion, released: Path | None) -> list[MotionCandidate]:
    """Return what needs no training by epochs, and the published network if there is one.

    Args:
        train: frames for means and for the regression.
        validation: frames by which the regression's penalty is chosen.
        released: file or folder of the published phase-functioned network; None without it.

    Raises:
        ModelError: the published network is missing or damaged.
        TrainingError: there are no frames to fit or to choose by.
    """
    mean = train.y.mean(axis=0, dtype=np.float64)
    ridge = fit_ridge((train.x, train.y), (validation.x, validation.y))
    candidates = [
        MotionCandidate("mean", None, "mean of the training frames", mean.size, mean_outputs(mean)),
        MotionCandidate("persistence", None, "persistence and velocity", mean.size, persistence_plus_velocity(mean)),
        MotionCandidate(
            "ridge", None, "ridge regression", ridge.weight.numel() + ridge.bias.numel(), ridge, ridge.weight.numel()
        ),
    ]
    if released is not None:
        model = MotionModel.load_released(released)
        candidates.append(_trained("released", None, "PFNN, as published", model))
    return candidates


def _addressed(model: MotionModel, mode: Mode, seed: int) -> MotionCandidate:
    generator = torch.Generator().manual_seed(SAMPLING_SEED) if mode == "sample" else None
    predictor = model.predictor(mode, generator=generator)
    cost = multiply_adds_a_step(model.networks, model.addressing, mode)
    label = f"ensemble, {mode} addressing"
    return MotionCandidate(f"{ENSEMBLE}/{mode}", seed, label, model.parameters, predictor, cost)


def _trained(group: str, seed: int | None, label: str, model: MotionModel) -> MotionCandidate:
    cost = multiply_adds_a_step(model.networks, model.addressing, model.mode)
    return MotionCandidate(group, seed, label, model.parameters, model.predictor(), cost)
