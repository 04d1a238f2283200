"""The FeatureSpec: from states, actions and exogenous inputs to a network's inputs, from its outputs to the next state.

It is saved with every model, so that a model folder alone can predict from raw observations.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from itertools import chain
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from addressed_dynamics.base.errors import ModelError, TransitionsError
from addressed_dynamics.episodes.bounds import meant_bounds
from addressed_dynamics.episodes.statistics import Moments
from addressed_dynamics.episodes.transitions import Dimension, DiscreteAction, SpaceSpec, Transitions
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.common.spool import InMemory
from addressed_dynamics.features.transitions.angles import angle_of, velocity_from_angles
from addressed_dynamics.features.transitions.sampling import samples_of, write_samples
from addressed_dynamics.features.transitions.windows import EpisodeLengths, check_lengths, parts_of
from addressed_dynamics.sources.transitions.params import AngleParams, FeatureParams

DEVIATION_FLOOR = 1e-6
"""Least standard deviation an input is divided by, as a share of the range of its dimension (or of 1): a constant
column must not become a division by nearly nothing."""
STATISTICS_ROWS = 2**16
"""Rows whose mean and deviation are taken at once, to be merged with those of the others."""


@dataclass(frozen=True)
class Angle:
    """An angle that the observation gives by its cosine and its sine."""

    name: str
    """What it is called, for instance `angle_1`."""
    cosine: str
    """Name of the dimension with its cosine."""
    sine: str
    """Name of the dimension with its sine."""
    velocity: str | None
    """Name of the dimension with its velocity, in rad/s; None if there is none."""


@dataclass(frozen=True)
class Constants:
    """The numbers of a `FeatureSpec` as tensors, float32."""

    state_mean: Float[Tensor, " observation"]
    state_deviation: Float[Tensor, " observation"]
    action_mean: Float[Tensor, " action"]
    action_deviation: Float[Tensor, " action"]
    exogenous_mean: Float[Tensor, " exogenous"]
    exogenous_deviation: Float[Tensor, " exogenous"]
    actions: Float[Tensor, "action action"]
    """What each discrete action is as normalised inputs."""
    unit: Float[Tensor, " output"]
    """What one unit of an output is, in the unit of its dimension."""
    middle: Float[Tensor, " output"]
    """What an output of 0 is, there."""
    target_scale: Float[Tensor, " output"]
    """Range of each predicted dimension of the state, in its unit."""
    target_mean: Float[Tensor, " output"]
    """Mean of each target, in multiples of that."""
    predicted: Int64[Tensor, " output"]
    """Dimensions of the state that a network predicts."""
    frame_weights: Float[Tensor, "frame 1"]
    """By what each frame of a window is multiplied, oldest first."""

    def to(self, device: torch.device) -> Constants:
        """Return the same on a device."""
        return Constants(**{name: each.to(device) for name, each in vars(self).items()})


@dataclass(frozen=True)
class FeatureSpec:
    """How the networks of one model see the environment. Make one with `fit_features`.

    A network is given `history` frames, each a state with the action taken in it and the exogenous inputs during that
    step, oldest first. A target t (the next
    state, or its change) becomes y = (t / scale - target_mean) / target_deviation with a single deviation for all
    dimensions, so that the loss a network trains on is, up to that constant, the paper's: the error of states scaled to
    [0, 1].
    """

    spaces: SpaceSpec
    """What the raw numbers mean."""
    history: int
    """Number of frames, H."""
    history_weight: float
    """Size of the normalised inputs of older frames beside those of the last; all together keep their variance."""
    target: Literal["absolute", "change"]
    """Whether a network is asked for the next state or for its change."""
    angles: tuple[Angle, ...]
    """Angles given by cosine and sine."""
    angle_from: Literal["weighted", "atan2"]
    """How an angle comes from a predicted cosine and sine."""
    velocity: Literal["difference", "predicted"]
    """Where the angles' velocities come from: differences of successive angles, or the network."""
    input_mean: tuple[float, ...]
    """Mean of each input of a frame (state, action, exogenous inputs) over the training samples, in the environment's
    units (one-hot actions: their share)."""
    input_deviation: tuple[float, ...]
    """Standard deviation of each input of a frame over the training samples, floored."""
    scale: tuple[float, ...]
    """Range of each dimension of the state, in its unit: errors divided by it are errors of states in [0, 1]."""
    target_mean: tuple[float, ...]
    """Mean of each target, in multiples of `scale`."""
    target_deviation: float
    """Root mean square deviation of the targets, in multiples of `scale`."""

    @property
    def params(self) -> FeatureParams:
        """The params that it was made with."""
        return FeatureParams(
            target=self.target,
            history=self.history,
            history_weight=self.history_weight,
            angles=tuple(AngleParams(**asdict(angle)) for angle in self.angles),
            angle_from=self.angle_from,
            velocity=self.velocity,
        )

    @property
    def inputs(self) -> int:
        """Number of inputs of a network."""
        return self.history * len(self.input_mean)

    @property
    def frame_inputs(self) -> int:
        """Number of inputs that are of one frame."""
        return len(self.input_mean)

    @property
    def outputs(self) -> int:
        """Number of outputs of a network."""
        return len(self.target_mean)

    @cached_property
    def predicted(self) -> tuple[int, ...]:
        """Dimensions of the state that a network predicts; the others are velocities that follow from the angles."""
        return predicted_dimensions(self.spaces, self.angles, self.velocity)

    def encode(
        self,
        observation: Float[Tensor, "sample ..."],
        action: Tensor,
        exogenous: Tensor | None = None,
    ) -> Float[Tensor, "sample input"]:
        """Return normalised inputs for states (in the environment's units), actions and exogenous inputs.

        Args:
            observation: states, (B, d_obs); with a history of H > 1 frames (B, H, d_obs), oldest first.
            action: the actions taken in them, (B,) or (B, H) integers if the actions are discrete, else one dimension
                more, for their components.
            exogenous: the exogenous inputs during the step, (B, d_exo) or (B, H, d_exo), in their own units; None if,
                and only if, the spaces have none.

        Raises:
            ModelError: a shape is wrong, a discrete action does not exist, or exogenous inputs are missing or are none
                of the spaces'.
        """
        self.check_observation(observation)
        return self.join(self.frames(observation, action, exogenous))

    def check_observation(self, observation: Tensor) -> None:
        """Check that states have the shape that `encode` asks for.

        Raises:
            ModelError: they have another one.
        """
        frames = () if self.history == 1 else (self.history,)
        expected = (*frames, len(self.spaces.observation))
        if not observation.ndim or observation.shape[1:] != expected:
            shape = ", ".join(map(str, ("B", *expected)))
            message = f"observations should have shape ({shape}), but have {tuple(observation.shape)}"
            raise ModelError(message)

    def encode_exogenous(self, exogenous: Tensor | None, batch: tuple[int, ...]) -> Float[Tensor, "*batch exogenous"]:
        """Return exogenous inputs as float32, without a column if the spaces have none.

        Args:
            exogenous: the inputs in their own units, (*batch, d_exo); None if the spaces have none.
            batch: shape without the axis of the inputs.

        Raises:
            ModelError: they are missing, are of another shape, or the spaces have none.
        """
        expected = (*batch, len(self.spaces.exogenous))
        if exogenous is None and not expected[-1]:
            return torch.empty(expected)
        names = ", ".join(dimension.name for dimension in self.spaces.exogenous)
        if exogenous is None:
            message = (
                f"the model has exogenous inputs ({names}), which are known and not predicted, but was given none; "
                f"pass exogenous=, of shape {expected}"
            )
            raise ModelError(message)
        if exogenous.shape != expected:
            found = tuple(exogenous.shape)
            message = (
                f"exogenous inputs ({names}) should have shape {expected}, but have {found}"
                if names
                else f"the model has no exogenous inputs, but was given some of shape {found}; leave exogenous= out"
            )
            raise ModelError(message)
        return exogenous.to(torch.float32)

    def join(self, frames: Float[Tensor, "*batch frame"]) -> Float[Tensor, "*batch input"]:
        """Return the inputs of a network from normalised frames, (*batch, H, n), oldest first, or (*batch, n)."""
        return frames if self.history == 1 else (frames * self._beside(frames).frame_weights).flatten(start_dim=-2)

    def encode_target(
        self, observation: Float[Tensor, "*batch observation"], next_observation: Float[Tensor, "*batch observation"]
    ) -> Float[Tensor, "*batch output"]:
        """Return the normalised targets for states and the states that follow them."""
        target = next_observation - observation if self.target == "change" else next_observation
        of = self._beside(target)
        return (self._predicted_of(target) / of.target_scale - of.target_mean) / self.target_deviation

    def decode(
        self, output: Float[Tensor, "*member sample output"], observation: Float[Tensor, "*member sample observation"]
    ) -> Float[Tensor, "*member sample observation"]:
        """Return the next states that outputs of a network mean, in the environment's units.

        Cosines and sines of angles are those of the predicted angle, and velocities of angles lie in their bounds.
        Nothing else is bounded.

        Args:
            output: what a network says.
            observation: the states before the step: of a history, the last frame; each member's own, or one for all.
        """
        of = self._beside(output)
        target = torch.addcmul(of.middle, output, of.unit)
        if self.target == "change":
            target = target + self._predicted_of(observation)
        if not self.angles:
            return target
        columns = dict(zip(self.predicted, target.unbind(dim=-1), strict=True))
        for angle in self.angles:
            columns |= self._turned(angle, columns, observation)
        return torch.stack([columns[index] for index in range(len(self.spaces.observation))], dim=-1)

    def with_states(
        self, frames: Float[Tensor, "*batch frame"], observation: Float[Tensor, "*batch observation"]
    ) -> Float[Tensor, "*batch frame"]:
        """Return normalised frames with other states (in the environment's units) in the place of theirs."""
        of = self._beside(observation)
        states = (observation - of.state_mean) / of.state_deviation
        return torch.cat([states, frames[..., observation.shape[-1] :]], dim=-1)

    def samples(self, transitions: Transitions | Iterable[Transitions], *, courses: bool = False) -> Samples:
        """Return the samples of `transitions`, in their order, in memory.

        There is one for each row that has H - 1 rows of its own episode before it.

        Args:
            transitions: what to take them from, whole or in parts, each of which may end inside an episode.
            courses: whether networks are to go on from what they predict.

        Raises:
            ModelError: the transitions are of other spaces.
            TransitionsError: there are transitions, but no episode is as long as the history.
        """
        sink = InMemory()
        write_samples(self, parts_of(transitions), sink, courses=courses)
        return samples_of(self, sink.columns(), courses=courses)

    def angle(self, angle: Angle, observation: Float[Tensor, "*batch observation"]) -> Float[Tensor, "*batch"]:
        """Return one of the angles of states, in rad in [-pi, pi]."""
        names = self.spaces.observation_names
        return torch.atan2(observation[..., names.index(angle.sine)], observation[..., names.index(angle.cosine)])

    def plane(self, observation: Float[np.ndarray, "sample observation"]) -> Float64[np.ndarray, "sample 2"] | None:
        """Return what a map of states shows: the first two angles, else the first two dimensions, if there are two."""
        states = torch.from_numpy(observation).double()
        if len(self.angles) > 1:
            states = torch.stack([self.angle(angle, states) for angle in self.angles[:2]], dim=1)
        return states[:, :2].numpy() if states.shape[1] > 1 else None

    @property
    def persistence(self) -> tuple[Float[Tensor, "input output"], Float[Tensor, " output"]]:
        """Weights and biases of the linear map by which the next state is the state."""
        weight, bias = torch.zeros(self.inputs, self.outputs), -torch.tensor(self.target_mean)
        if self.target == "absolute":
            last = self.inputs - len(self.input_mean)
            size = float(self.constants.frame_weights[-1])
            for output, dimension in enumerate(self.predicted):
                weight[last + dimension, output] = self.input_deviation[dimension] / self.scale[dimension] / size
                bias[output] += self.input_mean[dimension] / self.scale[dimension]
        return weight / self.target_deviation, bias / self.target_deviation

    @property
    def last_change(self) -> tuple[Float[Tensor, "input output"], Float[Tensor, " output"]] | None:
        """Weights and biases of the linear map by which the state changes as it did in the step before.

        None with one frame, which does not say how it changed.
        """
        if self.history == 1:
            return None
        weight, bias = self.persistence
        last = self.inputs - self.frame_inputs
        before, sizes = last - self.frame_inputs, self.constants.frame_weights.flatten().tolist()
        for output, dimension in enumerate(self.predicted):
            unit = self.input_deviation[dimension] / self.scale[dimension] / self.target_deviation
            weight[last + dimension, output] += unit / sizes[-1]
            weight[before + dimension, output] -= unit / sizes[-2]
        return weight, bias

    def loss_unit(self, loss: Literal["mse", "mae"]) -> float:
        """Return what one unit of a network's training loss is as a loss of states scaled to [0, 1]."""
        return self.target_deviation**2 if loss == "mse" else self.target_deviation

    def to_json(self) -> dict[str, Any]:
        """Return the spec as JSON-compatible values."""
        return {**asdict(self), "spaces": self.spaces.to_json()}

    @staticmethod
    def from_json(value: Any) -> FeatureSpec:
        """Read what `to_json` wrote.

        Raises:
            ModelError: `value` does not have that form.
        """
        try:
            spec = FeatureSpec(
                spaces=SpaceSpec.from_json(value["spaces"]),
                history=int(value["history"]),
                history_weight=float(value["history_weight"]),
                target={"absolute": "absolute", "change": "change"}[value["target"]],  # type: ignore[arg-type] # checked by the lookup
                angles=tuple(Angle(**angle) for angle in value["angles"]),
                angle_from={"weighted": "weighted", "atan2": "atan2"}[value["angle_from"]],  # type: ignore[arg-type] # as above
                velocity={"difference": "difference", "predicted": "predicted"}[value["velocity"]],  # type: ignore[arg-type] # as above
                input_mean=tuple(map(float, value["input_mean"])),
                input_deviation=tuple(map(float, value["input_deviation"])),
                scale=tuple(map(float, value["scale"])),
                target_mean=tuple(map(float, value["target_mean"])),
                target_deviation=float(value["target_deviation"]),
            )
            spec._check()
        except (KeyError, TypeError, ValueError, TransitionsError) as error:
            message = f"the description of a model's features is incomplete or malformed ({error})"
            raise ModelError(message) from error
        return spec

    def _check(self) -> None:
        if self.history < 1:
            message = f"history should be at least 1, but is {self.history}"
            raise ValueError(message)
        _check_angles(self.spaces, self.angles)
        action = self.spaces.action
        states = len(self.spaces.observation)
        actions = action.count if isinstance(action, DiscreteAction) else len(action.dimensions)
        inputs = states + actions + len(self.spaces.exogenous)
        outputs = len(self.predicted)
        for name, expected in {
            "input_mean": inputs, "input_deviation": inputs, "scale": states, "target_mean": outputs
        }.items():  # fmt: skip
            if len(getattr(self, name)) != expected:
                message = f"{name} should have {expected} numbers, but has {len(getattr(self, name))}"
                raise ValueError(message)

    def frames(
        self,
        observation: Float[Tensor, "*batch observation"],
        action: Tensor,
        exogenous: Tensor | None,
    ) -> Float[Tensor, "*batch frame"]:
        """Return states, actions and exogenous inputs as normalised inputs side by side.

        Raises:
            ModelError: a shape is wrong, a discrete action does not exist, or exogenous inputs are missing.
        """
        batch, of = observation.shape[:-1], self._beside(observation)
        states = (observation.to(torch.float32) - of.state_mean) / of.state_deviation
        known = self.encode_exogenous(exogenous, batch)
        parts = [states, self._encode_action(action, batch)]
        if known.shape[-1]:
            parts.append((known - of.exogenous_mean) / of.exogenous_deviation)
        return torch.cat(parts, dim=-1)

    def _encode_action(self, action: Tensor, batch: tuple[int, ...]) -> Float[Tensor, "*batch action"]:
        kind, of = self.spaces.action, self._beside(action)
        if isinstance(kind, DiscreteAction):
            if action.shape != batch or action.is_floating_point():
                message = (
                    f"discrete actions should be integers of shape {tuple(batch)}, "
                    f"but are {action.dtype} of shape {tuple(action.shape)}"
                )
                raise ModelError(message)
            try:
                return torch.nn.functional.embedding(action.long(), of.actions)
            except IndexError as error:
                message = f"actions should lie in 0..{kind.count - 1}, but some do not"
                raise ModelError(message) from error
        expected = (*batch, len(kind.dimensions))
        if action.shape != expected:
            message = f"continuous actions should have shape {expected}, but have {tuple(action.shape)}"
            raise ModelError(message)
        return (action.to(torch.float32) - of.action_mean) / of.action_deviation

    @cached_property
    def constants(self) -> Constants:
        """The numbers that samples are encoded and decoded with, as tensors."""
        states, exogenous = len(self.spaces.observation), len(self.spaces.exogenous)
        sizes = [states, len(self.input_mean) - states - exogenous, exogenous]
        # What is made inside of torch.inference_mode could not be used outside of it.
        with torch.inference_mode(mode=False):
            mean, deviation = (
                torch.split(torch.tensor(each), sizes) for each in (self.input_mean, self.input_deviation)
            )
            scale = torch.tensor([self.scale[index] for index in self.predicted])
            weights = torch.full((self.history, 1), self.history_weight)
            weights[-1] = 1.0
            return Constants(
                state_mean=mean[0],
                state_deviation=deviation[0],
                action_mean=mean[1],
                action_deviation=deviation[1],
                exogenous_mean=mean[2],
                exogenous_deviation=deviation[2],
                actions=(torch.eye(sizes[1]) - mean[1]) / deviation[1],
                unit=self.target_deviation * scale,
                middle=torch.tensor(self.target_mean) * scale,
                target_scale=scale,
                target_mean=torch.tensor(self.target_mean),
                predicted=torch.tensor(self.predicted),
                frame_weights=weights / weights.square().mean().sqrt(),
            )

    def _beside(self, values: Tensor) -> Constants:
        """Return the numbers that samples are encoded and decoded with, where `values` are."""
        if values.is_cpu:
            return self.constants
        if values.device not in self._elsewhere:
            self._elsewhere[values.device] = self.constants.to(values.device)
        return self._elsewhere[values.device]

    @cached_property
    def _elsewhere(self) -> dict[torch.device, Constants]:
        return {}

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is made again when it is needed: another process may have no GPU."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def _predicted_of(self, state: Float[Tensor, "*batch observation"]) -> Float[Tensor, "*batch output"]:
        """Return the dimensions of states that a network predicts."""
        if len(self.predicted) == state.shape[-1]:
            return state
        # A tuple would be sent to a GPU every time.
        return state[..., self.predicted] if state.is_cpu else state.index_select(-1, self._beside(state).predicted)

    def _turned(
        self, angle: Angle, columns: dict[int, Tensor], before: Float[Tensor, "sample observation"]
    ) -> dict[int, Float[Tensor, "*member sample"]]:
        """Return the columns of the next state that belong to an angle: on the unit circle, velocity in its bounds."""
        names = self.spaces.observation_names
        cosine, sine = names.index(angle.cosine), names.index(angle.sine)
        after = angle_of(columns[cosine], columns[sine], weighted=self.angle_from == "weighted")
        turned = {cosine: after.cos(), sine: after.sin()}
        if angle.velocity is None:
            return turned
        index = names.index(angle.velocity)
        velocity = (
            columns[index]
            if index in columns
            else velocity_from_angles(after, self.angle(angle, before), step_seconds=self.spaces.step_seconds)
        )
        bounds = self.spaces.observation[index]
        return {**turned, index: velocity.clamp(bounds.low, bounds.high)}


def fit_features(train: Transitions | Iterable[Transitions], params: FeatureParams) -> FeatureSpec:
    """Choose the normalisation from training transitions alone.

    The scale of a dimension is its range by the environment's bounds; where these are infinite, or a million times as
    far apart as the data, the range of the data.

    Means and deviations are merged from those of blocks of `STATISTICS_ROWS` rows, however the transitions come.

    Args:
        train: the transitions, whole or in parts, each of which may end inside an episode.
        params: what networks are given and asked for.

    Raises:
        TransitionsError: there are no transitions, or no episode is as long as the history; or an angle names a
            dimension that the observation lacks or that is part of another, or has a name that is taken.
    """
    parts = iter(parts_of(train))
    first = next((part for part in parts if len(part)), None)
    if first is None:
        message = "there are no training transitions to take statistics from: record more episodes"
        raise TransitionsError(message)
    spaces, lengths = first.spec, EpisodeLengths()
    angles = tuple(Angle(**angle.model_dump()) for angle in params.angles)

    def columns() -> Iterator[Float[np.ndarray, "row column"]]:
        for part in chain([first], parts):
            lengths.places(part.episode)
            yield np.concatenate(_statistics_columns(part, params), axis=1)

    found = _moments(columns())
    check_lengths(lengths.all(), params.history)
    _check_angles(spaces, angles)
    predicted = list(predicted_dimensions(spaces, angles, params.velocity))
    states, exogenous = len(spaces.observation), len(spaces.exogenous)
    inputs = len(found.mean) - states
    spread = _spread(spaces.observation, found.minimum[:states], found.maximum[:states])
    scale = np.where(spread > 0, spread, 1.0)
    known = slice(inputs - exogenous, inputs)
    exogenous_spread = _spread(spaces.exogenous, found.minimum[known], found.maximum[known])
    if isinstance(spaces.action, DiscreteAction):
        action_spread = np.ones(spaces.action.count)
    else:
        action_spread = (found.maximum - found.minimum)[states : inputs - exogenous]
    spreads = np.concatenate([scale, *(np.where(each > 0, each, 1.0) for each in (action_spread, exogenous_spread))])
    target_deviations = (found.std[inputs:] / scale)[predicted]
    return FeatureSpec(
        spaces=spaces,
        history=params.history,
        history_weight=params.history_weight,
        target=params.target,
        angles=angles,
        angle_from=params.angle_from,
        velocity=params.velocity,
        input_mean=tuple(map(float, found.mean[:inputs])),
        input_deviation=tuple(map(float, np.maximum(found.std[:inputs], DEVIATION_FLOOR * spreads))),
        scale=tuple(map(float, scale)),
        target_mean=tuple(map(float, (found.mean[inputs:] / scale)[predicted])),
        target_deviation=float(max(np.sqrt(np.square(target_deviations).mean()), DEVIATION_FLOOR)),
    )


def _statistics_columns(part: Transitions, params: FeatureParams) -> list[Float[np.ndarray, "row column"]]:
    """Return the inputs of a frame and the targets, not normalised, in float64."""
    observation, after = part.observation.astype(np.float64), part.next_observation.astype(np.float64)
    kind = part.spec.action
    action = np.eye(kind.count)[part.action] if isinstance(kind, DiscreteAction) else part.action.astype(np.float64)
    targets = after - observation if params.target == "change" else after
    return [observation, action, part.exogenous.astype(np.float64), targets]


def _moments(parts: Iterable[Float[np.ndarray, "row column"]]) -> Moments:
    """Return the moments of rows, of which there are some, merged from those of blocks of `STATISTICS_ROWS` rows."""
    found, waiting, count = None, list[np.ndarray](), 0

    def merged(found: Moments | None, block: Float[np.ndarray, "row column"]) -> Moments:
        return Moments.of(block) if found is None else found.merge(Moments.of(block))

    for part in parts:
        waiting.append(part)
        count += len(part)
        if count >= STATISTICS_ROWS:
            rows = np.concatenate(waiting)
            whole = count - count % STATISTICS_ROWS
            for first in range(0, whole, STATISTICS_ROWS):
                found = merged(found, rows[first : first + STATISTICS_ROWS])
            waiting, count = [rows[whole:]], count - whole
    if count or found is None:
        found = merged(found, np.concatenate(waiting))
    return found


def _spread(
    dimensions: tuple[Dimension, ...],
    lowest: Float64[np.ndarray, " dimension"],
    highest: Float64[np.ndarray, " dimension"],
) -> Float64[np.ndarray, " dimension"]:
    """Return the range of each dimension: by its bounds, if they say something about the data."""
    low, high = meant_bounds(dimensions, lowest, highest)
    bounded = np.isfinite([low, high]).all(axis=0)
    spread: Float64[np.ndarray, " dimension"] = np.subtract(high, low, where=bounded, out=highest - lowest)
    return spread


def predicted_dimensions(
    spaces: SpaceSpec, angles: tuple[Angle, ...], velocity: Literal["difference", "predicted"]
) -> tuple[int, ...]:
    """Return the dimensions of the state that a network predicts: all, or all but the velocities of the angles."""
    follow = {angle.velocity for angle in angles} if velocity == "difference" else set()
    return tuple(index for index, name in enumerate(spaces.observation_names) if name not in follow)


def _check_angles(spaces: SpaceSpec, angles: tuple[Angle, ...]) -> None:
    taken, dimensions = set(spaces.observation_names), set[str]()
    for angle in angles:
        if angle.name in taken:
            message = f"features.angles: '{angle.name}' is the name of another angle or of a dimension; rename it"
            raise TransitionsError(message)
        taken.add(angle.name)
        for part, name in {"cosine": angle.cosine, "sine": angle.sine, "velocity": angle.velocity}.items():
            if name is None:
                continue
            if name not in spaces.observation_names:
                known = ", ".join(spaces.observation_names)
                message = (
                    f"features.angles: the {part} of '{angle.name}' should be a dimension of the observation, "
                    f"but is '{name}' (dimensions: {known})"
                )
                raise TransitionsError(message)
            if name in dimensions:
                message = (
                    f"features.angles: the {part} of '{angle.name}' is '{name}', which is also another cosine, sine or "
                    "velocity; name a dimension once"
                )
                raise TransitionsError(message)
            dimensions.add(name)
