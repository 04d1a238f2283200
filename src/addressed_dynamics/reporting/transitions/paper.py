"""What the paper reports on environments, to stand beside what was measured: the only place with these figures.

Bach, Melnik, Schilling, Korthals, Ritter: An Error-Based Addressing Architecture for Dynamic Model Learning.
Machine Learning, Optimization, and Data Science (LOD 2020).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class PaperNetwork:
    """A row of Table 1."""

    selected: float
    """Mean loss on the points for which the network is selected."""
    not_selected: float
    """Mean loss on the others."""
    misclassified_per_thousand: float
    """Points for which it is selected although it is not the best, per thousand."""
    median: float
    """Median loss of those points."""
    mean: float
    """Mean loss of those points."""
    highest: float
    """Highest loss of those points."""


@dataclass(frozen=True)
class RolloutFigure:
    """The squared error of rollouts in one dimension of the state, and over which rollouts it is to be reached."""

    mse: float
    """Mean squared error, in the environment's unit."""
    group: Literal["all", "no_wall"]
    """Which rollouts the target is about: a contact one step late costs more than a whole rollout without one."""


@dataclass(frozen=True)
class TableTargets:
    """What is to be reached of Table 1."""

    selected_at_most: float
    """The selected loss of each subnetwork."""
    separation_at_least: float
    """How many times its selected loss a subnetwork's loss on the other points is."""
    misclassified_at_most: float
    """Misclassified points per thousand, over all subnetworks."""


@dataclass(frozen=True)
class ScaleTargets:
    """What is to be reached with some amount of data where the state holds angles."""

    agreement_above: float
    """Share of the points whose selected network has the lowest loss."""
    direction_mse_at_most: float
    """Mean squared one-step error of cosines and sines."""


@dataclass(frozen=True)
class AngleFigures:
    """What the paper states of an experiment whose state holds angles, and what is to be reached."""

    direction_names: tuple[str, ...]
    """Dimensions that are a cosine or a sine."""
    angle_names: tuple[str, ...]
    """Angles that follow from them."""
    velocity_names: tuple[str, ...]
    """Dimensions that are the velocity of an angle."""
    direction_error: float
    """The paper's error of cosines and sines; it does not say of which kind."""
    angle_error: float
    """The same of angles."""
    velocity_error: float
    """The same of velocities."""
    transitions: int
    """Transitions that the paper records; with as many, its scale is reached."""
    at_scale: ScaleTargets
    """Targets with that many transitions."""
    below_scale: ScaleTargets
    """Targets with fewer."""
    velocity_mae_at_most: float
    """Target: the mean absolute one-step error of every velocity."""
    share_at_least: float
    """Target: the share of the points for which each network is selected."""

    def targets(self, transitions: int) -> ScaleTargets:
        """Return what is to be reached with so many recorded transitions."""
        return self.at_scale if transitions >= self.transitions else self.below_scale


@dataclass(frozen=True)
class PaperFigures:
    """What the paper reports on one experiment, as far as it does."""

    section: str
    """Where in the paper."""
    networks: tuple[PaperNetwork, ...] = ()
    """Table 1; empty if there is none of this experiment."""
    table: TableTargets | None = None
    """What is to be reached of it."""
    rollouts: Mapping[str, RolloutFigure] = field(default_factory=dict)
    """Rollout errors by dimension of the state."""
    wide_network_fails: bool = False
    """Whether it says that one wide network was unable to learn the dynamics."""
    agreement: float | None = None
    """Share of the points, on which the networks were trained, whose selected network has the lowest loss."""
    angles: AngleFigures | None = None
    """Errors where the state holds angles."""


PAPER: Mapping[str, PaperFigures] = {
    "mountaincar": PaperFigures(
        section="Experiment 1, Table 1",
        networks=(
            PaperNetwork(0.2e-6, 262.6e-6, 27.0, 0.4e-6, 3.5e-6, 65.2e-6),
            # The one misclassified point of this network is its median, mean and maximum.
            PaperNetwork(1.2e-6, 1861.3e-6, 1.0, 7.8e-6, 7.8e-6, 7.8e-6),
        ),
        table=TableTargets(selected_at_most=1.2e-6, separation_at_least=200.0, misclassified_at_most=27.0),
        rollouts={"position": RolloutFigure(2.225e-5, "all"), "velocity": RolloutFigure(4.859e-8, "no_wall")},
        wide_network_fails=True,
    ),
    "acrobot": PaperFigures(
        section="Experiment 2",
        agreement=0.775,
        angles=AngleFigures(
            direction_names=("cos_angle_1", "sin_angle_1", "cos_angle_2", "sin_angle_2"),
            angle_names=("angle_1", "angle_2"),
            velocity_names=("velocity_1", "velocity_2"),
            direction_error=1e-6,
            angle_error=1e-6,
            velocity_error=1e-2,
            transitions=200_000,
            at_scale=ScaleTargets(agreement_above=0.9, direction_mse_at_most=1e-6),
            below_scale=ScaleTargets(agreement_above=0.8, direction_mse_at_most=1e-5),
            velocity_mae_at_most=1e-2,
            share_at_least=0.05,
        ),
    ),
}
"""By the paper's experiment, as `paper` in the params names it."""
