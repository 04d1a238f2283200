"""Drives of states and actions: the model beside the truth, or alone from a recorded start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from jaxtyping import Float32

from addressed_dynamics.base.errors import DriveError, ModelError, RecordingError
from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.drive.finding import Named, environment_of
from addressed_dynamics.drive.imagined import COVERAGE, Calibrated, Imagined, Predicted
from addressed_dynamics.drive.protocol import Act, AnyMessage, Exogenous, Plain
from addressed_dynamics.drive.recorder import DriveRecorder, Recorded, driven_by_hand, imagined_by_hand
from addressed_dynamics.drive.session import Said, Session, plain
from addressed_dynamics.drive.truth import Happened, Truth
from addressed_dynamics.episodes.transitions import Dimension, DiscreteAction, SpaceSpec
from addressed_dynamics.logs import RunInfo
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.spaces import check_bounds, checked_actions
from addressed_dynamics.simulators.worlds import World


@dataclass(frozen=True)
class DrivenWorld:
    """What all pages drive: a model, and the environment beside it."""

    title: str
    folder: Path
    world: World
    calibrated: Calibrated | None
    environment: EnvironmentParams | None

    @staticmethod
    def load(named: Named, candidate: str | None = None, environment: str | None = None) -> DrivenWorld:
        """Load a model.

        Args:
            named: where it is.
            candidate: which of the models there; None for what is delivered.
            environment: Gymnasium identifier of what is modelled; None to look for it.

        Raises:
            ModelError: there is no such model, or there is neither an environment nor a recorded start.
            DriveError: the environment has other spaces.
        """
        model = AddressedDynamics.load(named.folder, candidate=candidate)
        world = World.of(model, starts=named.folder)
        beside = environment_of(named, model.features.spaces, environment)
        if beside is None and world.starts is None:
            message = f"{world.no_starts}; or name the environment that is modelled with --environment"
            raise ModelError(message)
        calibrated = None if world.trust is None else Calibrated(world.trust)
        return DrivenWorld(named.title, named.folder, world, calibrated, beside)

    def session(self, seed: int, folder: Path) -> TransitionsSession:
        """Return a drive of its own for a page; its recordings go into `folder`."""
        return TransitionsSession(self, seed, folder)


class TransitionsSession(Session):
    """One page's drive."""

    def __init__(self, driven: DrivenWorld, seed: int, folder: Path) -> None:
        """Begin it.

        Args:
            driven: what is driven.
            seed: of where it starts; each start has one of its own.
            folder: where recordings go.

        Raises:
            DriveError: the environment cannot be made any more.
        """
        self._driven = driven
        self._world = driven.world
        self._spaces = driven.world.model.features.spaces
        self.step_seconds = self._spaces.step_seconds
        self._truth = self._make_truth()
        super().__init__(DriveRecorder(folder, self._truth.spaces if self._truth else self._spaces))
        space = self._world.observation_space
        self._imagined = Imagined(self._world.model, driven.calibrated, np.stack([space.low, space.high]))
        self._seed = seed
        self._neutral = neutral_action(self._spaces, *_action_bounds(self._world))
        self._given: Float32[np.ndarray, " exogenous"] | None = None
        self._action = self._neutral
        self._step = self._row = self._stop = 0
        self._ended = ""

    def hello(self) -> Said:
        """Return names, units, bounds and what can be done."""
        driven, model = self._driven, self._world.model
        environment = driven.environment
        starts = self._world.starts
        low, high = _action_bounds(self._world)
        observed = None if starts is None else starts.observation[:, -1]
        recorded = None if starts is None or not self._spaces.exogenous else starts.exogenous
        action: dict[str, Any] = {"kind": "discrete", "names": list(_names(self._spaces)), "neutral": 0}
        if isinstance(self._spaces.action, DiscreteAction):
            action["neutral"] = int(self._neutral)
        else:
            dimensions = _described(self._spaces.action.dimensions, np.stack([low, high]))
            action = {"kind": "continuous", "dimensions": dimensions, "neutral": plain(self._neutral)}
        return {
            "type": "hello",
            "kind": "transitions",
            "title": driven.title,
            "model": _model_words(model),
            "environment": None if environment is None else _environment_words(environment),
            "observation": _described(self._spaces.observation, observed, as_recorded=True),
            "action": action,
            "exogenous": _described(self._spaces.exogenous, recorded),
            "members": model.ensemble.members,
            "calibrated": driven.calibrated is not None,
            "coverage": COVERAGE if driven.calibrated is not None and driven.calibrated.covers else None,
            "step_seconds": self.step_seconds,
            "rate": self.rate,
        }

    def reset(self) -> Said:
        """Start anew: where the environment does, or at a recorded state."""
        self.begin_episode(self._seed)
        self._step, self._ended = 0, ""
        self._action = self._neutral
        if self._truth is not None:
            self._truth.reset(self._seed, self._neutral, self._happened)
            self._from_truth()
        else:
            self._from_recording()
        self._seed += 1
        return {**self._frame(None), "start": True}

    def step(self) -> Said:
        """Take the action that is held, in the model and in truth; does nothing once an episode has ended."""
        if self._ended:
            return self._frame(None)
        exogenous = self._now()
        if self._ended:
            return self._frame(None)
        before, action = self._imagined.state, self._action
        predicted = self._imagined.step(action, exogenous)
        if self._truth is not None:
            self._happened(self._truth.step(action))
        else:
            self._predicted(before, action, predicted, exogenous)
        if not predicted.finite and not self._ended:
            self._ended = "not_finite"
        self._row += 1
        return self._frame(predicted)

    def take(self, message: AnyMessage) -> Said | None:
        """Take an action or an exogenous input from now on, or the true state for the model's.

        Raises:
            DriveError: it is outside the space, or there is no truth.
        """
        match message:
            case Act(action=action):
                self._action = self._checked(action)
                return None
            case Exogenous(values=values):
                self._given = None if values is None else self._checked_exogenous(values)
                if self._ended == "exogenous" and values is not None:
                    self._ended = ""
                return None
            case Plain(type="sync"):
                if self._truth is None:
                    refusal = "there is no truth beside this model, whose state it could take"
                    raise DriveError(refusal)
                self._from_truth()
                self._ended = "" if self._ended == "not_finite" else self._ended
                return self._frame(None)
            case _:
                refusal = f"a world of states and actions knows no '{message.type}'"
                raise DriveError(refusal)

    def run_info(self) -> RunInfo:
        """Return what a recording says of itself: the environment, or that it is what a model predicts."""
        if self._driven.environment is not None and self._truth is not None:
            return driven_by_hand(self._driven.environment.id, dict(self._driven.environment.kwargs))
        model = self._world.model
        return imagined_by_hand(self._driven.folder, model.origin, model.mode)

    def close(self) -> Path | None:
        """End the drive."""
        try:
            return super().close()
        finally:
            if self._truth is not None:
                self._truth.close()

    def _make_truth(self) -> Truth | None:
        if self._driven.environment is None:
            return None
        try:
            return Truth(self._driven.environment, self._world.history)
        except RecordingError as error:
            raise DriveError(str(error)) from error

    def _from_truth(self) -> None:
        assert self._truth is not None
        none = np.empty((self._world.history - 1, 0), np.float32)
        self._row = self._stop = 0
        self._imagined.start(self._truth.frames, self._truth.actions, none)

    def _from_recording(self) -> None:
        """Start the model at a recorded state."""
        starts, past = self._world.starts, self._world.history - 1
        assert starts is not None
        candidates = self._world.candidates
        drawn = int(candidates[np.random.default_rng(self._seed).integers(len(candidates))])
        first = starts.frames - past - 1
        # Starts may hold more frames than this model is given.
        self._row, self._stop = int(starts.row[drawn]) + first + past, int(starts.stop[drawn])
        exogenous = np.empty((past, 0), np.float32)
        if self._spaces.exogenous:
            exogenous = starts.exogenous[self._row - past : self._row]
        self._imagined.start(starts.observation[drawn, first:], starts.action[drawn, first:], exogenous)

    def _now(self) -> Float32[np.ndarray, " exogenous"]:
        """Return the exogenous inputs during the coming step; the episode ends where nothing more was recorded."""
        width = len(self._spaces.exogenous)
        if self._given is not None or not width:
            return np.empty(0, np.float32) if self._given is None else self._given
        starts = self._world.starts
        if starts is None or self._row >= self._stop:
            self._ended = "exogenous"
            return np.zeros(width, np.float32)
        row: Float32[np.ndarray, " exogenous"] = starts.exogenous[self._row]
        return row

    def _happened(self, happened: Happened) -> None:
        """Count and record a true step."""
        step, self._step = self._step, self._step + 1
        if happened.terminated or happened.truncated:
            self._ended = "terminated" if happened.terminated else "truncated"
        self.record(Recorded(step, *happened))

    def _predicted(
        self, before: np.ndarray, action: np.ndarray, predicted: Predicted, exogenous: Float32[np.ndarray, " exogenous"]
    ) -> None:
        """Count and record a step of a model that is alone."""
        step, self._step = self._step, self._step + 1
        if not predicted.finite:
            return
        given = int(action) if action.ndim == 0 else action.tolist()
        self.record(Recorded(step, before, given, 0.0, predicted.state, exogenous=exogenous.tolist()))

    def _frame(self, predicted: Predicted | None) -> Said:
        """Return what there is to see."""
        interval = None if predicted is None else predicted.interval
        exogenous = self._shown_exogenous()
        return {
            "type": "frame",
            "step": self._step,
            "model": plain(self._imagined.state),
            "truth": None if self._truth is None else plain(self._truth.state),
            "interval": None if interval is None else [plain(each) for each in interval],
            "trust": None if predicted is None or predicted.trust is None else round(predicted.trust, 4),
            "network": None if predicted is None else predicted.network,
            "weights": None if predicted is None else plain(predicted.weights, 3),
            "action": int(self._action) if self._action.ndim == 0 else plain(self._action),
            "exogenous": exogenous,
            "ended": self._ended,
            "recorded": self.recorder.count if self.recorder.recording else None,
        }

    def _shown_exogenous(self) -> list[float | None]:
        if self._given is not None:
            return plain(self._given)
        starts = self._world.starts
        if starts is None or not self._spaces.exogenous or not self._stop:
            return []
        return plain(starts.exogenous[min(self._row, self._stop - 1)])

    def _checked(self, action: int | list[float]) -> np.ndarray:
        """Return an action as the model takes it.

        Raises:
            DriveError: it is none of the space.
        """
        try:
            given = np.asarray([action], dtype=np.float32 if isinstance(action, list) else np.int64)
            checked: np.ndarray = checked_actions(self._spaces, self._world.action_space, given, 1)[0]
        except (ModelError, OverflowError) as error:
            message = f"the action {action} is not taken: {error}"
            raise DriveError(message) from error
        return np.asarray(checked)

    def _checked_exogenous(self, values: list[float]) -> Float32[np.ndarray, " exogenous"]:
        dimensions = self._spaces.exogenous
        if len(values) != len(dimensions):
            message = f"there are {len(dimensions)} exogenous inputs, but {len(values)} were given"
            raise DriveError(message)
        low, high = np.array([(each.low, each.high) for each in dimensions], np.float32).T
        given = np.array(values, np.float32)
        try:
            check_bounds(given, Box(low, high, dtype=np.float32), dimensions, "exogenous inputs")
        except ModelError as error:
            raise DriveError(str(error)) from error
        return given


def neutral_action(spaces: SpaceSpec, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return what is done while nobody does anything.

    Of discrete actions the one whose name says that it is none, else the middle one; of continuous ones 0, or the bound
    that is nearest to it.
    """
    if isinstance(spaces.action, DiscreteAction):
        names = spaces.action.names
        idle = [index for index, name in enumerate(names) if name.startswith(("no_", "none", "idle", "noop"))]
        return np.asarray(idle[0] if idle else len(names) // 2 if len(names) % 2 else 0)
    return np.clip(np.zeros(len(low), np.float32), low, high)


def _action_bounds(world: World) -> tuple[np.ndarray, np.ndarray]:
    space = world.action_space
    return (space.low, space.high) if isinstance(space, Box) else (np.empty(0), np.empty(0))


def _names(spaces: SpaceSpec) -> tuple[str, ...]:
    return spaces.action.names if isinstance(spaces.action, DiscreteAction) else ()


def _described(
    dimensions: Sequence[Dimension], values: np.ndarray | None, *, as_recorded: bool = False
) -> list[dict[str, Any]]:
    """Return names, units and the range to show.

    Args:
        dimensions: what to describe.
        values: recorded ones; None if there are none.
        as_recorded: whether to show the range of these; else the bounds, and that range where there are none.
    """
    described = []
    for index, each in enumerate(dimensions):
        known = None if values is None or not len(values) else values[:, index]
        seen = (None, None) if known is None else (float(known.min()), float(known.max()))
        bounds = [value if np.isfinite(value) else None for value in (each.low, each.high)]
        first, second = (seen, bounds) if as_recorded else (bounds, seen)
        low, high = (one if one is not None else other for one, other in zip(first, second, strict=True))
        described.append({"name": each.name, "unit": each.unit, "low": low, "high": high})
    return described


def _model_words(model: AddressedDynamics) -> str:
    members = model.ensemble.members
    networks = "a single network" if members == 1 else f"{members} networks, {model.mode}"
    return f"{model.origin}: {networks}" if model.origin else networks


def _environment_words(environment: EnvironmentParams) -> str:
    kwargs = ", ".join(f"{name} {value}" for name, value in environment.kwargs.items())
    return f"{environment.id}{f' ({kwargs})' if kwargs else ''}"
