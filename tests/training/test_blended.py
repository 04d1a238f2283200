"""Training through the mixture of parameters: against autograd on networks built one by one, and again after a stop."""

import math
from pathlib import Path

import pytest
import torch
from motions import make_motion
from torch import Tensor

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.params.sections import OptimiserParams
from addressed_dynamics.base.params.training import BlendedTraining
from addressed_dynamics.features.motion.features import fit_motion_features
from addressed_dynamics.networks.spline import catmull_rom
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.motion import MotionModel
from addressed_dynamics.sources.motion.params import MotionFeatureParams
from addressed_dynamics.training.blended import (
    BlendedEpoch,
    draw_kept,
    forward_with_dropout,
    train_gated,
    train_phase_functioned,
    untrained_blended,
)
from addressed_dynamics.training.checkpoints import Checkpoint

MOTION, OTHER = make_motion(), make_motion(24, seed=1)
FEATURES = fit_motion_features(MOTION, MotionFeatureParams(target="absolute"))
TRAIN, VALIDATION = FEATURES.samples(MOTION), FEATURES.samples(OTHER)
PHASE, VALIDATION_PHASE = torch.from_numpy(MOTION.phase), torch.from_numpy(OTHER.phase)


def params(**changes: object) -> BlendedTraining:
    plain = BlendedTraining(
        hidden=(16, 16), gate_hidden=(8,), members=3, activation="elu", loss="mse",
        optimiser=OptimiserParams(learning_rate=3e-3, betas=(0.9, 0.999), final_share=1.0), batch_size=32, epochs=3,
    )  # fmt: skip
    return plain.model_copy(update=changes)


def run(
    kind: str,
    recipe: BlendedTraining,
    checkpoint: Checkpoint | None = None,
    stop: int = 0,
    updates: int | None = None,
) -> list[BlendedEpoch]:
    if kind == "phase":
        epochs = train_phase_functioned(
            TRAIN, PHASE, VALIDATION, VALIDATION_PHASE, recipe, seed=0, checkpoint=checkpoint, updates=updates
        )
    else:
        epochs = train_gated(TRAIN, VALIDATION, recipe, seed=0, checkpoint=checkpoint, updates=updates)
    result = []
    for epoch in epochs:
        result.append(epoch)
        if epoch.index == stop:
            break
    return result


def tensors(epoch: BlendedEpoch) -> list[Tensor]:
    return [*epoch.network.parameters(), *(epoch.gate.parameters() if epoch.gate else [])]


KINDS = pytest.mark.parametrize("kind", ["phase", "gate"])


def test_without_dropout_the_forward_pass_is_that_of_the_stack() -> None:
    stack = StackedMLP(4, (342, 8, 311), "elu", torch.Generator().manual_seed(0))
    mix = catmull_rom(PHASE)
    output = forward_with_dropout(stack, TRAIN.x, mix, 0.0, [])
    torch.testing.assert_close(output, stack.forward_blended(TRAIN.x, mix))


def test_dropout_keeps_the_mean_of_a_layers_inputs() -> None:
    stack = StackedMLP(1, (342, 311), "elu", torch.Generator().manual_seed(0)).requires_grad_(False)
    generator, one, x = torch.Generator().manual_seed(1), torch.ones(4000, 1), TRAIN.x[:1].expand(4000, -1)
    dropped = forward_with_dropout(stack, x, one, 0.3, draw_kept(stack, x, 0.3, generator))
    whole = stack.forward_blended(x[:1], one[:1])[0]
    spread = dropped.std(dim=0) / math.sqrt(len(x))
    assert ((dropped.mean(dim=0) - whole).abs() < 5 * spread).all()
    assert float(dropped.std(dim=0).min()) > 0.0


@KINDS
def test_an_update_is_that_of_autograd_on_networks_that_are_built_for_each_sample(kind: str) -> None:
    recipe = params(batch_size=len(TRAIN), epochs=1, dropout=0.0, weight_penalty=0.3)
    (trained,) = run(kind, recipe)
    stack, gate = untrained_blended(342, 311, recipe, seed=0, gated=kind == "gate")
    own = [*stack.parameters(), *(gate.parameters() if gate else [])]
    mixes = torch.softmax(gate(TRAIN.x)[0], dim=1) if gate else catmull_rom(PHASE)
    total = torch.zeros(())
    for x, y, mix in zip(TRAIN.x, TRAIN.y, mixes, strict=True):
        hidden = x
        for layer, (weight, bias) in enumerate(zip(stack.weights, stack.biases, strict=True)):
            hidden = torch.nn.functional.elu(hidden) if layer else hidden
            hidden = hidden @ torch.einsum("m,mio->io", mix, weight) + torch.einsum("m,mo->o", mix, bias[:, 0])
        total = total + (hidden - y).square().mean() / len(TRAIN)
    penalty = sum((parameter.abs().mean() for parameter in stack.parameters()), torch.zeros(())) * 0.3 / 6
    (total + penalty).backward()
    # Adam's first step has the size of the learning rate and the sign of the gradient.
    for before, after in zip(own, tensors(trained), strict=True):
        assert before.grad is not None
        clear = before.grad.abs() > 1e-6
        assert clear.any()
        torch.testing.assert_close(
            (after - before)[clear], -3e-3 * before.grad.sign()[clear], atol=3e-5, rtol=0, check_device=False
        )
    assert trained.metrics["loss/train"] == pytest.approx(float(total.detach()), rel=1e-4)


@KINDS
def test_training_lowers_the_loss(kind: str) -> None:
    epochs = run(kind, params(epochs=12, dropout=0.0, weight_penalty=0.0))
    assert epochs[-1].metrics["loss/train"] < 0.5 * epochs[0].metrics["loss/train"]
    assert [epoch.index for epoch in epochs] == list(range(1, 13))
    assert [epoch.last for epoch in epochs] == [False] * 11 + [True]


@KINDS
def test_training_twice_gives_equal_bytes(kind: str) -> None:
    first, second = run(kind, params())[-1], run(kind, params())[-1]
    assert all(torch.equal(a, b) for a, b in zip(tensors(first), tensors(second), strict=True))
    assert first.metrics == second.metrics


@KINDS
def test_training_that_was_stopped_ends_as_without_the_stop(kind: str, tmp_path: Path) -> None:
    whole = run(kind, params())
    run(kind, params(), Checkpoint(tmp_path / "state"), stop=2)
    resumed = run(kind, params(), Checkpoint(tmp_path / "state"))
    assert [epoch.metrics for epoch in resumed] == [epoch.metrics for epoch in whole]
    assert all(torch.equal(a, b) for a, b in zip(tensors(resumed[-1]), tensors(whole[-1]), strict=True))


def test_what_was_trained_makes_a_model() -> None:
    phase, gate = run("phase", params(epochs=1))[-1], run("gate", params(epochs=1))[-1]
    x = torch.from_numpy(OTHER.x)
    by_phase = MotionModel(FEATURES, phase.network, mode="phase").predict(x, phase=VALIDATION_PHASE)
    by_gate = MotionModel(FEATURES, gate.network, gate.gate, mode="blend").predict(x)
    for predicted, epoch in ((by_phase, phase), (by_gate, gate)):
        error = FEATURES.encode_target(x, predicted) - VALIDATION.y
        assert float(error.square().mean()) == pytest.approx(epoch.metrics["loss/validation"], rel=1e-3)


def test_samples_without_their_phases_are_refused() -> None:
    with pytest.raises(TrainingError, match="every sample needs its phase"):
        next(train_phase_functioned(TRAIN, PHASE[:5], VALIDATION, VALIDATION_PHASE, params(), seed=0))


@KINDS
def test_training_stops_after_exactly_so_many_updates(kind: str) -> None:
    per_epoch = math.ceil(len(TRAIN) / 32)
    updates = 3 * per_epoch - 1
    last = run(kind, params(), updates=updates)[-1]
    assert (last.index, last.last, last.updates, last.samples) == (
        3,
        True,
        updates,
        2 * len(TRAIN) + 32 * (per_epoch - 1),
    )
    whole, exact = run(kind, params())[-1], run(kind, params(epochs=5), updates=3 * per_epoch)[-1]
    assert all(torch.equal(a, b) for a, b in zip(tensors(whole), tensors(exact), strict=True))
    assert whole.metrics == exact.metrics


@KINDS
@pytest.mark.parametrize("loss", ["mse", "mae", "mae+mse"])
def test_losses_in_training_and_in_validation_are_of_one_unit(kind: str, loss: str) -> None:
    optimiser = OptimiserParams(learning_rate=1e-30, betas=(0.9, 0.999), final_share=1.0)
    recipe = params(loss=loss, dropout=0.0, weight_penalty=0.0, optimiser=optimiser, batch_size=len(TRAIN), epochs=1)
    if kind == "phase":
        epochs = train_phase_functioned(TRAIN, PHASE, TRAIN, PHASE, recipe, seed=0)
    else:
        epochs = train_gated(TRAIN, TRAIN, recipe, seed=0)
    (epoch,) = epochs
    assert epoch.metrics["loss/train"] == pytest.approx(epoch.metrics["loss/validation"], rel=1e-5)
