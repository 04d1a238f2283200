"""The sections of a params file that only motion capture has."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from addressed_dynamics.base.params.recording import WalkerParams
from addressed_dynamics.base.params.sections import (
    Count,
    CountOrAuto,
    Dropout,
    OptimiserParams,
    Positive,
    Section,
    Seed,
    Seeds,
    Share,
    Widths,
)
from addressed_dynamics.base.params.training import (
    Activation,
    AddressingParams,
    AddressingTraining,
    BaselinesParams,
    BlendedNetwork,
    EnsembleSection,
    Loss,
    RecipeChanges,
    Trained,
    Variants,
)


class MotionConvertParams(Section):
    """From motion to tables: what is held out, and from whom."""

    test_clips: tuple[Annotated[str, Field(min_length=1)], ...] = ()
    """Clips that are for testing, with their mirrors; empty to choose them by the hash of their names."""
    test_share: Share = 0.2
    """Share of the clips kept for the evaluation, where `test_clips` is empty."""
    validation_share: Share = 0.15
    """Share of the clips kept for choosing recipes; of the cycles, where there are few clips."""
    cycles_share: Share = 0.08
    """Share of the cycles of other clips that are kept for the evaluation, whole."""
    rows_share: Share = 0.02
    """Share of the remaining rows that are kept for an evaluation on near copies of what was trained on."""
    split_seed: Seed = 0
    """Seed of the hash that decides what is held out."""
    row_group_rows: Count = 16_384
    """Most rows in a Parquet row group."""

    @model_validator(mode="after")
    def _leaves_training_data(self) -> MotionConvertParams:
        shares = ("validation_share", "test_share"), ("cycles_share", "rows_share", "validation_share")
        for names in shares:
            if sum(getattr(self, name) for name in names) >= 1.0:
                message = f"{' + '.join(names)} must be below 1, or nothing is left to train on"
                raise ValueError(message)
        return self


class AugmentationParams(Section):
    """What is done to inputs while a motion model trains, so that it recovers from its own errors in a closed loop."""

    pose_noise: Annotated[float, Field(ge=0.0)] = 0.1
    """Deviation of Gaussian noise on the joints' inputs, in multiples of their own deviation."""
    pose_mix: Share = 0.0
    """Largest share of another frame's joints that is mixed into a frame's (drawn uniformly up to it): a network learns
    which pose a trajectory asks for, and follows commands better; too much of it makes limbs lazy."""
    pose_shrink: Share = 0.6
    """Largest share by which a frame's joints are moved towards the mean pose (drawn uniformly up to it), where a
    network freezes that has not learned the way out; 0.6 is what worked on real clips."""
    gait_swap: Share = 0.5
    """Share of samples that are given another frame's gaits: a network then follows the trajectory where the two
    disagree, as they do when a player asks for what no clip shows."""


class MotionFeatureParams(Section):
    """What the networks of a motion model are given and asked for."""

    target: Literal["absolute", "change", "trajectory_change"] = "trajectory_change"
    """`absolute`: the outputs themselves, as in the paper; `change`: what they add to persistence, where an input says
    the same of the frame before; `trajectory_change`: the latter for the trajectory, the former for the joints."""
    joint_input_weight: Positive = 1.0
    """Size of the normalised joint inputs beside those of the trajectory; PFNN has 0.1, so that a network listens to
    commands and phase rather than to the pose before. Without a phase the pose alone tells where in a step one is."""
    augmentation: AugmentationParams = AugmentationParams()
    """What is done to inputs while networks train."""


class ClosedLoopParams(Section):
    """The scripts of commands by which the addressing mode is chosen; the one that is judged is fixed."""

    validation_seed: Seed = 7
    validation_scripts: Count = 3
    validation_seconds: Positive = 20.0
    """Length of each."""


class MotionEvaluationParams(Section):
    """What is measured on held-out frames and in the closed loop."""

    closed_loop: ClosedLoopParams = ClosedLoopParams()
    released: Annotated[str, Field(pattern=r"^released/")] | None = None
    """File (npz of control points) or folder (50 phases) of the published network, to be judged too; null without. It
    is in the folder `released`, for that is what the evaluation is run again for."""


class MotionOptimiser(OptimiserParams):
    """Adam as phase-functioned networks are trained with it, but for its rate."""

    betas: tuple[Share, Share] = (0.9, 0.999)


class MotionEnsembleParams(EnsembleSection):
    """Phase 1, with defaults for motion."""

    seeds: Seeds = (0,)
    members: CountOrAuto = 4
    hidden: Widths = (512, 512)
    activation: Activation = "elu"
    loss: Loss = "mse"
    optimiser: MotionOptimiser = MotionOptimiser()
    batch_size: Count = 32
    dropout: Dropout = 0.1
    epochs: Count = 32
    cluster_epochs: Count = 12
    horizon: Literal[1] = 1
    """Networks of motion are trained on single frames."""


class _MotionAddressing(AddressingTraining):
    hidden: Widths = (512, 512)
    activation: Activation = "elu"
    optimiser: MotionOptimiser = MotionOptimiser()
    batch_size: Count = 32


class MotionAddressingTraining(_MotionAddressing):
    """How the addressing networks of baselines are trained, with defaults for motion."""

    epochs: Count = 4


class MotionAddressingParams(_MotionAddressing, AddressingParams):
    """Phase 2, with defaults for motion."""

    dropout: Dropout = 0.1
    epochs: Count = 8
    tie_share: Share = 1.0
    variants: Variants = ("plain",)
    deliver: Literal["best", "plain", "cost_sensitive"] = "plain"


class PhaseFunctioned(BlendedNetwork):
    """PFNN, as published (Holden, Komura, Saito 2017, Sections 5 and 6)."""

    hidden: Widths = (512, 512)
    gate_hidden: Widths = ()
    members: Count = 4
    activation: Activation = "elu"
    loss: Loss = "mse"
    optimiser: MotionOptimiser = MotionOptimiser(learning_rate=1e-4, final_share=1.0)
    batch_size: Count = 32
    dropout: Dropout = 0.3
    weight_penalty: Annotated[float, Field(ge=0.0)] = 0.01


class LearnedBlend(BlendedNetwork):
    """Networks whose parameters a gate mixes, as mode-adaptive networks do (Zhang and others 2018)."""

    hidden: Widths = (512, 512)
    gate_hidden: Widths = (64, 64)
    members: Count = 4
    activation: Activation = "elu"
    loss: Loss = "mse"
    optimiser: MotionOptimiser = MotionOptimiser()
    batch_size: Count = 32
    dropout: Dropout = 0.1
    weight_penalty: Annotated[float, Field(ge=0.0)] = 0.0


class MotionBaselinesParams(BaselinesParams):
    """What the ensemble is compared with, with defaults for motion."""

    train: tuple[Trained, ...] = (
        "phase_functioned", "learned_blend", "total_parameters", "same_size", "other_recipe",
    )  # fmt: skip
    phase_functioned: PhaseFunctioned | None = PhaseFunctioned()
    learned_blend: LearnedBlend | None = LearnedBlend()
    addressing: MotionAddressingTraining = MotionAddressingTraining()


class MotionRecipe(RecipeChanges):
    """In what the paper's recipe differs, also of what is done to inputs."""

    PAPER: ClassVar[Mapping[str, Any]] = {
        "features": {
            "target": "absolute",
            "augmentation": {"pose_noise": 0.0, "pose_shrink": 0.0, "pose_mix": 0.0, "gait_swap": 0.0},
        },
        "ensemble": {**RecipeChanges.PAPER["ensemble"], "activation": "relu", "dropout": 0.0},
        "addressing": {**RecipeChanges.PAPER["addressing"], "dropout": 0.0},
    }


class MotionExperimentParams(Section):
    """All sections of one experiment with motion capture."""

    title: str
    recipe: Literal["default", "paper"] = "default"
    """Whether the sections below hold as they are, or with what `paper_recipe` changes."""
    paper_recipe: MotionRecipe = MotionRecipe()
    """What the paper does otherwise; its addressing holds for `baselines.addressing` too."""
    paper: Literal["motion"] | None = None
    """The paper's experiment whose figures the report compares with; null: none."""
    record: WalkerParams | None = None
    """How made-up clips are made; absent if there are real ones."""
    convert: MotionConvertParams = MotionConvertParams()
    features: MotionFeatureParams = MotionFeatureParams()
    ensemble: MotionEnsembleParams = MotionEnsembleParams()
    addressing: MotionAddressingParams = MotionAddressingParams()
    baselines: MotionBaselinesParams = MotionBaselinesParams()
    evaluation: MotionEvaluationParams = MotionEvaluationParams()
    policy: None = None
    """Null: no policy is learned in models of motion."""


FORM = MotionExperimentParams
"""What the params file says of an experiment of this kind."""
