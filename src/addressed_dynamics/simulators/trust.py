"""How far a model is to be trusted: intervals, trust and surprise, calibrated on validation episodes.

What can be known of an error before it happens is in three signals, all of the input: how large errors are there (a
small network that learned the logarithm of the model's own errors), how far two whole models of different seeds differ
(deep ensembles: Lakshminarayanan et al. 2017; PETS: Chua et al. 2018), and how far the input is from all training
inputs, by the nearest of centres that cover them (Gonzalez 1985) and by Mahalanobis' distance. The first two make the
scale of an error; intervals are multiples of it that held on validation episodes (split conformal prediction with a
scale: Lei et al. 2018). Trust is Fisher's combination of the other signals' p-values, held against validation points.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import safetensors.torch
import torch
from jaxtyping import Float, Float32, Float64
from safetensors import SafetensorError
from torch import Tensor

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.files import atomic_path, write_json
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.networks.files import SavedNetwork, load_network, read_index, save_network
from addressed_dynamics.networks.frozen import FrozenLayer
from addressed_dynamics.networks.stacked import StackedMLP

if TYPE_CHECKING:
    from addressed_dynamics.simulators.addressed import AddressedDynamics

FORMAT = 1
SIGNALS = ("spread", "distance", "unlikeness")
"""What trust is made of: how far two models differ, the distance to the nearest centre, and Mahalanobis' distance."""
GAUGE = ("mean", "deviation", "whitening", "centres", "error_mean", "floor", "weights", "limits")
"""Names of `Gauge.tensors`."""
TAIL = 0.05
"""Beyond the values that this share of the validation points exceed, p-values fall exponentially."""
ROUNDING = 1e-6
"""Share of its squared length by which a squared distance may be off."""
KEPT = 64
"""Coverages and lengths of rollouts whose intervals are kept ready."""
_TINY = np.finfo(np.float32).tiny
_AT_TAIL = -float(np.log(TAIL))
BLOCK_ROWS = 4096
"""Inputs that are compared with all centres at once."""


class Scales(NamedTuple):
    """What is expected of an error."""

    error: Float[Tensor, "sample observation"]
    """Its size in each dimension of the state, in the environment's units; infinite where nothing is known."""
    signals: Float64[np.ndarray, "signal sample"]
    """`SIGNALS`, the larger the less is known; infinite where an input is not finite."""


class Followed(NamedTuple):
    """A rollout with what was expected of its errors."""

    states: Float[Tensor, "sample step observation"]
    scale: Float[Tensor, "sample step observation"]
    """Sum of the sizes of the errors that were expected on the way."""
    signals: Float64[np.ndarray, "signal sample step"]


Expectation: TypeAlias = "Callable[[AddressedDynamics, Tensor, Tensor, Tensor | None, Tensor, Tensor], Scales]"
"""(model, states, actions, exogenous inputs, what it predicts, its inputs) -> what is expected of its errors."""


class TrustedRollout(NamedTuple):
    """A rollout with intervals and trust; arrays, or tensors if it began from one."""

    states: Any
    """States, (B, T, d_obs), in the environment's units."""
    low: Any
    """Lower end of each state's interval, (B, T, d_obs); minus infinity beyond the steps that were calibrated."""
    high: Any
    """Its upper end."""
    trust: Any
    """Trust in each step, (B, T), as `AddressedDynamics.trust` has it of the state and action that the step began
    with."""


@dataclass(frozen=True)
class Reference:
    """Values that validation points have, as quantiles, by which others are judged."""

    quantiles: Float64[np.ndarray, " quantile"]
    """Equally spaced quantiles from the lowest value to the highest."""
    excess: float
    """Mean excess of the values above the quantile 1 - `TAIL`."""

    @staticmethod
    def of(values: Float64[np.ndarray, " point"], number: int = 1001) -> Reference:
        """Return the quantiles of values; infinite ones count as the largest."""
        known = np.where(np.isfinite(values), values, np.max(values, where=np.isfinite(values), initial=0.0))
        quantiles = np.quantile(known, np.linspace(0.0, 1.0, min(number, max(2, len(known)))))
        start = np.quantile(known, 1.0 - TAIL)
        beyond = known[known > start] - start
        return Reference(quantiles, float(beyond.mean()) if len(beyond) else 0.0)

    @cached_property
    def _levels(self) -> Float64[np.ndarray, " quantile"]:
        return np.linspace(0.0, 1.0, len(self.quantiles))

    @cached_property
    def _tail(self) -> float:
        return float(np.interp(1.0 - TAIL, self._levels, self.quantiles))

    @cached_property
    def _negated(self) -> Float64[np.ndarray, " quantile"]:
        return -self.quantiles[::-1]

    @cached_property
    def _excess(self) -> float:
        # Values that are all the same have no tail; what is beyond them is as unlikely as can be told.
        return max(self.excess, 1e-9 * max(abs(self._tail), 1e-9))

    def share_above(self, values: Float64[np.ndarray, "*batch"]) -> Float64[np.ndarray, "*batch"]:
        """Return the share of validation points with a larger value: 1 below all of them, 0 above.

        Of points with the same value half count as larger, so that the mean over the validation points is 1/2.
        """
        least = np.interp(-values, self._negated, self._levels)
        most = 1.0 - np.interp(values, self.quantiles, self._levels)
        share: Float64[np.ndarray, "*batch"] = (least + most) / 2.0
        return share

    def unlikely(self, values: Float64[np.ndarray, "*batch"]) -> Float64[np.ndarray, "*batch"]:
        """Return minus the logarithm of the share of validation points with a value as large.

        Beyond the quantile 1 - `TAIL` the share is that of an exponential tail with the same mean excess, so that what
        is beyond all validation points still has an order.
        """
        inner = -np.log(np.maximum(self.share_above(values), TAIL)) + 0.0
        beyond = values - self._tail
        step = np.maximum(beyond, 0.0) / self._excess
        found: Float64[np.ndarray, "*batch"] = np.where(beyond > 0.0, _AT_TAIL + step, inner)
        return found


@dataclass(frozen=True)
class Gauge:
    """What is expected of a model's error at an input, before calibration."""

    features: FeatureSpec
    """The model's."""
    errors: StackedMLP
    """From standardised inputs to the logarithm of the absolute error, in multiples of `features.scale`."""
    tensors: dict[str, Tensor]
    """`mean`, `deviation` (input) and `whitening` (input, input) of training inputs; `centres` (centre, input), inputs
    that cover them; `error_mean` (observation) of the errors' logarithms; `floor` (observation), an error too small to
    matter; `weights` (3, observation): of `errors`, of the logarithm of the models' difference, and a constant;
    `limits` (2): the distances that one validation point in a hundred exceeds."""

    def beside(
        self, partner: AddressedDynamics, model: AddressedDynamics, observation: Tensor, action: Tensor,
        exogenous: Tensor | None, predicted: Tensor, x: Tensor,
    ) -> Scales:  # fmt: skip
        """Return the same as `scales`, for what a second model predicts otherwise; arguments as in `difference`."""
        return self.scales(x, difference(model, partner, observation, action, exogenous, predicted, x))

    def scales(self, x: Float[Tensor, "sample input"], difference: Float[Tensor, "sample observation"]) -> Scales:
        """Return the expected sizes of errors, and the signals.

        Where an input is farther from the training inputs than 99 of 100 validation points, the size grows in
        proportion to that distance.

        Args:
            x: inputs of the model, as `features.encode` returns them.
            difference: what a second model predicts otherwise, in the environment's units.
        """
        given, apart = x.numpy(), difference.numpy()
        blocks = [slice(start, start + BLOCK_ROWS) for start in range(0, len(given), BLOCK_ROWS)] or [slice(0)]
        # Inputs whose squares float32 cannot hold are as far off as those that are no numbers.
        with np.errstate(over="ignore", invalid="ignore"):
            parts = [self._of_block(given[rows], apart[rows]) for rows in blocks]
        if len(parts) == 1:
            error, signals = parts[0]
        else:
            error, signals = (np.concatenate(each, axis=axis) for axis, each in enumerate(zip(*parts, strict=True)))
        return Scales(torch.from_numpy(error), signals)

    def _of_block(
        self, x: Float32[np.ndarray, "sample input"], difference: Float32[np.ndarray, "sample observation"]
    ) -> tuple[Float32[np.ndarray, "sample observation"], Float64[np.ndarray, "signal sample"]]:
        """Return the expected sizes of errors, and the signals; of few inputs at once."""
        own = self._arrays
        apart = np.abs(difference) * own["per_scale"]
        logarithms, distances = self._looked_up(x)
        size = np.exp(own["of_errors"] * logarithms + own["of_difference"] * np.log(apart + own["floor"]))
        farther = np.maximum((distances / own["limits"]).max(axis=0), np.float32(1.0))
        error: Float32[np.ndarray, "sample observation"] = size * own["constant"] * farther[:, None]
        spread = np.sqrt(np.square(apart, dtype=np.float64).mean(axis=1) + 1e-24)
        signals: Float64[np.ndarray, "signal sample"] = np.log(np.concatenate([spread[None], distances + 1e-12]))
        # Where an input is not finite, no distance is; where what differs is not, the spread is not.
        known = np.isfinite(signals).all(axis=0) & np.isfinite(error).all(axis=1)
        if not known.all():
            error[~known], signals[:, ~known] = np.inf, np.inf
        return error, signals

    def _looked_up(
        self, x: Float32[np.ndarray, "sample input"]
    ) -> tuple[Float32[np.ndarray, "sample observation"], Float32[np.ndarray, "distance sample"]]:
        """Return the logarithms that the network of errors says, and the distances to the training inputs.

        The first layer, the whitening and the products with the centres are one product of matrices.
        """
        width, inputs = self.errors.widths[1], x.shape[1]
        first = self._first(x)
        hidden = np.tanh(first[:, :width])
        *inner, last = self._later
        for layer in inner:
            hidden = layer(hidden, "tanh")
        length = np.einsum("ij,ij->i", x, x)
        squares = first[:, width + inputs :].min(axis=1) + length
        # What is nearer is rounding, which is another one in a batch of another size.
        nearest = np.maximum(squares, np.float32(ROUNDING) * (length + np.float32(inputs)))
        whitened = first[:, width : width + inputs]
        unlike = np.einsum("ij,ij->i", whitened, whitened)
        return last(hidden), np.sqrt(np.stack([nearest, unlike]) / np.float32(inputs))

    @cached_property
    def _first(self) -> FrozenLayer:
        """Standardise inputs and multiply them with the first layer, the whitening and the centres."""
        known = self.tensors
        mean, deviation = known["mean"].double(), known["deviation"].double().unsqueeze(1)
        columns = (
            torch.cat([self.errors.weights[0][0].detach().double(), known["whitening"].double()], dim=1) / deviation
        )
        shift = -mean @ columns
        shift[: self.errors.widths[1]] += self.errors.biases[0][0, 0].detach().double()
        centres = known["centres"].double()
        columns = torch.cat([columns, -2 * centres.T], dim=1)
        return FrozenLayer.of(columns.float(), torch.cat([shift, centres.square().sum(dim=1)]).float())

    @cached_property
    def _later(self) -> list[FrozenLayer]:
        """The layers after the first."""
        layers = list(zip(self.errors.weights, self.errors.biases, strict=True))[1:]
        return [FrozenLayer.of(weight[0].detach(), bias[0, 0].detach()) for weight, bias in layers]

    @cached_property
    def _arrays(self) -> dict[str, Float32[np.ndarray, " ..."]]:
        """What the rest is made of, in the environment's units."""
        known = {name: each.numpy() for name, each in self.tensors.items()}
        of_errors, of_difference, constant = known["weights"]
        scale = np.array(self.features.scale, dtype=np.float32)
        return {
            "per_scale": 1.0 / scale,
            "floor": known["floor"],
            "limits": known["limits"][:, None],
            "of_errors": of_errors,
            "of_difference": of_difference,
            "constant": scale * np.exp(constant + of_errors * known["error_mean"]),
        }


@dataclass(frozen=True)
class Trust:
    """A gauge with what it said of validation episodes."""

    gauge: Gauge
    partner: AddressedDynamics
    """A second model, whose difference tells how much the data leave open."""
    signals: tuple[Reference, ...]
    """`SIGNALS` of validation points."""
    combined: Reference
    """What they come to."""
    surprise: Reference
    """Largest error of a dimension in multiples of its expected size."""
    steps: tuple[int, ...]
    """Steps of a rollout that were calibrated, from 1 on."""
    coverages: tuple[float, ...]
    """Shares of errors, rising."""
    multiples: Float32[np.ndarray, "step coverage observation"]
    """Half of an interval in multiples of the expected size, or of its sum over a rollout."""
    episodes: int
    """Validation episodes that it was calibrated on."""
    networks: tuple[str, str] | None = None
    """What `fingerprint` says of the model and of the second one; None if nobody noted that down."""

    def scales(
        self, model: AddressedDynamics, observation: Tensor, action: Tensor, exogenous: Tensor | None,
        predicted: Tensor, x: Tensor,
    ) -> Scales:  # fmt: skip
        """Return what is expected of the errors of a model's predictions."""
        return self.gauge.beside(self.partner, model, observation, action, exogenous, predicted, x)

    def check_coverage(self, coverage: float) -> None:
        """Check that intervals of such a coverage are known.

        Raises:
            ModelError: they are not.
        """
        if not isinstance(coverage, Real):
            message = f"coverage is a share between 0 and 1, for instance 0.9, but is {coverage!r}"
            raise ModelError(message)
        if not 0.0 < coverage < 1.0:
            message = f"coverage is a share between 0 and 1, for instance 0.9, but is {coverage:g}"
            raise ModelError(message)
        low, high = self.coverages[0], self.coverages[-1]
        if not low <= coverage <= high:
            message = (
                f"{self.episodes} validation episodes calibrate coverages from {low:g} to {high:g}, but {coverage:g} "
                "was asked for"
            )
            raise ModelError(message)

    def trust(self, signals: Float64[np.ndarray, "signal ..."]) -> Float64[np.ndarray, "*batch"]:
        """Return the share of validation points whose signals were more unlikely together; 0 where one is infinite."""
        return self.combined.share_above(self.unlikely(signals))

    def unlikely(self, signals: Float64[np.ndarray, "signal ..."]) -> Float64[np.ndarray, "*batch"]:
        """Return Fisher's combination of the signals' p-values, the larger the less is known."""
        return together(self.signals, signals)

    def half(
        self, scale: Float[Tensor, "sample step observation"], coverage: float
    ) -> Float[Tensor, "sample step observation"]:
        """Return half of the intervals in the steps of a rollout; infinite beyond those that were calibrated.

        Args:
            scale: sums of the expected sizes of errors, in the environment's units.
            coverage: share of errors that should lie within.

        Raises:
            ModelError: there is no such coverage.
        """
        multiples = self._multiples(coverage, scale.shape[1])
        # Where nothing can be off, a scale of 0 times infinity would be no number.
        with np.errstate(over="ignore", invalid="ignore"):
            return torch.from_numpy(np.maximum(scale.numpy(), _TINY) * multiples)

    @cached_property
    def _multiples_of(self) -> dict[tuple[float, int], Float32[np.ndarray, "step observation"]]:
        return {}

    def _multiples(self, coverage: float, number: int) -> Float32[np.ndarray, "step observation"]:
        """Return half of an interval in multiples of the expected size, for so many first steps; kept for the next.

        Raises:
            ModelError: there is no such coverage.
        """
        self.check_coverage(coverage)
        if (coverage, number) in self._multiples_of:
            return self._multiples_of[coverage, number]
        level = float(np.interp(coverage, self.coverages, np.arange(len(self.coverages))))
        below = min(int(level), len(self.coverages) - 2)
        part = float(level - below)
        at_steps = (1 - part) * self.multiples[:, below] + part * self.multiples[:, below + 1]
        steps = np.arange(1, number + 1)
        logs = np.log(self.steps)
        by_step = np.stack([np.interp(np.log(steps), logs, column) for column in at_steps.T], axis=1)
        by_step[steps > self.steps[-1]] = np.inf
        if len(self._multiples_of) > KEPT:
            self._multiples_of.clear()
        self._multiples_of[coverage, number] = found = by_step.astype(np.float32)
        return found

    def ends(
        self,
        states: Float[Tensor, "sample step observation"],
        scale: Float[Tensor, "sample step observation"],
        coverage: float,
    ) -> tuple[Float[Tensor, "sample step observation"], Float[Tensor, "sample step observation"]]:
        """Return the ends of the intervals around predicted states; infinite where these are not finite.

        Args:
            states: in the steps of a rollout.
            scale: as in `half`.
            coverage: as in `half`.

        Raises:
            ModelError: there is no such coverage.
        """
        half, middle = self.half(scale, coverage).numpy(), states.numpy()
        with np.errstate(over="ignore", invalid="ignore"):
            low, high = middle - half, middle + half
        unknown = ~np.isfinite(middle)
        if unknown.any():
            low[unknown], high[unknown] = -np.inf, np.inf
        return torch.from_numpy(low), torch.from_numpy(high)

    def surprises(
        self, error: Float[Tensor, "sample observation"], expected: Float[Tensor, "sample observation"]
    ) -> Float64[np.ndarray, " sample"]:
        """Return minus the logarithm of the share of validation points with an error as large for its expected size."""
        return self.surprise.unlikely(beyond_expectation(error, expected))


def together(
    references: Sequence[Reference], signals: Float64[np.ndarray, "signal ..."]
) -> Float64[np.ndarray, "*batch"]:
    """Return Fisher's combination: the sum of minus the logarithms of the p-values."""
    each = [reference.unlikely(signal) for reference, signal in zip(references, signals, strict=True)]
    total: Float64[np.ndarray, "*batch"] = np.sum(each, axis=0)
    return total


def beyond_expectation(
    error: Float[Tensor, "sample observation"], expected: Float[Tensor, "sample observation"]
) -> Float64[np.ndarray, " sample"]:
    """Return the largest error of a dimension in multiples of its expected size; infinite if one is not finite."""
    multiples = (error.double().abs() / expected.double()).nan_to_num(nan=torch.inf, posinf=torch.inf)
    # Where nothing is known, an error is no surprise; but what is no number is never expected.
    unknown = expected.isinf() & error.isfinite()
    largest: Float64[np.ndarray, " sample"] = torch.where(unknown, 0.0, multiples).max(dim=1).values.numpy()
    return largest


def difference(
    model: AddressedDynamics, partner: AddressedDynamics, observation: Tensor, action: Tensor,
    exogenous: Tensor | None, predicted: Tensor, x: Tensor,
) -> Float[Tensor, "sample observation"]:  # fmt: skip
    """Return what a second model predicts otherwise, in the environment's units.

    Args:
        model: the first.
        partner: the second.
        observation: states, as `AddressedDynamics.predict` takes them.
        action: actions.
        exogenous: exogenous inputs.
        predicted: what the first model predicts.
        x: its inputs.
    """
    inputs = x if model.sees_as(partner) else None
    return predicted - partner.step(observation, action, exogenous, x=inputs)


def fingerprint(model: AddressedDynamics) -> str:
    """Return what tells a model's networks from others: a hash of their parameters."""
    digest = hashlib.sha256()
    for network in (model.ensemble, model.addressing):
        for parameter in network.parameters() if network else ():
            digest.update(parameter.detach().contiguous().numpy().tobytes())
    return digest.hexdigest()


def save_trust(folder: Path, trust: Trust, partner: dict[str, Any]) -> None:
    """Write a model's trust into a folder of its own, which appears whole or not at all.

    Args:
        folder: where.
        trust: what was calibrated.
        partner: which of the experiment's models the second one is, as arguments of `AddressedDynamics.load`.
    """
    references = {"combined": trust.combined, "surprise": trust.surprise}
    references |= dict(zip(SIGNALS, trust.signals, strict=True))
    tensors = {f"gauge/{name}": value.contiguous() for name, value in trust.gauge.tensors.items()}
    tensors |= {f"quantiles/{name}": torch.from_numpy(each.quantiles) for name, each in references.items()}
    tensors["multiples"] = torch.from_numpy(trust.multiples).contiguous()
    with atomic_path(folder) as temporary:
        temporary.mkdir(parents=True)
        save_network(temporary / "errors", SavedNetwork(trust.gauge.errors, trust.gauge.features, {}))
        safetensors.torch.save_file(tensors, temporary / "trust.safetensors")
        config = {
            "format": FORMAT,
            "partner": partner,
            "steps": list(trust.steps),
            "coverages": list(trust.coverages),
            "episodes": trust.episodes,
            "excess": {name: each.excess for name, each in references.items()},
            **({"networks": list(trust.networks)} if trust.networks else {}),
        }
        write_json(temporary / "trust.json", config)


def partner_of(folder: Path) -> dict[str, Any]:
    """Return which model the second one is, of a trust that `save_trust` wrote.

    Raises:
        ModelError: a file is missing or damaged.
    """
    partner = read_index(folder, "trust.json").get("partner")
    if not isinstance(partner, dict):
        raise _malformed(folder, "it names no second model")
    return partner


def load_trust(folder: Path, partner: AddressedDynamics) -> Trust:
    """Read what `save_trust` wrote.

    Raises:
        ModelError: a file is missing or damaged.
    """
    config = read_index(folder, "trust.json")
    errors = load_network(folder / "errors", FeatureSpec)
    try:
        tensors = safetensors.torch.load_file(folder / "trust.safetensors")
        gauge = {name: tensors[f"gauge/{name}"] for name in GAUGE}
        references = {
            name: Reference(tensors[f"quantiles/{name}"].numpy(), float(excess))
            for name, excess in config["excess"].items()
        }
        return Trust(
            Gauge(errors.features, errors.stack, gauge),
            partner,
            tuple(references[name] for name in SIGNALS),
            references["combined"],
            references["surprise"],
            tuple(int(step) for step in config["steps"]),
            tuple(float(share) for share in config["coverages"]),
            tensors["multiples"].numpy(),
            int(config["episodes"]),
            None if config.get("networks") is None else (str(config["networks"][0]), str(config["networks"][1])),
        )
    except (KeyError, IndexError, TypeError, ValueError, OSError, SafetensorError) as error:
        raise _malformed(folder, str(error)) from error


def _malformed(folder: Path, what: str) -> ModelError:
    return ModelError(f"{folder}: incomplete or malformed ({what}); evaluation writes it: 'dvc repro' brings it back")
