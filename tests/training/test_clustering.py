import math
import random
from fractions import Fraction

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.common.spool import Spool, beside
from addressed_dynamics.training import clustering
from addressed_dynamics.training.clustering import Make, assign_to_bins, draw_bins, small_bins


def assign_one_by_one(losses: torch.Tensor, most: int | None = None) -> list[int]:
    """Transcribe Algorithm 1 as the paper prints it, or with bins of at most so many samples: the oracle."""
    samples, members = losses.shape
    room = [samples // members + (member < samples % members) for member in range(members)]
    room = room if most is None else [most] * members
    norms, profiles = torch.linalg.vector_norm(losses, dim=1).tolist(), losses.tolist()
    assigned = [-1] * samples
    for sample in sorted(range(samples), key=lambda s: -norms[s]):
        for member in sorted(range(members), key=profiles[sample].__getitem__):
            if room[member]:
                room[member] -= 1
                assigned[sample] = member
                break
    return assigned


def profiles(levels: int | None = None) -> st.SearchStrategy[torch.Tensor]:
    """Loss profiles; with few `levels` there are many ties in losses and norms."""

    def draw(shape_seed: tuple[int, int, int]) -> torch.Tensor:
        samples, members, seed = shape_seed
        generator = torch.Generator().manual_seed(seed)
        if levels is None:
            return torch.rand(samples, members, generator=generator) ** 4
        return torch.randint(0, levels, (samples, members), generator=generator).float()

    return st.tuples(st.integers(0, 40), st.integers(1, 7), st.integers(0, 2**31)).map(draw)


@given(profiles())
def test_it_equals_the_naive_loop(losses: torch.Tensor) -> None:
    assert assign_to_bins(losses).tolist() == assign_one_by_one(losses)


@given(profiles(levels=3))
def test_it_equals_the_naive_loop_when_losses_and_norms_tie(losses: torch.Tensor) -> None:
    assert assign_to_bins(losses).tolist() == assign_one_by_one(losses)


@pytest.fixture(scope="module")
def make_in_files(tmp_path_factory: pytest.TempPathFactory) -> Make:
    one = torch.ones(1, 1)
    columns, _ = Spool(tmp_path_factory.mktemp("files"), 0).columns("one", 1, lambda sink: sink.add(x=one))
    return beside(Samples(columns["x"], one, torch.zeros(1, dtype=torch.int64), torch.zeros(1, dtype=torch.int64)))


@settings(max_examples=50)
@given(st.one_of(profiles(), profiles(levels=3)), st.sampled_from([0.0, 0.1]), st.integers(1, 9))
def test_in_blocks_and_out_of_core_bins_are_the_same(
    make_in_files: Make, losses: torch.Tensor, slack: float, rows: int
) -> None:
    # Every digit of a norm is looked at by itself, and every block is a few samples.
    small = {"ROWS_ON_CPU": rows, "FIRST_DIGIT": 3, "NEXT_DIGIT": 2}
    expected = assign_to_bins(losses, slack)
    with pytest.MonkeyPatch.context() as patch:
        for name, value in small.items():
            patch.setattr(clustering, name, value)
        found = small_bins(make_in_files(losses.shape).copy_(losses), slack, make=make_in_files)
    assert found.dtype == torch.uint8
    assert torch.equal(found.long(), expected)


@given(profiles())
def test_it_equals_the_naive_loop_when_all_prefer_the_members_in_one_order(losses: torch.Tensor) -> None:
    losses = losses + torch.arange(losses.shape[1])
    assert assign_to_bins(losses).tolist() == assign_one_by_one(losses)


@given(profiles())
def test_bins_differ_by_at_most_one_and_no_sample_is_dropped(losses: torch.Tensor) -> None:
    counts = torch.bincount(assign_to_bins(losses), minlength=losses.shape[1])
    assert counts.sum() == len(losses)
    assert counts.max() - counts.min() <= 1


PERCENT = st.integers(1, 700)


@given(profiles(levels=3), PERCENT)
def test_with_slack_it_equals_the_naive_loop_with_larger_bins(losses: torch.Tensor, percent: int) -> None:
    samples, members = losses.shape
    most = math.ceil(Fraction(100 + percent, 100) * samples / members)
    assigned = assign_to_bins(losses, percent / 100)
    assert assigned.tolist() == assign_one_by_one(losses, most)
    assert (torch.bincount(assigned, minlength=members) <= most).all()


@given(profiles(levels=3))
def test_with_room_for_all_in_every_bin_each_sample_goes_to_its_best_member(losses: torch.Tensor) -> None:
    assert torch.equal(assign_to_bins(losses, losses.shape[1] - 1.0), losses.argmin(dim=1))


def test_a_bin_takes_a_tenth_more_and_not_one_sample_beyond() -> None:
    losses = torch.tensor([[0.0, 1.0]]).expand(20, 2)
    assert torch.bincount(assign_to_bins(losses)).tolist() == [10, 10]
    assert torch.bincount(assign_to_bins(losses, 0.1)).tolist() == [11, 9]


@given(profiles(), st.integers(0, 1000))
def test_relabelling_members_changes_nothing_but_the_labels(losses: torch.Tensor, seed: int) -> None:
    samples, members = losses.shape
    losses = losses[: samples - samples % members]  # equal capacities, or the odd samples follow the labels
    order = random.Random(seed).sample(range(members), members)
    relabelled = assign_to_bins(losses[:, order])
    assert torch.equal(torch.tensor(order)[relabelled], assign_to_bins(losses))


def test_losses_of_any_memory_layout_and_precision_give_the_same_bins() -> None:
    losses = torch.rand(50, 3, generator=torch.Generator().manual_seed(0))
    expected = assign_to_bins(losses)
    assert torch.equal(assign_to_bins(losses.T.contiguous().T), expected)
    assert torch.equal(assign_to_bins(losses.double()), expected)
    assert expected.dtype == torch.int64


def test_losses_stay_as_they_are() -> None:
    losses = torch.rand(20, 2, generator=torch.Generator().manual_seed(0))
    before = losses.clone()
    assign_to_bins(losses)
    assert torch.equal(losses, before)


def test_the_hardest_samples_choose_first() -> None:
    losses = torch.tensor([[0.1, 0.2], [5.0, 9.0], [0.3, 0.4], [6.0, 8.0]])
    assert assign_to_bins(losses).tolist() == [1, 0, 1, 0]


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_loss_that_is_not_finite_is_refused(value: float) -> None:
    with pytest.raises(TrainingError, match="not finite"):
        assign_to_bins(torch.tensor([[0.0, value]]))


@pytest.mark.parametrize("shape", [(3,), (3, 0)])
def test_losses_that_are_not_a_matrix_with_members_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(TrainingError, match="shape"):
        assign_to_bins(torch.zeros(shape))


def drawn(losses: torch.Tensor, temperature: float, seed: int = 0) -> torch.Tensor:
    return draw_bins(losses, temperature, torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("temperature", [0.1, 1.0, 10.0])
def test_bins_that_are_drawn_are_about_equally_large_though_all_prefer_one_member(temperature: float) -> None:
    losses = torch.rand(4000, 4, generator=torch.Generator().manual_seed(1)) + torch.tensor([0.0, 0.5, 1.0, 2.0])
    counts = torch.bincount(drawn(losses, temperature), minlength=4)
    assert (counts - 1000).abs().max() < 120  # four deviations of a binomial


def test_a_low_temperature_leaves_each_sample_its_best_member_if_all_members_have_as_many() -> None:
    best = torch.arange(300) % 3
    losses = 1.0 - 0.5 * torch.nn.functional.one_hot(best, 3)
    assert torch.equal(drawn(losses, 0.01), best)


def test_a_high_temperature_does_not_look_at_the_losses() -> None:
    best = torch.arange(3000) % 3
    losses = 1.0 - 0.5 * torch.nn.functional.one_hot(best, 3)
    assert float((drawn(losses, 1e6) == best).double().mean()) == pytest.approx(1 / 3, abs=0.04)


@given(profiles(levels=3), st.integers(0, 1000))
def test_drawn_bins_are_those_of_their_generator_and_losses_of_0_are_no_obstacle(
    losses: torch.Tensor, seed: int
) -> None:
    losses = torch.cat([losses, torch.zeros(1, losses.shape[1])])
    bins = drawn(losses, 0.5, seed)
    assert torch.equal(bins, drawn(losses, 0.5, seed))
    assert ((bins >= 0) & (bins < losses.shape[1])).all()


def test_losses_that_cannot_be_drawn_by_are_refused() -> None:
    with pytest.raises(TrainingError, match="not finite"):
        drawn(torch.tensor([[0.0, float("nan")]]), 1.0)
