"""MotionModel: networks of motion, and what chooses or mixes them: an addressing network, or the phase."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args, overload

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.episodes.layout import INPUT, OUTPUT
from addressed_dynamics.features.motion.features import MotionFeatures
from addressed_dynamics.networks.addressing import addressed_members, addressing_scores
from addressed_dynamics.networks.files import SavedNetwork, load_network, save_network
from addressed_dynamics.networks.spline import CONTROL_POINTS, catmull_rom
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.arrays import Plain, Values, answer, as_tensor, finite, shown_names
from addressed_dynamics.simulators.delivery import Origin, Parts, find_parts
from addressed_dynamics.simulators.modes import check_choice, no_mode
from addressed_dynamics.simulators.released import load_released

MotionMode = Literal["argmax", "sample", "mixture", "blend", "phase"]
"""How a frame's network is made of the members: the modes of `AddressedDynamics`, or by the phase, along a spline."""
MOTION_MODES: tuple[MotionMode, ...] = get_args(MotionMode)


class MotionModel:
    """A learned model of motion: from the inputs of frames to their outputs, in the units of `motion.layout`.

    Every method takes tensors, arrays or lists, of a batch or of one frame, and answers one frame without the axis of
    the batch; with a tensor if the first argument is one, else with an array.
    """

    def __init__(
        self,
        features: MotionFeatures,
        networks: StackedMLP,
        addressing: StackedMLP | None = None,
        *,
        mode: MotionMode = "argmax",
        origin: Origin | None = None,
    ) -> None:
        """Put a model together.

        Args:
            features: what the networks' inputs and outputs mean.
            networks: the members, or the control points of a phase-functioned network.
            addressing: one network with a score for each member, or heads on a trunk; None if there is only one member
                or the phase decides.
            mode: how `predict` uses them if it is not told. A phase-functioned network has no other mode than `phase`,
                and no other network has that mode.
            origin: which of an experiment's models it is, for `repr`; None if it is none of them.

        Raises:
            ModelError: the networks do not fit each other, the features or the mode, or there is no such mode.
        """
        if mode not in MOTION_MODES:
            raise no_mode(mode, MOTION_MODES)
        if (networks.widths[0], networks.widths[-1]) != (features.inputs, features.outputs):
            message = (
                f"the networks map {networks.widths[0]} inputs to {networks.widths[-1]} outputs, "
                f"but the features have {features.inputs} and {features.outputs}"
            )
            raise ModelError(message)
        if mode == "phase" and (addressing is not None or networks.members != CONTROL_POINTS):
            message = f"a phase-functioned network has {CONTROL_POINTS} control points and no addressing network"
            raise ModelError(message)
        expected = (features.inputs, networks.members)
        found = None if addressing is None else (addressing.widths[0], addressed_members(addressing))
        if mode != "phase" and found != expected and (found is not None or networks.members > 1):
            message = (
                f"{networks.members} members need an addressing network from {expected[0]} inputs to {expected[1]} "
                f"scores, but it is {'missing' if found is None else f'one from {found[0]} to {found[1]}'}"
            )
            raise ModelError(message)
        self.features = features
        self.networks = networks
        self.addressing = addressing
        self.mode: MotionMode = mode
        self.origin = origin

    @staticmethod
    def load(
        folder: str | Path,
        *,
        candidate: str | None = None,
        seed: int | None = None,
        variant: str | None = None,
        mode: MotionMode | None = None,
    ) -> MotionModel:
        """Load what `save` wrote, or a model in a folder that the stages wrote: the one that is delivered.

        Args:
            folder: for instance `data/models/pfnn`; or what `save` wrote, which leaves no candidate, seed or variant to
                choose.
            candidate: name of a baseline, for instance `phase_functioned`, `ensemble`, or `recommended` for the best on
                validation data; None for what is delivered.
            seed: which of the ensembles; None for the one that is delivered, or for a baseline's first.
            variant: which of its addressing networks; None for the one that is delivered.
            mode: how `predict` uses the members if it is not told, as there; None for how the model is delivered or was
                saved, or for `argmax`. A single network has no modes, and a phase-functioned one only `phase`.

        Raises:
            ModelError: a file is missing or damaged, or is of something else; there is no such candidate, seed, variant
                or mode.
        """
        return MotionModel.of(find_parts(Path(folder), candidate, seed, variant), mode=mode)

    @staticmethod
    def of(parts: Parts, *, mode: MotionMode | None = None) -> MotionModel:
        """Load the model that is made of `parts`, in a mode, or else in that in which it is delivered or was saved.

        Raises:
            ModelError: a file is missing or damaged, or the model has no such mode.
        """
        if mode is not None and mode not in MOTION_MODES:
            raise no_mode(mode, MOTION_MODES)
        network = load_network(parts.network, MotionFeatures)
        saved = parts.mode or network.notes.get("mode", "argmax")
        if saved not in MOTION_MODES:
            message = f"{parts.network}: no mode of a motion model ({saved}); train the model again"
            raise ModelError(message)
        if mode is not None:
            check_choice(mode, network.stack.members)
            _check_phase(saved, mode)
        addressing = None if parts.addressing is None else load_network(parts.addressing, MotionFeatures).stack
        return MotionModel(network.features, network.stack, addressing, mode=mode or saved, origin=parts.origin)

    @staticmethod
    def load_released(path: str | Path) -> MotionModel:
        """Load the phase-functioned network that its authors released, as `phase_functioned.load_released` does.

        Raises:
            ModelError: a file is missing or damaged.
        """
        network = load_released(Path(path))
        return MotionModel(network.features, network.stack, mode="phase")

    @property
    def parameters(self) -> int:
        """Number of weights and biases of all its networks, that of the addressing network included."""
        return self.networks.parameters_total + (self.addressing.parameters_total if self.addressing else 0)

    def save(self, folder: Path, notes: dict[str, Any]) -> None:
        """Write the model into `folder`, which appears whole or not at all.

        Args:
            folder: where to.
            notes: where the model comes from; JSON-compatible.
        """
        with atomic_path(folder) as temporary:
            save_network(
                temporary / "network", SavedNetwork(self.networks, self.features, {**notes, "mode": self.mode})
            )
            if self.addressing is not None:
                save_network(temporary / "addressing", SavedNetwork(self.addressing, self.features, notes))

    @overload
    def predict(
        self,
        x: Tensor,
        mode: MotionMode | None = ...,
        *,
        phase: Values | None = ...,
        generator: torch.Generator | None = ...,
    ) -> Tensor: ...
    @overload
    def predict(
        self,
        x: Plain,
        mode: MotionMode | None = ...,
        *,
        phase: Values | None = ...,
        generator: torch.Generator | None = ...,
    ) -> np.ndarray: ...
    @torch.no_grad()
    def predict(
        self,
        x: Values,
        mode: MotionMode | None = None,
        *,
        phase: Values | None = None,
        generator: torch.Generator | None = None,
    ) -> Tensor | np.ndarray:
        """Return the outputs of frames.

        Args:
            x: inputs, (B, 342), in their own units; an array or a tensor.
            mode: `argmax`: the member with the highest score; `sample`: a member drawn with the scores' softmax as
                probabilities; `mixture`: the members' outputs weighted by them; `blend`: the output of a network whose
                parameters are weighted by them; `phase`: by the spline at the phase. None for the model's own.
            phase: phases, (B,), in cycles, if the mode is `phase`; of no use to the others.
            generator: source of randomness for `sample`; None for torch's own.

        Returns:
            Outputs, (B, 311), or (311,) for one frame, in their own units, float32: a tensor for a tensor, or an array.

        Raises:
            ModelError: a shape or the mode is wrong, a value is not finite, or there is no phase where one is needed.
        """
        raw, single = _batch(x)
        phases = None if phase is None else finite(as_tensor(phase), "phases").reshape(-1)
        return answer(self._predict(raw, mode, phases, generator), x, single=single)

    def predictor(
        self, mode: MotionMode | None = None, *, generator: torch.Generator | None = None
    ) -> Callable[[Float[Tensor, "run 342"], Float[Tensor, " run"]], Float[Tensor, "run 311"]]:
        """Return `predict` as what a closed loop asks for: a function of inputs and phases, which can be pickled.

        A loop that has left all bounds goes on, so it does not ask for finite values.
        """
        return partial(_predict, self, mode, generator)

    @overload
    def member_predictions(self, x: Tensor) -> Tensor: ...
    @overload
    def member_predictions(self, x: Plain) -> np.ndarray: ...
    @torch.no_grad()
    def member_predictions(self, x: Values) -> Tensor | np.ndarray:
        """Return what every member predicts, (n, B, 311), or (n, 311) for one frame, in the outputs' own units.

        Raises:
            ModelError: the shape is wrong, or a value is not finite.
        """
        raw, single = _batch(x)
        predicted = self.features.decode(self.networks(self.features.encode(raw)), raw)
        return answer(predicted, x, single=single, axis=1)

    @overload
    def probabilities(self, x: Tensor) -> Tensor: ...
    @overload
    def probabilities(self, x: Plain) -> np.ndarray: ...
    @torch.no_grad()
    def probabilities(self, x: Values) -> Tensor | np.ndarray:
        """Return the softmax of the addressing network's scores, (B, n), or (n,) for one frame.

        Raises:
            ModelError: as in `member_predictions`; or the network is phase-functioned, and so has none.
        """
        raw, single = _batch(x)
        return answer(self._probabilities(self.features.encode(raw)), x, single=single)

    @overload
    def address(self, x: Tensor) -> Tensor: ...
    @overload
    def address(self, x: Plain) -> np.ndarray: ...
    @torch.no_grad()
    def address(self, x: Values) -> Tensor | np.ndarray:
        """Return the member that the addressing network picks, (B,) int64, or () for one frame.

        Raises:
            ModelError: as in `probabilities`.
        """
        raw, single = _batch(x)
        return answer(self._probabilities(self.features.encode(raw)).argmax(dim=1), x, single=single)

    def __repr__(self) -> str:
        networks, addressing = f"{self.networks.members} x {self.networks.widths}", self.addressing
        parts = (
            *(() if self.origin is None else (str(self.origin),)),
            "single network" if self.networks.members == 1 else f"mode {self.mode}",
            f"inputs {shown_names([each.name for each in INPUT.blocks])}",
            f"outputs {shown_names([each.name for each in OUTPUT.blocks])}",
            f"{networks}, addressing {addressing.widths}" if addressing else networks,
            f"{self.parameters:,} parameters",
        )
        return f"MotionModel({'; '.join(parts)})"

    @torch.no_grad()
    def _predict(
        self,
        x: Float[Tensor, "row 342"],
        mode: MotionMode | None,
        phase: Float[Tensor, " row"] | None,
        generator: torch.Generator | None,
    ) -> Float[Tensor, "row 311"]:
        used = self.mode if mode is None else mode
        return self.features.decode(self._output(self.features.encode(x), used, phase, generator), x)

    def _output(
        self, x: Float[Tensor, "row input"], mode: MotionMode, phase: Tensor | None, generator: torch.Generator | None
    ) -> Float[Tensor, "row output"]:
        if mode not in MOTION_MODES:
            raise no_mode(mode, MOTION_MODES)
        _check_phase(self.mode, mode)
        match mode:
            case "phase":
                if phase is None or phase.shape != x.shape[:1]:
                    found = "there is none" if phase is None else f"they have shape {tuple(phase.shape)}"
                    message = f"a phase-functioned network needs phases of shape ({len(x)},), but {found}"
                    raise ModelError(message)
                return self.networks.forward_blended(x, catmull_rom(phase))
            case "argmax":
                return self.networks.forward_routed(x, self._probabilities(x).argmax(dim=1))
            case "sample":
                # A loop that has left all bounds has no probabilities; which member says NaN is all the same.
                drawn = torch.multinomial(self._probabilities(x).nan_to_num(nan=1.0), 1, generator=generator)
                member = drawn.squeeze(1)
                return self.networks.forward_routed(x, member)
            case "mixture":
                outputs: Tensor = self.networks(x)
                return (self._probabilities(x).T.unsqueeze(-1) * outputs).sum(dim=0)
            case "blend":
                return self.networks.forward_blended(x, self._probabilities(x))

    def _probabilities(self, x: Float[Tensor, "row input"]) -> Float[Tensor, "row member"]:
        if self.mode == "phase":
            message = "a phase-functioned network has no addressing network, and so no probabilities"
            raise ModelError(message)
        if self.addressing is None:
            return torch.ones(len(x), 1)
        return torch.softmax(addressing_scores(self.addressing, x), dim=1)


def _check_phase(own: MotionMode, mode: MotionMode) -> None:
    """Check that a model with a mode of its own can be used in another.

    Raises:
        ModelError: the one is phase-functioned, and the other is not.
    """
    if (mode == "phase") != (own == "phase"):
        message = f"a model of mode '{own}' has no mode '{mode}'"
        raise ModelError(message)


def _predict(
    model: MotionModel,
    mode: MotionMode | None,
    generator: torch.Generator | None,
    x: Float[Tensor, "run 342"],
    phase: Float[Tensor, " run"],
) -> Float[Tensor, "run 311"]:
    return model._predict(x.to(torch.float32), mode, phase.to(torch.float32).reshape(-1), generator)


def _batch(x: Values) -> tuple[Float[Tensor, "row 342"], bool]:
    """Return frames as a tensor of a batch, and whether it was one frame."""
    rows = finite(as_tensor(x), "inputs of frames")
    return (rows.unsqueeze(0), True) if rows.ndim == 1 else (rows, False)
