"""Acrobot with a settable time step, torque noise and end, as the paper's second experiment needs it.

The paper simulates at 0.02 s, where Gymnasium's `Acrobot-v1` has 0.2 s, and records a part at zero torque from varied
starts (Section 4.2).
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.envs.classic_control.acrobot import AcrobotEnv
from jaxtyping import Bool, Float, Float32, Float64, Int64

from addressed_dynamics.base.errors import SpaceError

GRAVITY = 9.8
"""What the equations of motion of Gymnasium's Acrobot have, in m/s²."""
LINK_MASSES = (AcrobotEnv.LINK_MASS_1, AcrobotEnv.LINK_MASS_2)
"""What the links of Gymnasium's Acrobot weigh, in kg."""


class Acrobot(AcrobotEnv):
    """Gymnasium's `Acrobot-v1` with settable dynamics; of a step, the reward and the observation are the same.

    Args:
        time_step: simulated seconds of a step, integrated by one step of Runge and Kutta's method of fourth order.
        torque_noise: largest noise that is added to the torque, in N m, drawn uniformly at every step.
        ends_at_goal: whether an episode terminates when the tip is above the goal; else only a time limit ends it.
        start_angle: lowest and highest of both angles of a first state, in rad, drawn uniformly.
        start_velocity: lowest and highest of both velocities of a first state, in rad/s, drawn uniformly.
        link_masses: masses of the first link and of the second, in kg. Moments of inertia stay as they are: what a
            link has more sits in its middle.
        render_mode: as in Gymnasium.

    Raises:
        SpaceError: a number or a range is not one that Acrobot can have.
    """

    metadata = {  # noqa: RUF012 # Gymnasium declares it without ClassVar
        **AcrobotEnv.metadata,
        "addressed_dynamics": {
            "observation": (
                ("cos_angle_1", ""),
                ("sin_angle_1", ""),
                ("cos_angle_2", ""),
                ("sin_angle_2", ""),
                ("velocity_1", "rad/s"),
                ("velocity_2", "rad/s"),
            ),
            "action": ("torque_negative", "no_torque", "torque_positive"),
        },
    }

    def __init__(
        self,
        time_step: float = 0.02,
        torque_noise: float = 0.0,
        ends_at_goal: bool = True,
        start_angle: Sequence[float] = (-0.1, 0.1),
        start_velocity: Sequence[float] = (-0.1, 0.1),
        link_masses: Sequence[float] = LINK_MASSES,
        render_mode: str | None = None,
    ) -> None:
        super().__init__(render_mode=render_mode)
        if not 0.0 < time_step <= 1.0:
            message = f"time_step should be above 0 and at most 1 s, but is {time_step}"
            raise SpaceError(message)
        if not 0.0 <= torque_noise < math.inf:
            message = f"torque_noise should be at least 0 N m, but is {torque_noise}"
            raise SpaceError(message)
        if len(link_masses) != 2 or not all(0.0 < mass < math.inf for mass in link_masses):
            message = f"link_masses should be two numbers above 0 kg, but is {list(link_masses)}"
            raise SpaceError(message)
        self.dt, self.torque_noise_max = time_step, torque_noise
        self.LINK_MASS_1, self.LINK_MASS_2 = map(float, link_masses)
        self._ends_at_goal = ends_at_goal
        angle = _checked_range("start_angle", start_angle, math.pi)
        velocity = _checked_range("start_velocity", start_velocity, self.MAX_VEL_1)
        self._start_low, self._start_high = np.array([angle, angle, velocity, velocity]).T
        # The length of a step is this instance's, so the description of the class must not change.
        described = {**self.metadata["addressed_dynamics"], "step_seconds": time_step}
        self.metadata = {**self.metadata, "addressed_dynamics": described}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32[np.ndarray, "6"], dict[str, Any]]:
        """Draw a first state from the start ranges."""
        super().reset(seed=seed, options=options)
        self.state = self.np_random.uniform(self._start_low, self._start_high)
        return self._get_ob(), {}  # type: ignore[no-untyped-call] # Gymnasium's, without types

    def step(self, action: int) -> tuple[Float32[np.ndarray, "6"], float, bool, bool, dict[str, Any]]:
        """Advance by one step, as `Acrobot-v1` does; without `ends_at_goal` go on above the goal."""
        observation, reward, terminated, truncated, info = super().step(action)  # type: ignore[no-untyped-call] # as above
        return observation, reward, terminated and self._ends_at_goal, truncated, info


def acrobot_state(observation: Float[np.ndarray, "*batch 6"]) -> Float64[np.ndarray, "*batch 4"]:
    """Return the state that an observation shows: both angles in rad in [-pi, pi], and both velocities in rad/s.

    A cosine and a sine that belong to no angle, as a model may predict them, count as those of their direction.
    """
    cosine_1, sine_1, cosine_2, sine_2, velocity_1, velocity_2 = np.moveaxis(observation.astype(np.float64), -1, 0)
    angles = np.arctan2(sine_1, cosine_1), np.arctan2(sine_2, cosine_2)
    return np.stack([*angles, velocity_1, velocity_2], axis=-1)


def acrobot_observation(state: Float64[np.ndarray, "*batch 4"]) -> Float64[np.ndarray, "*batch 6"]:
    """Return the observation of a state; the environment shows it in single precision."""
    angle_1, angle_2, velocity_1, velocity_2 = np.moveaxis(state, -1, 0)
    shown = np.cos(angle_1), np.sin(angle_1), np.cos(angle_2), np.sin(angle_2), velocity_1, velocity_2
    return np.stack(shown, axis=-1)


def acrobot_step(
    state: Float64[np.ndarray, "*batch 4"],
    action: Int64[np.ndarray, "*batch"],
    time_step: float,
    link_masses: tuple[float, float] = LINK_MASSES,
) -> Float64[np.ndarray, "*batch 4"]:
    """Return the states after one step without torque noise, as `Acrobot` computes them, for many states at once.

    Args:
        state: both angles in rad (the second relative to the first) and both velocities in rad/s.
        action: 0, 1 and 2 for a torque of -1, 0 and 1 N m.
        time_step: length of the step in seconds, which is one step of Runge and Kutta's method of fourth order.
        link_masses: masses of both links, in kg.
    """
    torque = np.array(AcrobotEnv.AVAIL_TORQUE)[action]
    k1 = _derivative(state, torque, link_masses)
    k2 = _derivative(state + time_step / 2.0 * k1, torque, link_masses)
    k3 = _derivative(state + time_step / 2.0 * k2, torque, link_masses)
    k4 = _derivative(state + time_step * k3, torque, link_masses)
    after: Float64[np.ndarray, "*batch 4"] = state + time_step / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)
    angle, velocity = after[..., :2], after[..., 2:]
    angle -= 2.0 * np.pi * np.rint(angle / (2.0 * np.pi))
    fastest = np.array([AcrobotEnv.MAX_VEL_1, AcrobotEnv.MAX_VEL_2])
    np.clip(velocity, -fastest, fastest, out=velocity)
    return after


def acrobot_reward(
    state: Float[np.ndarray, "batch 6"],  # noqa: ARG001 - the form of all functions of reward and end
    action: Int64[np.ndarray, " batch"],  # noqa: ARG001 - as above
    next_state: Float[np.ndarray, "batch 6"],
) -> tuple[Float64[np.ndarray, " batch"], Bool[np.ndarray, " batch"]]:
    """Return reward and end of steps of Gymnasium's `Acrobot-v1`: -1 for each, but 0 where the tip is above the goal.

    The states are observations.
    """
    angle_1, angle_2, *_ = np.moveaxis(acrobot_state(next_state), -1, 0)
    above = -np.cos(angle_1) - np.cos(angle_1 + angle_2) > 1.0
    return np.where(above, 0.0, -1.0), above


def acrobot_energy(
    state: Float64[np.ndarray, "*batch 4"], link_masses: tuple[float, float] = LINK_MASSES
) -> Float64[np.ndarray, "*batch"]:
    """Return the energy of the double pendulum, in J: constant where no torque acts and no velocity is bounded.

    Args:
        state: both angles in rad (the second relative to the first) and both velocities in rad/s.
        link_masses: masses of both links, in kg.
    """
    angle_1, angle_2, velocity_1, velocity_2 = np.moveaxis(state, -1, 0)
    (mass_1, mass_2), length = link_masses, AcrobotEnv.LINK_LENGTH_1
    middle_1, middle_2, inertia = AcrobotEnv.LINK_COM_POS_1, AcrobotEnv.LINK_COM_POS_2, AcrobotEnv.LINK_MOI
    coupling = mass_2 * length * middle_2 * np.cos(angle_2)
    outer = mass_2 * middle_2**2 + inertia
    inner = mass_1 * middle_1**2 + inertia + mass_2 * length**2 + outer + 2 * coupling
    kinetic = inner * velocity_1**2 / 2 + (outer + coupling) * velocity_1 * velocity_2 + outer * velocity_2**2 / 2
    height = (mass_1 * middle_1 + mass_2 * length) * np.cos(angle_1) + mass_2 * middle_2 * np.cos(angle_1 + angle_2)
    energy: Float64[np.ndarray, "*batch"] = kinetic - GRAVITY * height
    return energy


def _derivative(
    state: Float64[np.ndarray, "*batch 4"], torque: Float64[np.ndarray, "*batch"], link_masses: tuple[float, float]
) -> Float64[np.ndarray, "*batch 4"]:
    """Return the velocities and accelerations: the equations of motion of the book that Gymnasium's Acrobot cites."""
    angle_1, angle_2, velocity_1, velocity_2 = np.moveaxis(state, -1, 0)
    (mass_1, mass_2), length = link_masses, AcrobotEnv.LINK_LENGTH_1
    middle_1, middle_2, inertia = AcrobotEnv.LINK_COM_POS_1, AcrobotEnv.LINK_COM_POS_2, AcrobotEnv.LINK_MOI
    cosine_2, sine_2 = np.cos(angle_2), np.sin(angle_2)
    reach = length**2 + middle_2**2 + 2 * length * middle_2 * cosine_2
    d1 = mass_1 * middle_1**2 + mass_2 * reach + inertia + inertia
    d2 = mass_2 * (middle_2**2 + length * middle_2 * cosine_2) + inertia
    phi2 = mass_2 * middle_2 * GRAVITY * np.cos(angle_1 + angle_2 - np.pi / 2.0)
    phi1 = (
        -mass_2 * length * middle_2 * velocity_2**2 * sine_2
        - 2 * mass_2 * length * middle_2 * velocity_2 * velocity_1 * sine_2
        + (mass_1 * middle_1 + mass_2 * length) * GRAVITY * np.cos(angle_1 - np.pi / 2.0)
        + phi2
    )
    pull = torque + d2 / d1 * phi1 - mass_2 * length * middle_2 * velocity_1**2 * sine_2 - phi2
    acceleration_2 = pull / (mass_2 * middle_2**2 + inertia - d2**2 / d1)
    acceleration_1 = -(d2 * acceleration_2 + phi1) / d1
    return np.stack([velocity_1, velocity_2, acceleration_1, acceleration_2], axis=-1)


def _checked_range(name: str, value: Sequence[float], largest: float) -> tuple[float, float]:
    if len(value) != 2 or not -largest <= value[0] <= value[1] <= largest:
        message = f"{name} should be two increasing numbers in {-largest:.4g}..{largest:.4g}, but is {list(value)}"
        raise SpaceError(message)
    return float(value[0]), float(value[1])
