"""What the paper reports, to stand beside what was measured: the only place with its figures.

Bach, Melnik, Schilling, Korthals, Ritter: An Error-Based Addressing Architecture for Dynamic Model Learning.
Machine Learning, Optimization, and Data Science (LOD 2020).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

CITATION = (
    "Bach, Melnik, Schilling, Korthals, Ritter: An Error-Based Addressing Architecture for Dynamic Model Learning. "
    "Machine Learning, Optimization, and Data Science (LOD 2020)."
)
"""The paper."""


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
class PaperFigures:
    """What the paper reports on one experiment."""

    section: str
    """Where in the paper."""
    networks: tuple[PaperNetwork, ...]
    """Table 1."""
    rollouts: Mapping[str, RolloutFigure]
    """Rollout errors by dimension of the state."""
    selected_at_most: float
    """Target: the selected loss of each subnetwork."""
    separation_at_least: float
    """Target: how many times its selected loss a subnetwork's loss on the other points is."""
    misclassified_at_most: float
    """Target: misclassified points per thousand, over all subnetworks."""


PAPER: Mapping[str, PaperFigures] = {
    "mountaincar": PaperFigures(
        section="Experiment 1, Table 1",
        networks=(
            PaperNetwork(0.2e-6, 262.6e-6, 27.0, 0.4e-6, 3.5e-6, 65.2e-6),
            # The one misclassified point of this network is its median, mean and maximum.
            PaperNetwork(1.2e-6, 1861.3e-6, 1.0, 7.8e-6, 7.8e-6, 7.8e-6),
        ),
        rollouts={"position": RolloutFigure(2.225e-5, "all"), "velocity": RolloutFigure(4.859e-8, "no_wall")},
        selected_at_most=1.2e-6,
        separation_at_least=200.0,
        misclassified_at_most=27.0,
    )
}
"""By experiment; one that is not here has a report without the paper's figures."""
