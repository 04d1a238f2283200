"""The sections of a params file that only motion capture has."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from addressed_dynamics.base.params.recording import WalkerParams
from addressed_dynamics.base.params.sections import Count, Positive, Section, Seed, Share
from addressed_dynamics.base.params.training import AddressingParams, BaselinesParams, EnsembleParams, RecipeChanges


class MotionConvertParams(Section):
    """From motion to tables: what is held out, and from whom."""

    test_clips: tuple[Annotated[str, Field(min_length=1)], ...] = ()
    """Clips that are for testing, with their mirrors; empty to choose them by the hash of their names."""
    test_share: Share
    """Share of the clips kept for the evaluation, where `test_clips` is empty."""
    validation_share: Share
    """Share of the clips kept for choosing recipes; of the cycles, where there are few clips."""
    cycles_share: Share
    """Share of the cycles of other clips that are kept for the evaluation, whole."""
    rows_share: Share
    """Share of the remaining rows that are kept for an evaluation on near copies of what was trained on."""
    split_seed: Seed
    """Seed of the hash that decides what is held out."""
    row_group_rows: Count
    """Most rows in a Parquet row group."""

    @model_validator(mode="after")
    def _leaves_training_data(self) -> MotionConvertParams:
        shares = ("validation_share", "test_share"), ("cycles_share", "rows_share", "validation_share")
        for names in shares:
            if sum(getattr(self, name) for name in names) >= 1.0:
                message = f"{' + '.join(names)} must be below 1, or nothing is left to train on"
                raise ValueError(message)
        return self


class MotionFeatureParams(Section):
    """What the networks of a motion model are given and asked for."""

    target: Literal["absolute", "change", "trajectory_change"]
    """`absolute`: the outputs themselves, as in the paper; `change`: what they add to persistence, where an input says
    the same of the frame before; `trajectory_change`: the latter for the trajectory, the former for the joints."""
    joint_input_weight: Positive = 1.0
    """Size of the normalised joint inputs beside those of the trajectory; PFNN has 0.1, so that a network listens to
    commands and phase rather than to the pose before. Without a phase the pose alone tells where in a step one is."""


class AugmentationParams(Section):
    """What is done to inputs while a motion model trains, so that it recovers from its own errors in a closed loop."""

    pose_noise: Annotated[float, Field(ge=0.0)] = 0.1
    """Deviation of Gaussian noise on the joints' inputs, in multiples of their own deviation."""
    pose_mix: Share = 0.0
    """Largest share of another frame's joints that is mixed into a frame's (drawn uniformly up to it): a network learns
    which pose a trajectory asks for, and follows commands better; too much of it makes limbs lazy."""
    pose_shrink: Share = 0.0
    """Largest share by which a frame's joints are moved towards the mean pose (drawn uniformly up to it), where a
    network freezes that has not learned the way out; 0.6 is what worked on real clips."""
    gait_swap: Share = 0.5
    """Share of samples that are given another frame's gaits: a network then follows the trajectory where the two
    disagree, as they do when a player asks for what no clip shows."""


class ClosedLoopParams(Section):
    """The scripts of commands by which the addressing mode is chosen; the one that is judged is fixed."""

    validation_seed: Seed
    validation_scripts: Count
    validation_seconds: Positive
    """Length of each."""


class MotionEvaluationParams(Section):
    """What is measured on held-out frames and in the closed loop."""

    closed_loop: ClosedLoopParams
    released: str | None = None
    """File (npz of control points) or folder (50 phases) of the published network, to be judged too; null without."""


class MotionRecipe(RecipeChanges):
    """What another recipe changes in an experiment of motion."""

    augmentation: dict[str, Any] = Field(default_factory=dict)


class MotionExperimentParams(Section):
    """All sections of one experiment with motion capture."""

    title: str
    recipe: Literal["default", "paper"] = "default"
    """Whether the sections below hold as they are, or with what `paper_recipe` changes."""
    paper_recipe: MotionRecipe = Field(default_factory=MotionRecipe)
    """What the paper does otherwise; its addressing holds for `baselines.addressing` too."""
    record: WalkerParams | None = None
    """How made-up clips are made; absent if there are real ones."""
    convert: MotionConvertParams
    features: MotionFeatureParams
    augmentation: AugmentationParams
    ensemble: EnsembleParams
    addressing: AddressingParams
    baselines: BaselinesParams
    evaluation: MotionEvaluationParams


FORM = MotionExperimentParams
"""What the params file says of an experiment of this kind."""
