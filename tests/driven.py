"""Drives of small models: a car beside its environment, an arm and a boat alone, a character."""

import json
from pathlib import Path
from typing import Any

import torch
from learned_worlds import learned
from motions import make_motion
from trusted_models import drifting, write_models

from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.drive.motion import DrivenMotion, MotionSession
from addressed_dynamics.drive.session import Said, Session
from addressed_dynamics.drive.transitions import DrivenWorld, TransitionsSession
from addressed_dynamics.envs import CONTINUING_MOUNTAIN_CAR
from addressed_dynamics.evaluation.transitions.starting import starts_of
from addressed_dynamics.features.motion.features import fit_motion_features
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.motion import MotionModel
from addressed_dynamics.simulators.starts import write_starts
from addressed_dynamics.simulators.worlds import World
from addressed_dynamics.sources.motion.params import MotionFeatureParams

MOTION = make_motion(rows=24)
FEATURES = fit_motion_features(MOTION, MotionFeatureParams(target="absolute"))
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


def motion_model() -> MotionModel:
    """A character that hardly leaves its mean pose, and so does not lose itself."""
    return MotionModel(FEATURES, _stack(3, 342, 8, 311), _stack(1, 342, 8, 3, seed=1))


def walker(folder: Path, *, beside: bool = True) -> MotionSession:
    """A drive of a character, and of another one beside it."""
    other = MotionModel(FEATURES, _stack(4, 342, 8, 311, seed=2), mode="phase") if beside else None
    names = ("model", "PFNN") if beside else ("model",)
    return DrivenMotion("walker", Path("models/pfnn"), motion_model(), other, names).session(0, folder)


def _stack(members: int, *widths: int, seed: int = 0) -> StackedMLP:
    made = StackedMLP(members, widths, "elu", torch.Generator().manual_seed(seed)).requires_grad_(False)
    for weight in made.weights:
        weight.mul_(0.02)
    return made
