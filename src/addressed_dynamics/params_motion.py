"""The sections of a params file that only motion capture has."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from addressed_dynamics.params_base import Count, Dropout, OptimiserParams, Positive, Section, Share


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
