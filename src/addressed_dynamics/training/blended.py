"""Training networks through the mixture of their parameters: phase-functioned networks, and networks with a gate.

Both train `StackedMLP.forward_blended`: with coefficients that the phase gives (Holden, Komura, Saito 2017), or with
those of a gating network, which is the mode `blend` trained end to end, in the manner of mode-adaptive networks (Zhang
et al. 2018).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.params.training import BlendedTraining
from addressed_dynamics.base.torch_runtime import CPU, named_generator, sent
from addressed_dynamics.features.common.augmentation import Augment
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.networks.addressing import addressing_scores
from addressed_dynamics.networks.spline import CONTROL_POINTS, catmull_rom
from addressed_dynamics.networks.stacked import ACTIVATIONS, StackedMLP, in_chunks
from addressed_dynamics.training.adam import FlatAdam
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.epochs import Epoch, Length, batches
from addressed_dynamics.training.graphs import Repeated
from addressed_dynamics.training.losses import loss_profile, reported_loss

Coefficients = Callable[[Tensor, Tensor], Tensor]
"""(inputs (B, input), rows (B,)) -> what weighs each member for each of them, (B, member)."""


@dataclass(frozen=True)
class BlendedEpoch(Epoch):
    """One finished epoch; `network` holds the networks that are mixed."""

    gate: StackedMLP | None = None
    """The network whose softmax mixes them; None if the phase does."""


def train_phase_functioned(
    train: Samples,
    train_phase: Float[Tensor, " sample"],
    validation: Samples,
    validation_phase: Float[Tensor, " sample"],
    params: BlendedTraining,
    *,
    seed: int,
    augment: Augment | None = None,
    checkpoint: Checkpoint | None = None,
    updates: int | None = None,
    device: torch.device = CPU,
) -> Iterator[BlendedEpoch]:
    """Train a phase-functioned network; yield after every epoch. Metrics, checkpoint, `updates` as in `train_gated`.

    Raises:
        TrainingError: there are no samples, their phases are others, `updates` are more than the epochs have, or the
            loss is not finite.
    """
    if len(train) != len(train_phase) or len(validation) != len(validation_phase):
        message = (
            f"every sample needs its phase, but there are {len(train)} and {len(validation)} samples "
            f"with {len(train_phase)} and {len(validation_phase)} phases"
        )
        raise TrainingError(message)
    on_train, on_validation = (catmull_rom(phase).to(device) for phase in (train_phase, validation_phase))
    stack, _ = untrained_blended(train.x.shape[1], train.y.shape[1], params, seed=seed, gated=False)
    yield from _train(
        train, validation, params, stack, None, lambda _, rows: on_train[rows], lambda _, rows: on_validation[rows],
        seed=seed, augment=augment, checkpoint=checkpoint, updates=updates, device=device,
    )  # fmt: skip


def train_gated(
    train: Samples,
    validation: Samples,
    params: BlendedTraining,
    *,
    seed: int,
    augment: Augment | None = None,
    checkpoint: Checkpoint | None = None,
    updates: int | None = None,
    device: torch.device = CPU,
) -> Iterator[BlendedEpoch]:
    """Train networks together with a gate whose softmax mixes their parameters; yield after every epoch.

    Metrics: `loss/train` and `loss/validation` (without dropout), both as `reported_loss` has them, of normalised
    targets and without the penalty; `learning_rate`. With a checkpoint, training goes on from it if it exists, and with
    `updates` it stops after exactly so many, and with a device it trains there, as `train_ensemble` does.

    Raises:
        TrainingError: there are no samples, `updates` are more than the epochs have, or the loss is not finite.
    """
    stack, gate = untrained_blended(train.x.shape[1], train.y.shape[1], params, seed=seed, gated=True)
    assert gate is not None
    gate = gate.on(device)

    def coefficients(x: Tensor, _: Tensor) -> Tensor:
        return torch.softmax(addressing_scores(gate, x), dim=1)

    yield from _train(
        train, validation, params, stack, gate, coefficients, coefficients,
        seed=seed, augment=augment, checkpoint=checkpoint, updates=updates, device=device,
    )  # fmt: skip


def untrained_blended(
    inputs: int, outputs: int, params: BlendedTraining, *, seed: int, gated: bool
) -> tuple[StackedMLP, StackedMLP | None]:
    """Return the networks that training starts from, and the gate if there is to be one."""
    members = params.members if gated else CONTROL_POINTS
    widths = (inputs, *params.hidden, outputs)
    stack = StackedMLP(members, widths, params.activation, named_generator(seed, "blended/weights"))
    if not gated:
        return stack, None
    gate_widths = (inputs, *params.gate_hidden, members)
    return stack, StackedMLP(1, gate_widths, params.activation, named_generator(seed, "blended/gate"))


def forward_with_dropout(
    stack: StackedMLP,
    x: Float[Tensor, "sample input"],
    coefficients: Float[Tensor, "sample member"],
    dropout: float,
    kept: Sequence[Bool[Tensor, "sample input"]],
) -> Float[Tensor, "sample output"]:
    """Return what `forward_blended` does, with a share of every layer's inputs set to 0 and the others made larger.

    Which are kept is what `draw_kept` returns.
    """
    mix, hidden, keep = coefficients.T.unsqueeze(-1), x, 1.0 - dropout
    for layer, (weight, bias) in enumerate(zip(stack.weights, stack.biases, strict=True)):
        if layer:
            hidden = ACTIVATIONS[stack.activation](hidden)
        if dropout:
            hidden = hidden * (kept[layer].to(hidden.dtype) / keep)
        hidden = (mix * torch.baddbmm(bias, hidden.expand(stack.members, -1, -1), weight)).sum(dim=0)
    return hidden


def draw_kept(
    stack: StackedMLP, x: Float[Tensor, "sample input"], dropout: float, generator: torch.Generator
) -> list[Bool[Tensor, "sample input"]]:
    """Draw which inputs of each layer are kept, on the CPU; nothing without dropout."""
    widths = stack.widths[:-1] if dropout else ()
    return [sent(torch.rand((len(x), width), generator=generator) < 1.0 - dropout, x.device) for width in widths]


def _train(
    train: Samples,
    validation: Samples,
    params: BlendedTraining,
    stack: StackedMLP,
    gate: StackedMLP | None,
    on_train: Coefficients,
    on_validation: Coefficients,
    *,
    seed: int,
    augment: Augment | None,
    checkpoint: Checkpoint | None,
    updates: int | None,
    device: torch.device,
) -> Iterator[BlendedEpoch]:
    if not len(train) or not len(validation):
        message = "there are no samples to train the mixed networks on: put more clips into the training split"
        raise TrainingError(message)
    generator = named_generator(seed, "blended/batches")
    length = Length.of(len(train), 1, params.batch_size, epochs=params.epochs, updates=updates)
    train, validation, stack = train.to(device), validation.to(device), stack.on(device)
    trainer = _BlendedTrainer(stack, gate, params, length.updates, generator, on_train)

    def ended(epoch: int, metrics: dict[str, float]) -> BlendedEpoch:
        made, seen = length.updates_after(epoch), length.samples_after(epoch)
        mixing = None if gate is None else gate.on(CPU)
        return BlendedEpoch(epoch, epoch == length.epochs, made, metrics, stack.on(CPU), seen, mixing)

    history, state = checkpoint.load() if checkpoint else ([], {})
    if history:
        generator.set_state(state.pop("generator"))
        trainer.adam.restore(state)
    for epoch, metrics in enumerate(history, start=1):
        yield ended(epoch, metrics)
    one_bin = torch.zeros(len(train), dtype=torch.uint8)
    for epoch in range(len(history) + 1, length.epochs + 1):
        rate, losses = trainer.adam.learning_rate, torch.zeros((), dtype=torch.float64, device=device)
        for batch in islice(batches(one_bin, 1, params.batch_size, generator, device), length.updates_in(epoch)):
            rows = batch.rows[0]
            x, y = train.x[rows], train.y[rows]
            if augment is not None:
                x, y = augment(x, y, generator)
            losses += trainer.update(x, y, batch.weight[0], rows)
        total = float(losses)
        if not total < float("inf"):
            message = "the training loss is not finite any more: lower the learning rate"
            raise TrainingError(message)
        metrics = {"loss/train": total / length.updates_in(epoch), "learning_rate": rate}
        metrics["loss/validation"] = _loss(stack, on_validation, validation, reported_loss(params.loss))
        history.append(metrics)
        if checkpoint:
            checkpoint.save(history, {**trainer.adam.state(), "generator": generator.get_state()})
        yield ended(epoch, metrics)


class _BlendedTrainer:
    """Adam on networks through the mixture of their parameters, and on the gate that mixes them, if there is one."""

    def __init__(
        self,
        stack: StackedMLP,
        gate: StackedMLP | None,
        params: BlendedTraining,
        total_updates: int,
        generator: torch.Generator,
        coefficients: Coefficients,
    ) -> None:
        self._stack = stack
        self._coefficients = coefficients
        self._params = params
        self._generator = generator
        self._parameters = [*stack.parameters(), *([] if gate is None else gate.parameters())]
        self.adam = FlatAdam(self._parameters, params.optimiser, total_updates)
        own = list(stack.parameters())
        self._penalties = [params.weight_penalty / len(own) / parameter.numel() for parameter in own]
        self._change = self._gradients_and_change if own[0].is_cpu else Repeated(self._gradients_and_change)

    def update(
        self,
        x: Float[Tensor, "sample input"],
        y: Float[Tensor, "sample output"],
        weight: Float[Tensor, " sample"],
        rows: Int64[Tensor, " sample"],
    ) -> Float[Tensor, ""]:
        """Train on a batch; return its loss before the update, as it is reported and without the penalty."""
        self.adam.begin()
        return self._change(x, y, weight, rows, *draw_kept(self._stack, x, self._params.dropout, self._generator))

    def _gradients_and_change(
        self, x: Tensor, y: Tensor, weight: Tensor, rows: Tensor, *kept: Tensor
    ) -> Float[Tensor, ""]:
        with torch.enable_grad():
            output = forward_with_dropout(self._stack, x, self._coefficients(x, rows), self._params.dropout, kept)
            loss = _weighted(output, y, weight, self._params.loss)
        computed = torch.autograd.grad(loss, self._parameters)
        for place, gradient in zip(self.adam.gradients, computed, strict=True):
            place.copy_(gradient)
        # The stack's parameters come first; the gate's are not penalised.
        for place, value, penalty in zip(self.adam.gradients, self.adam.values, self._penalties, strict=False):
            place.add_(value.sign(), alpha=penalty)
        self.adam.change()
        reported = reported_loss(self._params.loss)
        known = loss if reported == self._params.loss else _weighted(output, y, weight, reported)
        return known.detach()


def _weighted(
    output: Float[Tensor, "sample output"],
    target: Float[Tensor, "sample output"],
    weight: Float[Tensor, " sample"],
    loss: str,
) -> Float[Tensor, ""]:
    return (loss_profile(output.unsqueeze(0), target, loss).squeeze(1) * weight).sum()


def _loss(stack: StackedMLP, coefficients: Coefficients, samples: Samples, loss: str) -> float:
    """Return the mean loss of the mixed networks on `samples`, as they are used."""

    def profiles(some: Tensor) -> Tensor:
        x, y = samples.x[some], samples.y[some]
        return loss_profile(stack.forward_blended(x, coefficients(x, some)).unsqueeze(0), y, loss).squeeze(1)

    everything = torch.arange(len(samples), device=samples.device)
    return float(in_chunks(profiles, everything, sample_dim=0).double().mean())
