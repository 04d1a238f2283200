import math
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import ADDRESSING, car_samples

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.params.training import AddressingTraining
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.networks.addressing import addressed_members
from addressed_dynamics.training.addressing import (
    Variant,
    addressing_metrics,
    choose,
    confusion_matrix,
    misclassification_weights,
    resample,
    train_addressing,
    untrained_addressing,
)
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.epochs import Epoch

_, TRAIN, VALIDATION = car_samples()
VARIANTS: list[Variant] = ["plain", "cost_sensitive"]
HEADED = ADDRESSING.model_copy(update={"hidden": (16,), "heads": (8,), "activation": "tanh"})
FORMS = pytest.mark.parametrize("form", [ADDRESSING, HEADED], ids=["plain", "heads"])


def profiles(samples: Samples) -> torch.Tensor:
    """Losses of three imagined members, each best in its part of the state space."""
    centres = torch.tensor([-1.0, 0.0, 1.0])
    return 1e-6 * (samples.x[:, :1] - centres).square()


def train(params: AddressingTraining = ADDRESSING, *, seed: int = 3, **options: Any) -> Iterator[Epoch]:
    options = {"variant": "plain"} | options
    return train_addressing(TRAIN, profiles(TRAIN), VALIDATION, profiles(VALIDATION), params, seed=seed, **options)


def weights(epoch: Epoch) -> bytes:
    return b"".join(parameter.detach().numpy().tobytes() for parameter in epoch.network.parameters())


@FORMS
@pytest.mark.parametrize("variant", VARIANTS)
def test_it_learns_which_member_is_best(variant: Variant, form: AddressingTraining) -> None:
    first, *_, last = train(form.model_copy(update={"epochs": 20}), variant=variant)
    assert last.metrics["agreement"] > 0.9
    assert last.metrics["regret/mean"] < 0.3 * first.metrics["regret/mean"]
    assert last.metrics["loss/train"] < first.metrics["loss/train"]


def test_heads_share_a_trunk_and_are_as_many_as_the_members() -> None:
    network = untrained_addressing(5, 3, HEADED, seed=0)
    assert (network.members, network.widths, network.shared) == (3, (5, 16, 8, 1), 1)
    bare = untrained_addressing(5, 3, HEADED.model_copy(update={"hidden": ()}), seed=0)
    assert (bare.members, bare.widths, bare.shared) == (3, (5, 8, 1), 0)
    plain = untrained_addressing(5, 3, ADDRESSING, seed=0)
    assert (plain.members, plain.widths, plain.shared) == (1, (5, 16, 3), 0)


def test_heads_without_a_trunk_learn_too() -> None:
    first, *_, last = train(HEADED.model_copy(update={"hidden": ()}))
    assert last.metrics["loss/train"] < first.metrics["loss/train"]


@FORMS
def test_losses_in_training_and_in_validation_are_of_one_unit(form: AddressingTraining) -> None:
    optimiser = form.optimiser.model_copy(update={"learning_rate": 1e-30})
    still = form.model_copy(update={"optimiser": optimiser, "batch_size": len(TRAIN)})
    epoch = next(train_addressing(TRAIN, profiles(TRAIN), TRAIN, profiles(TRAIN), still, seed=3, variant="plain"))
    assert epoch.metrics["loss/validation"] == pytest.approx(epoch.metrics["loss/train"], rel=1e-5)


@FORMS
@pytest.mark.parametrize("variant", VARIANTS)
def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(variant: Variant, form: AddressingTraining) -> None:
    (*_, first), (*_, again), (*_, other) = (train(form, seed=seed, variant=variant) for seed in (3, 3, 4))
    assert weights(first) == weights(again)
    assert first.metrics == again.metrics
    assert weights(first) != weights(other)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(("form", "finished"), [(ADDRESSING, 1), (ADDRESSING, 3), (ADDRESSING, 5), (HEADED, 3)])
def test_a_training_that_is_cut_off_goes_on_bit_for_bit(
    tmp_path: Path, variant: Variant, form: AddressingTraining, finished: int
) -> None:
    straight = list(train(form, variant=variant))
    checkpoint = Checkpoint(tmp_path / "state.safetensors")
    for _ in islice(train(form, variant=variant, checkpoint=checkpoint), finished):
        pass
    resumed = list(train(form, variant=variant, checkpoint=checkpoint))
    assert weights(resumed[-1]) == weights(straight[-1])
    shown = [[(e.index, e.last, e.updates, e.metrics) for e in epochs] for epochs in (resumed, straight)]
    assert shown[0] == shown[1]


@given(st.integers(1, 30), st.integers(2, 5), st.integers(0, 1000), st.floats(0.0, 1.0))
def test_weights_have_mean_1_and_rise_with_the_square_root_of_what_a_wrong_choice_costs(
    samples: int, members: int, seed: int, tie_share: float
) -> None:
    losses = torch.rand(samples, members, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) ** 6
    found = misclassification_weights(losses, tie_share)
    costs = [(max(row) - min(row)) ** 0.5 for row in losses.tolist()]
    mean = sum(costs) / samples
    expected = [tie_share + (1.0 - tie_share) * cost / mean for cost in costs]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64))
    assert float(found.mean()) == pytest.approx(1.0)


def test_samples_of_which_none_costs_anything_all_weigh_the_same() -> None:
    found = misclassification_weights(torch.ones(4, 3), 0.5)
    assert found.tolist() == [0.5] * 4


@given(st.lists(st.floats(0.01, 100.0), min_size=1, max_size=60), st.integers(0, 1000))
def test_a_sample_is_drawn_as_often_as_its_weight_says_rounded_up_or_down(weights: list[float], seed: int) -> None:
    weight = torch.tensor(weights, dtype=torch.float64)
    weight = weight / weight.mean()
    drawn = resample(weight, torch.Generator().manual_seed(seed))
    counts = torch.bincount(drawn, minlength=len(weights))
    assert counts.sum() == len(weights)
    assert (counts - weight).abs().max() < 1.0 + 1e-9


def test_equal_weights_draw_every_sample_once() -> None:
    assert resample(torch.ones(100), torch.Generator().manual_seed(0)).tolist() == list(range(100))


def test_over_many_draws_a_sample_comes_as_often_as_its_weight_says() -> None:
    weight, generator = torch.tensor([0.25, 2.5, 0.75, 0.5]), torch.Generator().manual_seed(0)
    counts = torch.bincount(torch.cat([resample(weight, generator) for _ in range(2000)]), minlength=4)
    torch.testing.assert_close(counts / 2000, weight, rtol=0.0, atol=0.05)


def test_both_variants_make_the_same_number_of_updates() -> None:
    (*_, plain), (*_, sensitive) = (train(variant=variant) for variant in VARIANTS)
    assert plain.updates == sensitive.updates
    assert weights(plain) != weights(sensitive)


@FORMS
@settings(max_examples=30)
@given(rows=st.integers(1, 40), members=st.integers(1, 4), seed=st.integers(0, 1000))
def test_metrics_and_confusion_equal_a_loop_over_the_samples(
    rows: int, members: int, seed: int, form: AddressingTraining
) -> None:
    generator = torch.Generator().manual_seed(seed)
    network = untrained_addressing(5, members, form, seed=seed).requires_grad_(False)
    x = torch.randn(rows, 5, generator=generator)
    samples = Samples(x, torch.zeros(rows, 2), torch.zeros(rows).long(), torch.arange(rows))
    losses = torch.rand(rows, members, generator=generator)
    outputs = network(x).squeeze(-1).T if form.heads else network(x)[0]
    chosen = [max(range(members), key=scores.__getitem__) for scores in outputs.view(rows, members).tolist()]
    best = [row.index(min(row)) for row in losses.tolist()]
    selected = [row[member] for row, member in zip(losses.tolist(), chosen, strict=True)]
    regret = [loss - min(row) for loss, row in zip(selected, losses.tolist(), strict=True)]
    assert choose(network, samples).tolist() == chosen
    scores = outputs.view(rows, members).double().tolist()
    surprise = [
        math.log(sum(math.exp(other) for other in row)) - row[member] for row, member in zip(scores, best, strict=True)
    ]
    assert addressing_metrics(network, samples, losses) == pytest.approx(
        {
            "loss/validation": sum(surprise) / rows,
            "agreement": sum(a == b for a, b in zip(chosen, best, strict=True)) / rows,
            "loss/selected": sum(selected) / rows,
            "regret/mean": sum(regret) / rows,
            "regret/max": max(regret),
        },
        abs=1e-9,
    )
    expected = [[sum((b, c) == (i, j) for b, c in zip(best, chosen, strict=True)) for j in range(members)]
                for i in range(members)]  # fmt: skip
    assert confusion_matrix(network, samples, losses) == expected


def test_no_samples_are_refused() -> None:
    none = Samples(TRAIN.x[:0], TRAIN.y[:0], TRAIN.episode[:0], TRAIN.step[:0])
    with pytest.raises(TrainingError, match="no samples to train the addressing network on"):
        next(
            train_addressing(
                none, profiles(none), VALIDATION, profiles(VALIDATION), ADDRESSING, seed=0, variant="plain"
            )
        )


def test_a_loss_that_is_not_finite_ends_training_with_advice() -> None:
    optimiser = ADDRESSING.optimiser.model_copy(update={"learning_rate": 1e30})
    with pytest.raises(TrainingError, match=r"lower addressing\.optimiser\.learning_rate"):
        list(train(ADDRESSING.model_copy(update={"optimiser": optimiser})))


def test_nothing_to_choose_needs_no_hidden_layers() -> None:
    one = untrained_addressing(7, 1, ADDRESSING, seed=0)
    assert (one.widths, addressed_members(one)) == ((7, 1), 1)
    assert len(untrained_addressing(7, 2, ADDRESSING, seed=0).widths) > 2
