"""What transitions supply to the trainings."""

from pathlib import Path

from addressed_dynamics.episodes.parquet import load_transitions
from addressed_dynamics.features.common.training_data import Choice, TrainingData
from addressed_dynamics.features.transitions.history import choose_history
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.features.transitions.windows import shorter_episodes
from addressed_dynamics.sources.transitions.params import ExperimentParams, FeatureSection

FEATURES = FeatureSpec
"""What networks of this kind of data are saved with."""
PHASE_FEATURES = None
"""Transitions have no phase that could mix networks."""


def load_training_data(
    tables: Path,
    sections: ExperimentParams,
    features: FeatureSection | FeatureSpec,
    *,
    augmented: bool = True,  # noqa: ARG001 - transitions are trained on as they are
) -> TrainingData[FeatureSpec]:
    """Read the training and validation samples in `tables`, with features to be fitted or those of a model."""
    train = load_transitions(tables, split="train")
    validation = load_transitions(tables, split="validation")
    choices = dict[str, Choice]()
    if isinstance(features, FeatureSpec):
        spec = features
    else:
        history = features.history
        if history == "auto":
            choices["history"] = choose_history(train, validation)
            history = choices["history"].chosen
        spec = fit_features(train, features.with_history(history))
    dropped = {
        split: shorter_episodes(part, spec.history)
        for split, part in {"train": train, "validation": validation}.items()
    }
    courses = sections.ensemble.horizon > 1
    on_train, on_validation = (spec.samples(part, courses=courses) for part in (train, validation))
    return TrainingData(
        spec,
        on_train,
        on_validation,
        dropped=dropped,
        choices=choices,
        persistence=spec.persistence,
        last_change=spec.last_change,
        last_frame=None if spec.history == 1 else spec.frame_inputs,
    )
