"""Training through rollouts: the loss over several steps of a network's own predictions."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from learning import CHANGE, ENSEMBLE, drive, sail
from pydantic import ValidationError

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.params.training import EnsembleParams
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.sources.motion.params import MotionEnsembleParams
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.clustering import assign_to_bins
from addressed_dynamics.training.ensemble import evaluate_profiles, horizon_in, train_ensemble, untrained_ensemble
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.losses import REGRESSION_LOSSES
from addressed_dynamics.training.update import StackTrainer

WORLD = drive((20,) * 10)
FEATURES = fit_features(WORLD, CHANGE)
TRAIN, VALIDATION = (FEATURES.samples(world, courses=True) for world in (WORLD, drive((15,) * 4, seed=1)))
FAR = ENSEMBLE.model_copy(update={"horizon": 4})
SINGLE = FAR.model_copy(update={"members": 1, "cluster_epochs": 1})


def train(params: EnsembleParams, **options: Any) -> Iterator[Epoch]:
    return train_ensemble(TRAIN, VALIDATION, params, seed=3, loss_unit=1.0, **options)


def weights(epoch: Epoch) -> bytes:
    return b"".join(parameter.detach().numpy().tobytes() for parameter in epoch.network.parameters())


def in_state_space(stack: StackedMLP, row: int, horizon: int) -> torch.Tensor:
    """The error of one network's states in each known step from a row of the training world, as targets are scaled."""
    state, errors = torch.from_numpy(WORLD.observation[row : row + 1]), []
    for step in range(row, min(row + horizon, 20 * (row // 20 + 1))):
        x = FEATURES.encode(state, torch.from_numpy(WORLD.action[step : step + 1]))
        state = FEATURES.decode(stack(x)[0], state)
        errors.append((state - torch.from_numpy(WORLD.next_observation[step : step + 1]))[0])
    return torch.stack(errors) / FEATURES.constants.target_scale / FEATURES.target_deviation


@pytest.mark.parametrize("loss", ["mse", "mae", "mae+mse"])
@pytest.mark.parametrize("linear", [False, True])
def test_gradients_are_those_of_the_errors_of_states(loss: str, linear: bool) -> None:
    params = SINGLE.model_copy(update={"loss": loss, "linear": linear, "activation": "tanh"})
    stack, reference = (untrained_ensemble(TRAIN.x.shape[1], TRAIN.y.shape[1], params, seed=0) for _ in range(2))
    rows, weight = torch.tensor([[3, 18, 25, 39]]), torch.tensor([[0.1, 0.2, 0.3, 0.4]])
    trainer = StackTrainer(stack, REGRESSION_LOSSES[loss], params.optimiser, 10)
    found = trainer.gradients_unrolled(TRAIN.courses, rows, weight, 4)
    reported, trained = torch.zeros(()), torch.zeros(())
    for row, share in zip(rows[0].tolist(), weight[0].tolist(), strict=True):
        errors = in_state_space(reference, row, 4)
        squared, absolute = errors.square().mean(), errors.abs().mean()
        reported = reported + share * (absolute if loss == "mae" else squared)
        trained = trained + share * {"mse": squared, "mae": absolute, "mae+mse": squared + absolute}[loss]
    trained.backward()
    torch.testing.assert_close(found[0], reported.detach(), rtol=1e-4, atol=1e-6)
    for gradient, parameter in zip(
        trainer._weight_gradients + trainer._bias_gradients + trainer._linear_gradients, reference.parameters(),
        strict=True,
    ):  # fmt: skip
        torch.testing.assert_close(gradient, parameter.grad, rtol=1e-3, atol=1e-5)


def test_one_step_gives_the_gradients_written_by_hand() -> None:
    stacks = [untrained_ensemble(TRAIN.x.shape[1], TRAIN.y.shape[1], ENSEMBLE, seed=0) for _ in range(2)]
    far, near = (StackTrainer(stack, REGRESSION_LOSSES["mse"], ENSEMBLE.optimiser, 10) for stack in stacks)
    rows, weight = torch.randint(0, len(TRAIN), (2, 8)), torch.full((2, 8), 1 / 8)
    losses = far.gradients_unrolled(TRAIN.courses, rows, weight, 1)
    torch.testing.assert_close(losses, near.gradients(TRAIN.x[rows], TRAIN.y[rows], weight))
    for found, expected in zip(far._weight_gradients, near._weight_gradients, strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-6)


def test_profiles_are_the_mean_losses_over_the_steps_that_are_known() -> None:
    stack = untrained_ensemble(TRAIN.x.shape[1], TRAIN.y.shape[1], ENSEMBLE, seed=0)
    profiles = evaluate_profiles(stack, TRAIN, "mse", 4)
    for member in range(2):
        alone = StackedMLP(1, stack.widths, stack.activation)
        alone.load_state_dict({name: each[member : member + 1] for name, each in stack.state_dict().items()})
        for row in (0, 17, 18, 19, 20, 199):
            expected = in_state_space(alone, row, 4).square().mean()
            torch.testing.assert_close(profiles[row, member], expected.detach(), rtol=1e-3, atol=1e-5)
    torch.testing.assert_close(evaluate_profiles(stack, TRAIN, "mse", 1), evaluate_profiles(stack, TRAIN, "mse"))


@pytest.mark.parametrize("epochs", [1, 2, 5, 24, 60])
@pytest.mark.parametrize("horizon", [1, 2, 10])
def test_the_horizon_grows_from_one_step_to_all_at_half(epochs: int, horizon: int) -> None:
    steps = [horizon_in(epoch, epochs, horizon) for epoch in range(1, epochs + 1)]
    assert steps[0] == 1
    assert steps == sorted(steps)
    assert set(steps[(epochs + 1) // 2 :]) <= {horizon}
    assert horizon_in(-3, epochs, horizon) == 1


def noisy_boat(lengths: Sequence[int], seed: int) -> Transitions:
    """A boat whose sensors are noisy: what predicts the next reading best leads astray in a few steps."""
    world = sail(lengths, seed=seed)
    noise = np.random.default_rng(100 + seed).normal(0.0, 0.3, (len(world) + 1, 2)).astype(np.float32)
    return replace(
        world, observation=world.observation + noise[:-1], next_observation=world.next_observation + noise[1:]
    )


@pytest.mark.parametrize("members", [1, 2])
def test_training_through_rollouts_makes_rollouts_from_noisy_sensors_better(members: int) -> None:
    worlds = noisy_boat((40,) * 8, seed=0), noisy_boat((40,) * 4, seed=1)
    features = fit_features(worlds[0], CHANGE)
    on_train, on_validation = (features.samples(world, courses=True) for world in worlds)
    changes = {"members": members, "hidden": (8,), "cluster_epochs": 1, "epochs": 20, "batch_size": 32}
    errors = []
    for horizon in (1, 8):
        params = ENSEMBLE.model_copy(update=changes | {"horizon": horizon})
        *_, far = train_ensemble(on_train, on_validation, params, seed=3, loss_unit=1.0)
        errors.append(evaluate_profiles(far.network, on_validation, "mse", 8).min(dim=1).values.mean())
    assert errors[1] < 0.7 * errors[0]
    assert far.metrics["loss/rollout"] == pytest.approx(float(errors[1]), rel=1e-5)
    assert far.metrics["horizon"] == 8


def test_bins_are_those_of_algorithm_1_on_the_losses_of_one_step(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "state.safetensors")
    fresh = untrained_ensemble(TRAIN.x.shape[1], TRAIN.y.shape[1], FAR, seed=3)
    expected = assign_to_bins(evaluate_profiles(fresh, TRAIN, "mse"))
    next(train(FAR, checkpoint=checkpoint))
    assert torch.equal(checkpoint.load()[1]["bins"], expected)
    assert not torch.equal(expected, assign_to_bins(evaluate_profiles(fresh, TRAIN, "mse", 4)))


@pytest.mark.parametrize(
    "params", [FAR, SINGLE, FAR.model_copy(update={"restart": True, "early_stopping": 1, "linear": True})]
)
def test_a_training_that_is_cut_off_goes_on_bit_for_bit(tmp_path: Path, params: EnsembleParams) -> None:
    straight = [(each.index, each.last, each.metrics) for each in train(params)]
    *_, expected = train(params)
    for finished in (1, 3, len(straight)):
        checkpoint = Checkpoint(tmp_path / f"{finished}.safetensors")
        for _ in islice(train(params, checkpoint=checkpoint), finished):
            pass
        resumed = list(train(params, checkpoint=checkpoint))
        assert [(each.index, each.last, each.metrics) for each in resumed] == straight
        assert weights(resumed[-1]) == weights(expected)


def test_what_is_stopped_early_is_judged_by_its_rollouts() -> None:
    through = [each.metrics["loss/rollout"] for each in train(FAR)]
    *_, last = train(FAR.model_copy(update={"early_stopping": FAR.epochs}))
    assert last.metrics["epoch/kept"] == 1 + through.index(min(through))


def test_a_trained_network_is_a_model_like_any_other() -> None:
    *_, last = train(SINGLE)
    model = AddressedDynamics(FEATURES, last.network.requires_grad_(False))
    assert model.rollout(WORLD.observation[:3], WORLD.action[:15].reshape(3, 5)).shape == (3, 5, 2)


def test_samples_from_which_nothing_goes_on_are_refused() -> None:
    with pytest.raises(TrainingError, match=r"ensemble\.horizon asks for several steps .* set it to 1"):
        next(train_ensemble(replace(TRAIN, courses=None), VALIDATION, FAR, seed=3, loss_unit=1.0))


def test_motion_and_dropout_refuse_several_steps() -> None:
    with pytest.raises(ValidationError, match=r"horizon\n  Input should be 1"):
        MotionEnsembleParams.model_validate({"horizon": 4})
    with pytest.raises(ValidationError, match="with a horizon of 4 steps dropout should be 0, but it is"):
        EnsembleParams(horizon=4, dropout=0.1)
