"""Rollouts of Acrobot in the terms of mechanics: their angles and energy, and what is possible at best.

Fast swings of a double pendulum are chaotic, and no model follows them for long. How long one could is what the true
equations of motion show: two simulations that start a little apart, and one that starts from the recorded state, which
the log keeps in single precision.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.envs import Acrobot, acrobot_energy, acrobot_observation, acrobot_state, acrobot_step
from addressed_dynamics.episodes.transitions import DiscreteAction, SpaceSpec
from addressed_dynamics.evaluation.common.bootstrap import FEWEST_ROLLOUTS
from addressed_dynamics.evaluation.transitions.spreads import spread
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts

ANGLE_LIMIT = 0.5
"""A rollout has lost the truth when one of its angles is off by more than this, in rad."""
ONE_STEP_TOLERANCE = 1e-4
"""A recorded step of Acrobot departs from the simulated one by less than this: single precision alone is to blame."""

TRUTH = "truth"
"""Name of the recording itself beside the models."""
ROUNDING = "simulator/rounding"
"""Name of the simulation from the recorded first state."""
TWIN = "simulator/twin"
"""Name of the simulation that starts a little apart from that one."""
SIMULATIONS = (TRUTH, ROUNDING, TWIN)
"""What stands beside the models."""


@dataclass(frozen=True)
class Course:
    """How rollouts run beside the truth, step by step."""

    angle_error: Float64[np.ndarray, "episode step angle"]
    """Error of both angles on the shorter way round, in rad, at least 0."""
    energy_error: Float64[np.ndarray, "episode step"]
    """Difference from the true energy at the same time, in J, at least 0."""
    energy_drift: Float64[np.ndarray, "episode step"]
    """Difference from the energy of the rollout's first state, in J, at least 0: at zero torque what should not be."""

    @property
    def values(self) -> dict[str, Float64[np.ndarray, "episode step"]]:
        """All by name; `angle_error` is the larger one of both angles."""
        return {
            "angle_1_error": self.angle_error[..., 0],
            "angle_2_error": self.angle_error[..., 1],
            "angle_error": self.angle_error.max(axis=-1),
            "energy_error": self.energy_error,
            "energy_drift": self.energy_drift,
        }

    def summary(self, members: Bool[np.ndarray, " episode"], step_seconds: float) -> dict[str, Any] | None:
        """Return the numbers of some of the episodes; None if there are none.

        `lost_seconds` is the time until an angle is off by more than `ANGLE_LIMIT`; the energy error is its mean over a
        rollout, the drift that at its end.
        """
        if not members.any():
            return None
        return {
            "lost_seconds": _time_until(self.angle_error[members].max(axis=-1) > ANGLE_LIMIT, step_seconds),
            "energy_error": spread(self.energy_error[members].mean(axis=1)),
            "energy_drift": spread(self.energy_drift[members, -1]),
        }


@dataclass(frozen=True)
class Simulation:
    """States that the true equations of motion give, and what they are held against."""

    name: str
    """Unique among candidates."""
    label: str
    """What a reader should see."""
    states: Float64[np.ndarray, "episode step observation"]
    """States after each action."""
    reference: TrueRollouts
    """What takes the place of the truth."""


def acrobot_course(
    predicted: Float64[np.ndarray, "episode step observation"], states: Float64[np.ndarray, "episode time observation"]
) -> Course:
    """Hold predicted observations against the true ones, of which the first is that before any action."""
    found, true = acrobot_state(predicted), acrobot_state(states)
    apart = found[..., :2] - true[:, 1:, :2]
    energy, true_energy = acrobot_energy(found), acrobot_energy(true)
    return Course(
        angle_error=np.abs(apart - 2.0 * np.pi * np.rint(apart / (2.0 * np.pi))),
        energy_error=np.abs(energy - true_energy[:, 1:]),
        energy_drift=np.abs(energy - true_energy[:, :1]),
    )


def simulate(truth: TrueRollouts, step_seconds: float, apart: float) -> Iterator[Simulation]:
    """Yield what is possible at best: the recording itself, and two simulations under the recorded actions.

    Args:
        truth: the recording.
        step_seconds: length of a step.
        apart: what is added to the first angle of the second simulation, in rad; it is held against the first.
    """
    yield Simulation(TRUTH, "the recording itself", truth.states[:, 1:], truth)
    first = acrobot_state(truth.states[:, 0])
    base = acrobot_observation(_simulated(first, truth.actions, step_seconds))
    yield Simulation(ROUNDING, "true simulator, from the recorded start", base[:, 1:], truth)
    twin = acrobot_observation(_simulated(first + np.array([apart, 0.0, 0.0, 0.0]), truth.actions, step_seconds))
    yield Simulation(TWIN, "two true simulations, a little apart", twin[:, 1:], replace(truth, states=base))


def check_recording(truth: TrueRollouts, spaces: SpaceSpec) -> None:
    """Make sure that the recording follows the equations of motion.

    Raises:
        EvaluationError: it is not of Acrobot, or of one with torque noise.
    """
    names = tuple(name for name, _ in Acrobot.metadata["addressed_dynamics"]["observation"])
    if spaces.observation_names != names or not isinstance(spaces.action, DiscreteAction) or spaces.action.count != 3:
        message = (
            f"evaluation.rollouts.physics is 'acrobot', which needs the observation {', '.join(names)} and 3 discrete "
            f"actions, but the recording has {', '.join(spaces.observation_names)}; leave 'physics' out"
        )
        raise EvaluationError(message)
    if spaces.exogenous:
        message = (
            "evaluation.rollouts.physics is 'acrobot', whose equations of motion know no exogenous inputs, but the "
            f"recording has {', '.join(each.name for each in spaces.exogenous)}; leave 'physics' out"
        )
        raise EvaluationError(message)
    after = acrobot_step(acrobot_state(truth.states[:, :-1]), truth.actions.astype(np.int64), spaces.step_seconds)
    departure = np.abs(acrobot_observation(after) - truth.states[:, 1:]).max(axis=(0, 1))
    worst = int(departure.argmax())
    if departure[worst] > ONE_STEP_TOLERANCE:
        message = (
            "evaluation.rollouts.physics is 'acrobot', but a recorded step departs from the simulated one by "
            f"{departure[worst]:.2g} ({names[worst]}), which is more than {ONE_STEP_TOLERANCE:g}; "
            "leave 'physics' out if there is torque noise, or if this is not Acrobot"
        )
        raise EvaluationError(message)


def _simulated(
    first: Float64[np.ndarray, "episode 4"], actions: Int64[np.ndarray, "episode step"], step_seconds: float
) -> Float64[np.ndarray, "episode time 4"]:
    states = np.empty((len(first), actions.shape[1] + 1, first.shape[1]))
    states[:, 0] = first
    for step in range(actions.shape[1]):
        states[:, step + 1] = acrobot_step(states[:, step], actions[:, step], step_seconds)
    return states


def _time_until(event: Bool[np.ndarray, "episode step"], step_seconds: float) -> dict[str, float | None]:
    """Return percentiles of the time until `event`, and the share of episodes in which it never comes.

    A percentile is the time of one of the episodes; None where it would lie beyond the end, in an episode without the
    event. Of fewer than `FEWEST_ROLLOUTS` there is only the median.
    """
    never = ~event.any(axis=1)
    ends = np.where(never, np.inf, (event.argmax(axis=1) + 1) * step_seconds)
    shares = {"p10": 0.1, "median": 0.5, "p90": 0.9}
    known = len(ends) >= FEWEST_ROLLOUTS
    found = {name: float(np.quantile(ends, share, method="inverted_cdf")) for name, share in shares.items()}
    return {
        **{
            name: seconds if np.isfinite(seconds) and (known or name == "median") else None
            for name, seconds in found.items()
        },
        "never_share": float(never.mean()),
    }
