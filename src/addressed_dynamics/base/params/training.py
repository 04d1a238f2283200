"""The sections of a params file that say how networks are trained."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, Field, model_validator

from addressed_dynamics.base.params.sections import (
    Count,
    CountOrAuto,
    Dropout,
    OptimiserParams,
    Section,
    Seeds,
    Share,
    Widths,
)

Activation = Literal["relu", "tanh", "elu"]
Loss = Literal["mse", "mae", "mae+mse"]


class EnsembleSection(Section):
    """Phase 1: Algorithm 1 and the subnetworks, of which there may be as many as validation says."""

    seeds: Seeds = (0, 1)
    """One ensemble is trained from each seed; the first is the one that is delivered."""
    members: CountOrAuto = 2
    """Number of subnetworks, n in the paper; `auto`: of 1, 2, 4 and 8 the smallest that is about as good as the best on
    validation samples, after a brief training."""
    hidden: Widths = (128, 128)
    """Widths of the hidden layers."""
    activation: Activation = "relu"
    linear: bool = False
    """Whether every network has a linear part beside its layers, which starts as the least-squares solution."""
    loss: Loss = "mae+mse"
    optimiser: OptimiserParams = OptimiserParams()
    batch_size: Count = 64
    """Samples per member and update."""
    shares: Count = 1
    """Parts of a batch whose gradients are added: up to so many workers of a cluster train one ensemble together. What
    comes out depends on this number, by rounding, and not on that of the workers."""
    dropout: Dropout = 0.0
    """Share of every layer's inputs that are set to 0 in an update."""
    weight_decay: Annotated[float, Field(ge=0.0)] = 0.0
    """Share of the learning rate by which weights and biases shrink in an update, beside what Adam does (AdamW); those
    of a linear part do not."""
    epochs: Count = 24
    early_stopping: Count | None = None
    """Epochs in a row without a lower validation loss that end the training; the networks are then those of the epoch
    with the lowest. null: trained to the end, and kept as they are then."""
    horizon: Count = 1
    """Steps in a row of a network's own predictions whose mean loss it is trained on: one in the first epochs, all of
    them in the second half."""
    cluster_epochs: Count = 3
    """Bins are made anew in the first so many epochs and kept after that; `all` of them is the paper's way."""
    slack: Annotated[float, Field(ge=0.0)] = 0.0
    """Share by which a bin may be larger than an equal part of the samples; 0 is Algorithm 1, the paper's way."""
    temperature: Annotated[float, Field(ge=0.0)] = 0.0
    """Temperature at which the first bins are drawn, each sample's by its losses; it falls to 0, which is Algorithm 1,
    in the last of `cluster_epochs`. 0: Algorithm 1 from the beginning, the paper's way."""
    overlap: Share = 0.0
    """Share of a member's batches, once the bins are kept, that are samples of other bins: of those for which it was
    the best of the others."""
    restart: bool = False
    """Whether the networks start again, untrained, when the bins are kept: they then see nothing but their own bins."""

    @model_validator(mode="before")
    @classmethod
    def _clusters_in_all_epochs(cls, section: Any) -> Any:
        if isinstance(section, dict) and section.get("cluster_epochs") == "all":
            return section | {"cluster_epochs": section.get("epochs", cls.model_fields["epochs"].default)}
        return section

    @model_validator(mode="after")
    def _restarts_before_the_end(self) -> EnsembleSection:
        if self.restart and self.cluster_epochs >= self.epochs:
            message = (
                f"with restart, cluster_epochs should be below epochs, or nothing is trained after it, but they are "
                f"{self.cluster_epochs} and {self.epochs}"
            )
            raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _drops_nothing_on_the_way(self) -> EnsembleSection:
        if self.horizon > 1 and self.dropout:
            message = f"with a horizon of {self.horizon} steps dropout should be 0, but it is {self.dropout:g}"
            raise ValueError(message)
        if self.shares > 1 and self.dropout:
            message = f"with {self.shares} shares dropout should be 0, but it is {self.dropout:g}"
            raise ValueError(message)
        return self

    def with_members(self, members: int) -> EnsembleParams:
        """Return how an ensemble of so many subnetworks is trained."""
        return EnsembleParams.model_validate(self.model_dump() | {"members": members})


class EnsembleParams(EnsembleSection):
    """How an ensemble is trained: phase 1 with a number of subnetworks."""

    members: Count = 2


class AddressingTraining(Section):
    """How an addressing network is made and trained."""

    hidden: Widths = (128, 128, 64)
    """Widths of the hidden layers; of the trunk's layers, if there are `heads`."""
    heads: Widths = ()
    """Widths of the hidden layers of one head for each member; empty: one output layer for all."""
    activation: Activation = "relu"
    optimiser: OptimiserParams = OptimiserParams(learning_rate=2e-3)
    batch_size: Count = 128
    dropout: Dropout = 0.0
    """Share of every layer's inputs that are set to 0 in an update."""
    epochs: Count = 10
    tie_share: Share = 1.0
    """Share of the weight that `cost_sensitive` spreads evenly, so that near ties are decided too; 1 makes it plain."""


Variants = Annotated[tuple[Literal["plain", "cost_sensitive"], ...], Field(min_length=1)]


class AddressingParams(AddressingTraining):
    """Phase 2: the addressing network."""

    epochs: Count = 20
    tie_share: Share = 0.5
    variants: Variants = ("plain", "cost_sensitive")
    """Which ones to train: `plain` is the paper's; `cost_sensitive` weighs a sample by what a wrong choice costs."""
    deliver: Literal["best", "plain", "cost_sensitive"] = "best"
    """Which one becomes part of the model: a variant, or the one with the lowest regret on validation episodes."""

    @model_validator(mode="after")
    def _delivers_what_is_trained(self) -> AddressingParams:
        if self.deliver != "best" and self.deliver not in self.variants:
            message = f"deliver is '{self.deliver}', which is not among the variants"
            raise ValueError(message)
        return self


class SingleNetwork(Section):
    """One plain network; what is not here is as for the ensemble."""

    hidden: Widths
    """Widths of the hidden layers."""
    activation: Activation = "relu"
    batch_size: Count = 32
    """Samples per update."""


def _is_free(name: str) -> str:
    if name in {
        "total_parameters", "same_size", "persistence", "last_change", "linear", "linear_frame", "unequal_bins",
        "random_bins", "pair", "ensemble", "phase_functioned", "learned_blend", "paper_recipe", "default_recipe",
        "recommended",
    }:  # fmt: skip
        message = f"'{name}' has a meaning already; give the network another name"
        raise ValueError(message)
    return name


BaselineName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$"), AfterValidator(_is_free)]
"""Name of a single network: it becomes a folder, and a title in figures."""


class BlendedNetwork(Section):
    """Networks whose parameters are mixed for every frame, by its phase or by a gate that is trained with them."""

    hidden: Widths
    """Widths of the hidden layers."""
    gate_hidden: Widths
    """Widths of the gate's hidden layers; of no use where the phase mixes."""
    members: Count
    """Networks that a gate mixes; a phase-functioned network has 4 control points."""
    activation: Activation
    loss: Loss
    optimiser: OptimiserParams
    batch_size: Count
    dropout: Dropout = 0.3
    """Share of every layer's inputs that are set to 0 in an update."""
    weight_penalty: Annotated[float, Field(ge=0.0)] = 0.01
    """Weight in the loss of the mean absolute value of the parameters, a mean over the layers' weights and biases."""


class BlendedTraining(BlendedNetwork):
    """The same with the length of its training."""

    epochs: Count


Trained = Literal[
    "total_parameters", "same_size", "unequal_bins", "random_bins", "other_recipe", "phase_functioned", "learned_blend"
]


class BaselinesParams(Section):
    """What the ensemble is compared with; same data, same number of updates."""

    train: tuple[Trained, ...] = ("total_parameters", "same_size", "unequal_bins", "random_bins")
    """`total_parameters`: one network with as many parameters as the members and a network like `addressing` together;
    `same_size`: one like a member; `unequal_bins`: each sample to its best member; `random_bins`: fixed random bins;
    `other_recipe`: the ensemble with the paper's recipe, or, if that is the one chosen, with the default;
    `phase_functioned`: PFNN, with its own features and without augmentation; `learned_blend`: parameters mixed by a
    gate that is trained with them."""
    single_networks: dict[BaselineName, SingleNetwork] = Field(default_factory=dict)
    """More single networks, under names of their own; all of them are trained."""
    pair_epochs: Annotated[int, Field(ge=0)] = 0
    """Epochs of an ensemble of two that is trained for a figure alone (the paper's Fig. 2), from the first seed; 0: no
    such ensemble."""
    phase_functioned: BlendedNetwork | None = None
    learned_blend: BlendedNetwork | None = None
    seeds: Seeds = (0,)
    """One of each is trained from each seed."""
    addressing: AddressingTraining = AddressingTraining()
    """The addressing networks of `unequal_bins`, `random_bins` and `other_recipe`, trained on plain argmin targets. Its
    widths should be those of the ensemble's, whose size `total_parameters` then has too."""

    @model_validator(mode="after")
    def _says_how_to_blend(self) -> BaselinesParams:
        for name in ("phase_functioned", "learned_blend"):
            if name in self.train and getattr(self, name) is None:
                message = f"'{name}' is to be trained, but there is no section '{name}' that says how"
                raise ValueError(message)
        return self


PAPER_OPTIMISER = {"learning_rate": 1e-4, "betas": [0.9, 0.99], "final_share": 1.0}
"""The paper's: Adam at a constant rate."""


class RecipeChanges(Section):
    """In what an experiment does otherwise with the paper's recipe, beside what `PAPER` says for its kind of data."""

    PAPER: ClassVar[Mapping[str, Any]] = {
        "ensemble": {
            "loss": "mae",
            "optimiser": PAPER_OPTIMISER,
            "cluster_epochs": "all",
            "slack": 0.0,
            "temperature": 0.0,
            "overlap": 0.0,
            "restart": False,
            "linear": False,
            "weight_decay": 0.0,
            "early_stopping": None,
            "horizon": 1,
        },
        "addressing": {"optimiser": PAPER_OPTIMISER, "variants": ["plain"], "deliver": "plain"},
    }
    """Keys of sections that take the place of the experiment's own."""

    features: dict[str, Any] = Field(default_factory=dict)
    ensemble: dict[str, Any] = Field(default_factory=dict)
    addressing: dict[str, Any] = Field(default_factory=dict)
