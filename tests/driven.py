"""Drives of small models: a car beside its environment, an arm and a boat alone."""

import json
from pathlib import Path
from typing import Any

from learned_worlds import learned
from trusted_models import drifting, write_models

from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.drive.session import Said, Session
from addressed_dynamics.drive.transitions import DrivenWorld, TransitionsSession
from addressed_dynamics.envs import CONTINUING_MOUNTAIN_CAR
from addressed_dynamics.evaluation.transitions.starting import starts_of
from addressed_dynamics.simulators.starts import write_starts
from addressed_dynamics.simulators.worlds import World

CAR_ENVIRONMENT = EnvironmentParams(id=CONTINUING_MOUNTAIN_CAR)


def driven(world: str, history: int = 1, environment: EnvironmentParams | None = None) -> DrivenWorld:
    """A model of random networks to drive."""
    made = learned(world, history)
    return DrivenWorld(world, Path("models") / world, World.of(made.model, starts=made.starts), None, environment)


def session_of(of: DrivenWorld, folder: Path, seed: int = 3) -> TransitionsSession:
    """A drive that has begun."""
    session = of.session(seed, folder)
    session.reset()
    return session


def say(session: Session, kind: str, **values: Any) -> list[Said]:
    """Say something as a page does."""
    return session.hear(json.dumps({"type": kind, **values}))


def steps(session: Session, number: int) -> list[Said]:
    """Let some steps go by, and return their frames."""
    return [session.tick()[-1] for _ in range(number)]


def write_drift(folder: Path) -> Path:
    """Write models with where they start."""
    write_models(folder)
    write_starts(folder, starts_of(drifting(6, 0), 1))
    return folder
