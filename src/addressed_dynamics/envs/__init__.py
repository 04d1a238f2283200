"""The paper's variants of Gymnasium's environments; importing this package registers them, and the learned one.

Each environment says what its numbers mean in `metadata["addressed_dynamics"]`: a dictionary with

* `observation`: one `(name, unit)` pair per dimension,
* `action`: one name per action if actions are discrete, else one `(name, unit)` pair per dimension,
* `step_seconds`: simulated seconds between two steps.
"""

import gymnasium

from addressed_dynamics.envs.acrobot import (
    Acrobot,
    acrobot_energy,
    acrobot_observation,
    acrobot_reward,
    acrobot_state,
    acrobot_step,
)
from addressed_dynamics.envs.mountain_car import MountainCarContinuing, mountain_car_reward, mountain_car_step
from addressed_dynamics.episodes.transitions import LEARNED

__all__ = [
    "ACROBOT",
    "CONTINUING_MOUNTAIN_CAR",
    "LEARNED",
    "Acrobot",
    "MountainCarContinuing",
    "acrobot_energy",
    "acrobot_observation",
    "acrobot_reward",
    "acrobot_state",
    "acrobot_step",
    "mountain_car_reward",
    "mountain_car_step",
]

ACROBOT = "addressed_dynamics/Acrobot-v0"
"""Gymnasium identifier of the Acrobot with a settable time step, torque noise and end."""

CONTINUING_MOUNTAIN_CAR = "addressed_dynamics/MountainCarContinuing-v0"
"""Gymnasium identifier of the MountainCar that does not end at the goal."""

gymnasium.register(
    id=CONTINUING_MOUNTAIN_CAR,
    entry_point="addressed_dynamics.envs.mountain_car:MountainCarContinuing",
    max_episode_steps=1000,
)
gymnasium.register(id=ACROBOT, entry_point="addressed_dynamics.envs.acrobot:Acrobot", max_episode_steps=1000)
gymnasium.register(
    id=LEARNED,
    entry_point="addressed_dynamics.simulators.environment:LearnedEnvironment",
    vector_entry_point="addressed_dynamics.simulators.environment:LearnedEnvironments",
    max_episode_steps=1000,
)
