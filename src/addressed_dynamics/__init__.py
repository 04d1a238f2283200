"""From logs of an agent to a learned simulator of it: specialised networks and the network that addresses them."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from addressed_dynamics.episodes.motion import Motion
    from addressed_dynamics.episodes.transitions import Transitions
    from addressed_dynamics.logs import write_log
    from addressed_dynamics.planning.cem import CEM
    from addressed_dynamics.planning.mppi import MPPI
    from addressed_dynamics.policies.policy import Policy, load_policy
    from addressed_dynamics.recording.recorder import TransitionRecorder
    from addressed_dynamics.simulators.addressed import AddressedDynamics
    from addressed_dynamics.simulators.exporting import export_model
    from addressed_dynamics.simulators.motion import MotionModel
    from addressed_dynamics.simulators.portable import StepModule
    from addressed_dynamics.sources.motion.source import read_motion
    from addressed_dynamics.sources.transitions.reading import read_transitions
    from addressed_dynamics.training.clustering import assign_to_bins

__all__ = [
    "CEM",
    "MPPI",
    "AddressedDynamics",
    "Motion",
    "MotionModel",
    "Policy",
    "StepModule",
    "TransitionRecorder",
    "Transitions",
    "assign_to_bins",
    "export_model",
    "load_policy",
    "read_motion",
    "read_transitions",
    "write_log",
]

_HOMES = {
    "AddressedDynamics": "addressed_dynamics.simulators.addressed",
    "CEM": "addressed_dynamics.planning.cem",
    "MPPI": "addressed_dynamics.planning.mppi",
    "Motion": "addressed_dynamics.episodes.motion",
    "MotionModel": "addressed_dynamics.simulators.motion",
    "Policy": "addressed_dynamics.policies.policy",
    "StepModule": "addressed_dynamics.simulators.portable",
    "TransitionRecorder": "addressed_dynamics.recording.recorder",
    "Transitions": "addressed_dynamics.episodes.transitions",
    "assign_to_bins": "addressed_dynamics.training.clustering",
    "export_model": "addressed_dynamics.simulators.exporting",
    "load_policy": "addressed_dynamics.policies.policy",
    "read_motion": "addressed_dynamics.sources.motion.source",
    "read_transitions": "addressed_dynamics.sources.transitions.reading",
    "write_log": "addressed_dynamics.logs",
}


def __getattr__(name: str) -> Any:
    """Import a name of the front door when it is first used: reading a log must not cost an import of torch."""
    if name not in _HOMES:
        message = f"module 'addressed_dynamics' has no attribute '{name}'"
        raise AttributeError(message)
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
