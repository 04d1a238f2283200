"""What models of an environment are trained on."""

from addressed_dynamics.base.params.experiments import FeatureParams
from addressed_dynamics.episodes.parquet import load_transitions
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from pipeline.common import tables_dir
from pipeline.training import TrainingData


def load_training_data(experiment: str, features: FeatureParams | FeatureSpec) -> TrainingData[FeatureSpec]:
    """Read the training and validation samples of `experiment`, with features to be fitted or those of a model."""
    train = load_transitions(tables_dir(experiment), split="train")
    validation = load_transitions(tables_dir(experiment), split="validation")
    spec = features if isinstance(features, FeatureSpec) else fit_features(train, features)
    return TrainingData(spec, spec.samples(train), spec.samples(validation))
