"""The sections of a params file that only motion capture has."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from addressed_dynamics.params_base import Count, Dropout, OptimiserParams, Positive, Section, Seed, Share


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
    pose_mix: Share = 0.5
    """Largest share of another frame's joints that is mixed into a frame's (drawn uniformly up to it): a mixture is
    nearer to the mean pose, where a network freezes that has not learned the way out of it."""
    gait_swap: Share = 0.5
    """Share of samples that are given another frame's gaits: a network then follows the trajectory where the two
    disagree, as they do when a player asks for what no clip shows."""


class BlendedTraining(Section):
    """Networks whose parameters are mixed for every frame, by its phase or by a gate that is trained with them."""

    hidden: tuple[Count, ...]
    """Widths of the hidden layers."""
    gate_hidden: tuple[Count, ...]
    """Widths of the gate's hidden layers; of no use where the phase mixes."""
    members: Count
    """Networks that a gate mixes; a phase-functioned network has 4 control points."""
    activation: Literal["relu", "tanh", "elu"]
    loss: Literal["mse", "mae", "mae+mse"]
    optimiser: OptimiserParams
    batch_size: Count
    epochs: Count
    dropout: Dropout = 0.3
    """Share of every layer's inputs that are set to 0 in an update."""
    weight_penalty: Annotated[float, Field(ge=0.0)] = 0.01
    """Weight in the loss of the mean absolute value of the parameters, a mean over the layers' weights and biases."""
