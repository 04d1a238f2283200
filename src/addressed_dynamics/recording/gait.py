"""A gait that nobody has learned: a spring and a damper draw every joint after a sine.

With a gait for each copy, and another one after a while, contacts, falls and steps forward come without a trained
policy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import Space, spaces
from jaxtyping import Bool, Float64, Int64

from addressed_dynamics.base.errors import RecordingError
from addressed_dynamics.base.params.recording import GaitBehaviour
from addressed_dynamics.episodes.transitions import SpaceSpec
from addressed_dynamics.recording.behaviours import Actions, Observations


@dataclass
class Gaits:
    """A gait for each of several copies, and where in it they are."""

    steps_left: Int64[np.ndarray, " copy"]
    """Steps until the next gait."""
    angle: Float64[np.ndarray, "copy 1"]
    """Of the period, how much has passed since the gait began, in rad."""
    turn: Float64[np.ndarray, "copy 1"]
    """The same for one step."""
    stiffness: Float64[np.ndarray, "copy 1"]
    """Action for each unit by which an angle is off."""
    centre: Float64[np.ndarray, "copy joint"]
    """Angles that the joints swing about."""
    swing: Float64[np.ndarray, "copy joint"]
    """How far they swing to either side."""
    phase: Float64[np.ndarray, "copy joint"]
    """Where in its sine each is when the gait begins, in rad."""

    @staticmethod
    def drawn(params: GaitBehaviour, copies: int, generator: np.random.Generator) -> Gaits:
        """Draw a variation of one gait for each copy."""
        joints, spread = params.joints, params.variation
        period, stiffness = np.exp(spread * generator.normal(size=(2, copies, 1)))
        swing, centre, phase = spread * generator.normal(size=(3, copies, len(joints)))
        return Gaits(
            steps_left=generator.geometric(1.0 / params.mean_gait_steps, copies),
            angle=np.zeros((copies, 1)),
            turn=2 * np.pi / (params.period_steps * period),
            stiffness=params.stiffness * stiffness,
            centre=np.array([joint.centre for joint in joints]) + centre,
            swing=np.array([joint.swing for joint in joints]) * np.exp(swing),
            phase=np.array([joint.phase for joint in joints]) + phase,
        )

    def replace(self, beginning: Bool[np.ndarray, " copy"], others: Gaits) -> None:
        """Give these copies their gaits from `others`."""
        for name, values in vars(others).items():
            getattr(self, name)[beginning] = values[beginning]

    def wanted(self) -> Float64[np.ndarray, "copy joint"]:
        """Return the angles that the joints should have in this step, and go on to the next."""
        angles: Float64[np.ndarray, "copy joint"] = self.centre + self.swing * np.sin(self.angle + self.phase)
        self.angle += self.turn
        self.steps_left -= 1
        return angles


class GaitPolicy:
    """The policy by which every copy moves its joints.

    Args:
        params: the gait that all are variations of.
        names: what the dimensions of the state are called.
        space: the space of the actions.
        copies: number of environment copies.
        generator: source of the random numbers.

    Raises:
        RecordingError: the actions are not a bounded component for each joint, or the state has no such dimension.
    """

    def __init__(
        self, params: GaitBehaviour, names: SpaceSpec, space: Space[Any], copies: int, generator: np.random.Generator
    ) -> None:
        joints = params.joints
        if not isinstance(space, spaces.Box) or not space.is_bounded("both") or space.shape != (len(joints),):
            message = (
                f"a gait needs a bounded action for each of its joints ({', '.join(joint.name for joint in joints)}), "
                f"but the environment has {space}; change 'joints' in the recording plan"
            )
            raise RecordingError(message)
        self._params, self._space, self._copies, self._generator = params, space, copies, generator
        self._angles = [_place(joint.angle, names) for joint in joints]
        self._velocities = [_place(joint.velocity, names) for joint in joints]
        self._noise = params.noise * (space.high - space.low) / 2.0
        self._gaits = Gaits.drawn(params, copies, generator)

    def begin(self, copy: int) -> None:
        """Let a copy begin a new gait, as an episode of its own begins."""
        self._gaits.steps_left[copy] = 0

    def __call__(self, observations: Observations) -> Actions:
        """Return the actions of all copies."""
        gaits, params = self._gaits, self._params
        # Drawn at every step: the numbers that a copy is given do not hang on when another begins a gait.
        gaits.replace(gaits.steps_left == 0, Gaits.drawn(params, self._copies, self._generator))
        off = gaits.wanted() - observations[:, self._angles]
        wanted = gaits.stiffness * off - params.damping * observations[:, self._velocities]
        noisy = wanted + self._noise * self._generator.normal(size=wanted.shape)
        actions: Actions = noisy.clip(self._space.low, self._space.high).astype(self._space.dtype)
        return actions


def _place(name: str, names: SpaceSpec) -> int:
    known = names.observation_names
    if name not in known:
        message = (
            f"a joint of a gait names '{name}', which is no dimension of the state ({', '.join(known)}); "
            "change 'joints' in the recording plan"
        )
        raise RecordingError(message)
    return known.index(name)
