"""The settings of a recipe for transitions as a person reads them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from addressed_dynamics.episodes.transitions import Dimension
from addressed_dynamics.evaluation.transitions.records import Recipe
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.reporting.common.numbers import listed
from addressed_dynamics.reporting.common.origin import ModelWords
from addressed_dynamics.reporting.common.settings import addressing_words, bins_words, optimiser_words, subnetwork_words
from addressed_dynamics.sources.transitions.params import FeatureParams


def model_words(features: FeatureSpec) -> ModelWords:
    """Return what a report says of networks with these features."""
    formed = {"Exogenous inputs": exogenous_words(features.spaces.exogenous), "Angles": angle_sentence(features.params)}
    return ModelWords(
        given={"Inputs": frames_words(features.params)},
        predicted=target_words(features.params),
        formed=formed,
        notes={"Scale": scale_words(features.spaces.observation)},
    )


def scale_words(dimensions: Sequence[Dimension]) -> str:
    """Return by what dimensions of the state are scaled that have no bounds; empty if all have."""
    unbounded = [each.name for each in dimensions if not np.isfinite([each.low, each.high]).all()]
    return f"of {listed(unbounded)}: the range of the training data, for lack of bounds" if unbounded else ""


def target_words(features: FeatureParams) -> str:
    """Return what the subnetworks are asked for."""
    return {"change": "the change of the state", "absolute": "the next state"}[features.target]


def frames_words(features: FeatureParams) -> str:
    """Return what every network is given."""
    if features.history == 1:
        return "one frame: a state with its action"
    older = "" if features.history_weight == 1 else f"; older frames weigh {features.history_weight:g} times the last"
    return f"{features.history} frames in a row, each a state with its action{older}"


def exogenous_words(exogenous: Sequence[Dimension]) -> str:
    """Return what becomes of exogenous inputs; empty if there are none."""
    if not exogenous:
        return ""
    names = listed([dimension.name for dimension in exogenous])
    return (
        f"{names}: known, not predicted; every frame holds them beside the action, and rollouts replay those recorded"
    )


def angle_words(features: FeatureParams) -> str:
    """Return how angles come from predicted cosines and sines; empty if there are none."""
    ways = {"weighted": "the paper's weighted mean (Section 3.3)", "atan2": "atan2"}
    return ways[features.angle_from] if features.angles else ""


def velocity_words(features: FeatureParams) -> str:
    """Return where the velocities of angles come from; empty if there are none."""
    ways = {"difference": "differences of successive angles", "predicted": "predicted"}
    return ways[features.velocity] if any(angle.velocity for angle in features.angles) else ""


def angle_sentence(features: FeatureParams) -> str:
    """Return how angles and their velocities come about; empty if there are no angles."""
    if not features.angles:
        return ""
    names = listed([angle.name for angle in features.angles])
    velocities = f"; their velocities are {words}" if (words := velocity_words(features)) else ""
    return f"{names} from cosine and sine by {angle_words(features)}{velocities}"


SETTINGS: Mapping[str, Callable[[Recipe], str]] = {
    "subnetworks": lambda recipe: subnetwork_words(recipe.ensemble),
    "they are given": lambda recipe: frames_words(recipe.features),
    "they predict": lambda recipe: target_words(recipe.features),
    "angles": lambda recipe: angle_words(recipe.features),
    "velocities of angles": lambda recipe: velocity_words(recipe.features),
    "loss": lambda recipe: recipe.ensemble.loss,
    "optimiser": lambda recipe: optimiser_words(recipe.ensemble.optimiser),
    "samples per network and update": lambda recipe: str(recipe.ensemble.batch_size),
    "epochs": lambda recipe: str(recipe.ensemble.epochs),
    "bins made anew": lambda recipe: bins_words(recipe.ensemble),
    "addressing network": lambda recipe: addressing_words(recipe.addressing, recipe.ensemble.members),
    "addressing: optimiser": lambda recipe: optimiser_words(recipe.addressing.optimiser),
    "addressing: samples per update": lambda recipe: str(recipe.addressing.batch_size),
    "addressing: epochs": lambda recipe: str(recipe.addressing.epochs),
}
"""What distinguishes recipes, by the words for it."""
