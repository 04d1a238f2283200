"""The sections of a params file that only motion capture has."""

from __future__ import annotations

from typing import Literal

from addressed_dynamics.params_base import Positive, Section


class MotionFeatureParams(Section):
    """What the networks of a motion model are given and asked for."""

    target: Literal["absolute", "change"]
    """`absolute`: the outputs themselves, as in the paper; `change`: what they add to persistence, where an input says
    the same of the frame before."""
    joint_input_weight: Positive = 0.1
    """Size of the normalised joint inputs beside those of the trajectory; PFNN has 0.1, so that a network listens to
    commands (and phase) rather than to the pose before."""
