"""Names that moved to `training.baselines` and `networks.phase_functioned`, under which the pipeline still asks."""

from addressed_dynamics.networks.phase_functioned import PFNN_FEATURES
from addressed_dynamics.training.baselines import blended_training, same_size, total_parameters

__all__ = ["PFNN_FEATURES", "blended_training", "same_size", "total_parameters"]
