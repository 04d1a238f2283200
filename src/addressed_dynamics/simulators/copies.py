"""Many copies of a learned environment in one batch: where they start, and how they step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, Int64
from torch import Tensor

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.torch_runtime import sent
from addressed_dynamics.simulators.given import Given
from addressed_dynamics.simulators.on_device import ModelOnDevice
from addressed_dynamics.simulators.spaces import checked_actions
from addressed_dynamics.simulators.tasks import exogenous_at, reward_and_end, sources
from addressed_dynamics.simulators.worlds import World

Info = dict[str, np.ndarray]
"""What is said of some copies beside their states: an array with a value for each, by name."""


class Stepped(NamedTuple):
    """What came of a step of some copies."""

    observation: Float32[np.ndarray, "copy observation"]
    reward: Float64[np.ndarray, " copy"]
    terminated: Bool[np.ndarray, " copy"]
    truncated: Bool[np.ndarray, " copy"]
    info: Info


class Copies:
    """Copies of one world, each with a state, a history and a generator of its own.

    So what becomes of one depends on its seed and its actions, and not on the others.
    """

    def __init__(self, world: World, number: int, limit: int | None = None) -> None:
        """Make copies that have not started.

        Args:
            world: what they are copies of.
            number: how many.
            limit: number of steps after which an episode is truncated; None for no limit.
        """
        self.world = world
        self.generators: list[np.random.Generator] = []
        self.ended = np.ones(number, bool)
        self.steps = np.zeros(number, np.int64)
        self._limit = np.inf if limit is None else limit
        spaces, past = world.model.features.spaces, world.history - 1
        self._frames = np.zeros((number, past + 1, len(spaces.observation)), np.float32)
        self._actions = np.zeros((number, past, *(world.action_space.shape or ())), world.action_space.dtype)
        self._exogenous = np.zeros((number, past, len(spaces.exogenous)), np.float32)
        none = np.zeros((0, len(spaces.exogenous)), np.float32)
        self._recorded = none if world.starts is None else world.starts.exogenous
        self._table = self._recorded
        self._row, self._stop = np.zeros((2, number), np.int64)

    def start(
        self, rows: Int64[np.ndarray, " chosen"], given: Given | None = None
    ) -> tuple[Float32[np.ndarray, "chosen observation"], Info]:
        """Start some of the copies anew: where a user says, or at a start that each draws.

        Returns:
            Their states, and `episode` and `step` that these are from, -1 if they were given; `clipped`: whether one
            was beyond its bounds, and is now at them.

        Raises:
            ModelError: there are no starts to draw from.
        """
        world, past = self.world, self.world.history - 1
        if len(rows) == len(self.ended):
            self._table = self._recorded
        if given is not None:
            frames, actions = given.observation[rows], given.action[rows]
            origin = np.full((2, len(rows)), -1, np.int64)
            if given.exogenous is not None:
                length = given.exogenous.shape[1]
                self._row[rows] = len(self._table) + length * np.arange(len(rows))
                self._stop[rows] = self._row[rows] + length
                self._table = np.concatenate([self._table, *given.exogenous[rows]])
        else:
            if world.starts is None:
                raise ModelError(world.no_starts)
            number = len(world.candidates)
            drawn = world.candidates[[int(self.generators[row].integers(number)) for row in rows]]
            # Starts may hold more frames than this model is given.
            frames = world.starts.observation[drawn, world.starts.frames - past - 1 :]
            actions = world.starts.action[drawn, world.starts.frames - 1 - past :]
            self._row[rows] = world.starts.row[drawn] + world.starts.frames - past - 1
            self._stop[rows] = world.starts.stop[drawn]
            origin = np.stack([world.starts.episode[drawn], world.starts.step[drawn]])
        bounds = world.observation_space
        self._frames[rows] = np.clip(frames, bounds.low, bounds.high)
        self._actions[rows] = actions
        if past and self._exogenous.shape[2]:
            for frame in range(past):
                self._exogenous[rows, frame] = self._exogenous_beside(rows, frame, given, frame - past)
        self._row[rows] += past
        self.steps[rows], self.ended[rows] = 0, False
        clipped = (self._frames[rows] != frames).any(axis=(1, 2))
        return self._frames[rows, -1], {"episode": origin[0], "step": origin[1], "clipped": clipped}

    @torch.no_grad()
    def step(self, actions: Any, rows: Int64[np.ndarray, " chosen"]) -> Stepped:
        """Step some of the copies, all by one step of the model.

        Args:
            actions: one for each of them.
            rows: which ones.

        Returns:
            States and so on of these; their `info` is explained in `addressed_dynamics.simulators.environment`.

        Raises:
            ModelError: an action is outside the space, a copy has ended, or a function of the user's fails.
        """
        world, history = self.world, self.world.history
        chosen = checked_actions(world.model.features.spaces, world.action_space, actions, len(rows))
        at = in_place(rows, len(self.ended))
        if self.ended[at].any():
            message = f"copy {rows[self.ended[at]][0]} has not started, or its episode has ended; reset it first"
            raise ModelError(message)
        frames = self._frames[at]
        acted = np.concatenate([self._actions[at], chosen[:, None]], axis=1)
        known = np.concatenate([self._exogenous[at], self._now(rows)[:, None]], axis=1)
        given = (frames, acted, known) if history > 1 else (frames[:, 0], acted[:, 0], known[:, 0])
        predicted, network, trust = self._predicted(*given, rows)
        last = frames[:, -1]
        sound = _of_all(np.isfinite(predicted))
        unclipped = predicted if sound.all() else np.where(sound[:, None], predicted, last)
        bounds = world.observation_space
        after = np.clip(unclipped, bounds.low, bounds.high)
        reward, terminated = reward_and_end(world.task, last, chosen, after, known[:, -1])
        self._frames[at] = np.concatenate([frames[:, 1:], after[:, None]], axis=1)
        self._actions[at], self._exogenous[at] = acted[:, 1:], known[:, 1:]
        self.steps[at] += 1
        self._row[at] += 1
        stops = self._stops(rows, sound, trust)
        truncated = np.logical_or.reduce([self.steps[at] >= self._limit, *stops.values()])
        self.ended[at] = terminated | truncated
        stopped = np.full(len(rows), "", object)
        for reason, stop in stops.items():
            stopped[stop] = reason
        info = {"network": network, **({} if trust is None else {"trust": trust})}
        info |= {"clipped": ~_of_all(after == unclipped), "stopped_by": stopped}
        said_by = zip(("reward_source", "end_source"), sources(world.task), strict=True)
        info |= {name: np.full(len(rows), source, object) for name, source in said_by}
        return Stepped(after, reward, terminated, truncated, info)

    def _predicted(
        self, state: np.ndarray, action: np.ndarray, exogenous: np.ndarray, rows: Int64[np.ndarray, " chosen"]
    ) -> tuple[Float32[np.ndarray, "chosen observation"], Int64[np.ndarray, " chosen"], np.ndarray | None]:
        """Return next states, the network that each is from or that is weighted most, and the trust in them."""
        model, precise = self.world.model, self.world.precise
        frames, acted = torch.from_numpy(state), torch.from_numpy(action)
        known = torch.from_numpy(exogenous) if exogenous.shape[-1] else None
        if self.world.there is not None:
            return self._predicted_there(self.world.there, frames, acted, torch.from_numpy(exogenous), rows)
        x = model.encoded(frames, acted, known)
        stepping, inputs = (model, x) if precise is None else (precise, x.double())
        if model.mode == "sample":
            member = self._drawn(stepping.probabilities_of(inputs), rows)
            output = stepping.ensemble.forward_routed(inputs, member)
            after = model.features.decode(output, frames if frames.ndim == 2 else frames[:, -1])
        else:
            after, member = stepping.step_and_member(frames, acted, known, x=inputs)
        after = after.to(torch.float32)
        trust = self.world.trust
        if trust is None:
            return after.numpy(), member.numpy(), None
        signals = trust.scales(model, frames, acted, known, after, x).signals
        return after.numpy(), member.numpy(), trust.trust(signals)

    def _predicted_there(
        self, model: ModelOnDevice, frames: Tensor, acted: Tensor, known: Tensor, rows: Int64[np.ndarray, " chosen"]
    ) -> tuple[Float32[np.ndarray, "chosen observation"], Int64[np.ndarray, " chosen"], np.ndarray | None]:
        """Return what `_predicted` does, computed on the device."""
        given = tuple(sent(each, model.device) for each in (frames, acted, known))
        if model.mode == "sample":
            x = model.features.encode(*given)
            drawn = self._drawn(model.probabilities_of(x).cpu(), rows)
            output = model.routed(x, drawn.to(model.device)).cpu()
            after, member = model.features.decode(output, frames if frames.ndim == 2 else frames[:, -1]), drawn
        else:
            after, member = (each.cpu() for each in model.step(*given))
        trust, beside = self.world.trust, known if known.shape[-1] else None
        if trust is None:
            return after.numpy(), member.numpy(), None
        x = model.features.encode(frames, acted, beside)
        signals = trust.scales(self.world.model, frames, acted, beside, after, x).signals
        return after.numpy(), member.numpy(), trust.trust(signals)

    def _drawn(self, probabilities: Tensor, rows: Int64[np.ndarray, " chosen"]) -> Int64[Tensor, " chosen"]:
        """Return a member for each copy, drawn by its own generator."""
        uniform = torch.tensor([self.generators[row].random() for row in rows], dtype=torch.float64)
        edges = probabilities.double().nan_to_num(nan=1.0).cumsum(dim=1)
        drawn = (edges <= uniform.unsqueeze(1) * edges[:, -1:]).sum(dim=1)
        return drawn.clamp(max=probabilities.shape[1] - 1)

    def _now(self, rows: Int64[np.ndarray, " chosen"]) -> Float32[np.ndarray, "chosen exogenous"]:
        """Return the exogenous inputs during the coming step."""
        width = self._exogenous.shape[2]
        if self.world.exogenous is not None:
            return exogenous_at(self.world.exogenous, self.steps[rows], width)
        return self._table[self._row[rows]] if width else np.empty((len(rows), 0), np.float32)

    def _exogenous_beside(
        self, rows: Int64[np.ndarray, " chosen"], frame: int, given: Given | None, step: int
    ) -> Float32[np.ndarray, "chosen exogenous"]:
        """Return the exogenous inputs beside a frame before the start: recorded, or as the function has them."""
        if given is not None and self.world.exogenous is not None:
            return exogenous_at(self.world.exogenous, np.full(len(rows), step), self._exogenous.shape[2])
        recorded: Float32[np.ndarray, "chosen exogenous"] = self._table[self._row[rows] + frame]
        return recorded

    def _stops(
        self, rows: Int64[np.ndarray, " chosen"], sound: Bool[np.ndarray, " chosen"], trust: np.ndarray | None
    ) -> dict[str, Bool[np.ndarray, " chosen"]]:
        """Return which copies the model cannot go on with, by why in a word; the last one is the one to tell."""
        stops: dict[str, Bool[np.ndarray, " chosen"]] = {}
        if self._exogenous.shape[2] and self.world.exogenous is None:
            stops["exogenous"] = self._row[rows] >= self._stop[rows]
        if self.world.least_trust is not None and trust is not None:
            stops["trust"] = trust < self.world.least_trust
        return {**stops, "not_finite": ~sound}


def _of_all(values: Bool[np.ndarray, "copy dimension"]) -> Bool[np.ndarray, " copy"]:
    """Return where all dimensions are true: by columns, for NumPy is slow to reduce short rows."""
    found: Bool[np.ndarray, " copy"] = np.logical_and.reduce(list(values.T))
    return found


def in_place(rows: Int64[np.ndarray, " chosen"], number: int) -> Int64[np.ndarray, " chosen"] | slice:
    """Return what selects rows, each once and in order, of so many: if they are all, a slice, which copies nothing."""
    return slice(None) if len(rows) == number else rows


def all_rows(number: int) -> Int64[np.ndarray, " copy"]:
    """Return the numbers of all copies."""
    return np.arange(number)


def reset_seeds(seed: int | Sequence[int | None] | None, number: int) -> list[int | None]:
    """Return a seed for each copy, of one for all (the next ones count up) or of one for each.

    Raises:
        ModelError: there is not one for each.
    """
    if seed is None:
        return [None] * number
    if isinstance(seed, (int, np.integer)):
        return [int(seed) + copy for copy in range(number)]
    if len(seed) != number:
        message = f"there should be one seed, or {number}, one for each copy, but there are {len(seed)}"
        raise ModelError(message)
    return list(seed)
