import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.training.epochs import Batch, Length, batches, overlapping, updates_per_epoch


def passed(bins: torch.Tensor, members: int, batch_size: int, seed: int = 0) -> list[Batch]:
    return list(batches(bins, members, batch_size, torch.Generator().manual_seed(seed)))


@st.composite
def equal_bins(draw: st.DrawFn) -> tuple[torch.Tensor, int]:
    """Bins as Algorithm 1 makes them: their sizes differ by at most one, the larger ones first."""
    members = draw(st.integers(1, 6))
    samples = draw(st.integers(members, 60))
    sizes = torch.tensor([samples // members + (member < samples % members) for member in range(members)])
    bins = torch.arange(members).repeat_interleave(sizes)
    return bins[torch.randperm(samples, generator=torch.Generator().manual_seed(draw(st.integers(0, 1000))))], members


any_bins = st.integers(1, 6).flatmap(
    lambda members: st.tuples(
        st.lists(st.integers(0, members - 1), min_size=members, max_size=60).map(torch.tensor), st.just(members)
    )
)


@given(equal_bins(), st.integers(1, 20))
def test_equal_bins_give_each_sample_once_to_its_own_member(case: tuple[torch.Tensor, int], batch_size: int) -> None:
    bins, members = case
    seen = []
    for batch in passed(bins, members, batch_size):
        for member in range(members):
            rows = batch.rows[member][batch.weight[member] > 0]
            assert bins[rows].tolist() == [member] * len(rows)
            seen += rows.tolist()
    assert sorted(seen) == list(range(len(bins)))


@given(any_bins, st.integers(1, 20))
def test_weights_of_a_member_are_equal_and_add_to_1_in_every_batch_in_which_it_has_samples(
    case: tuple[torch.Tensor, int], batch_size: int
) -> None:
    bins, members = case
    sizes = torch.bincount(bins, minlength=members)
    for batch in passed(bins, members, batch_size):
        assert batch.rows.shape == batch.weight.shape
        for member in range(members):
            given_weight = batch.weight[member][batch.weight[member] > 0]
            if len(given_weight):
                torch.testing.assert_close(given_weight, torch.full_like(given_weight, 1 / len(given_weight)))
            else:
                assert sizes[member] == 0 or batch.rows.shape[1] == 1  # only the row that fills up a short bin


@given(any_bins, st.integers(1, 20))
def test_every_binning_costs_the_same_number_of_batches(case: tuple[torch.Tensor, int], batch_size: int) -> None:
    bins, members = case
    made = passed(bins, members, batch_size)
    assert len(made) == updates_per_epoch(len(bins), members, batch_size)
    assert sum(batch.rows.shape[1] for batch in made) == math.ceil(len(bins) / members)
    assert all(batch.rows.shape[1] == batch_size for batch in made[:-1])


@given(any_bins, st.integers(1, 20))
def test_a_member_never_gets_a_sample_of_another(case: tuple[torch.Tensor, int], batch_size: int) -> None:
    bins, members = case
    for batch in passed(bins, members, batch_size):
        owner = bins[batch.rows]
        member = torch.arange(members).unsqueeze(1).expand_as(owner)
        assert torch.equal(owner[batch.weight > 0], member[batch.weight > 0])


def test_a_large_bin_gives_a_part_of_itself_and_a_small_one_repeats_itself_evenly() -> None:
    bins = torch.tensor([0] * 9 + [1] * 3)
    (batch,) = passed(bins, 2, 100)
    assert len(set(batch.rows[0].tolist())) == 6
    assert torch.bincount(batch.rows[1] - 9).tolist() == [2, 2, 2]


def test_an_empty_bin_has_no_weight() -> None:
    (batch,) = passed(torch.zeros(8, dtype=torch.int64), 2, 100)
    assert batch.weight[1].tolist() == [0.0] * 4
    assert float(batch.weight[0].sum()) == pytest.approx(1.0)


def test_the_order_is_random_and_follows_the_generator_alone() -> None:
    bins = torch.arange(40) % 2
    first, again, other = (torch.cat([batch.rows for batch in passed(bins, 2, 8, seed)], 1) for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert first[0].tolist() != sorted(first[0].tolist())


@given(equal_bins(), st.integers(1, 20), st.integers(1, 4), st.integers(1, 1000))
def test_a_length_counts_the_updates_and_the_samples_of_the_batches_that_are_made(
    case: tuple[torch.Tensor, int], batch_size: int, epochs: int, updates: int
) -> None:
    bins, members = case
    updates = min(updates, epochs * updates_per_epoch(len(bins), members, batch_size))
    length = Length.of(len(bins), members, batch_size, epochs=epochs, updates=updates)
    made, seen = 0, 0
    for epoch in range(1, length.epochs + 1):
        for batch in passed(bins, members, batch_size, epoch)[: length.updates_in(epoch)]:
            made += 1
            seen += batch.rows.numel()
        assert length.updates_after(epoch) == made
        # A bin that is one short repeats a row at weight 0, which no network learns from and `samples_after` omits.
        assert 0 <= seen - length.samples_after(epoch) <= epoch * (members - 1)
    assert made == updates
    assert length.updates_in(length.epochs) > 0


def test_more_updates_than_the_epochs_have_or_none_at_all_are_refused() -> None:
    for updates in (0, 31):
        with pytest.raises(TrainingError, match=f"after 1 to 30 updates, but not after {updates}: give it more epochs"):
            Length.of(100, 2, 10, epochs=6, updates=updates)
    assert Length.of(100, 2, 10, epochs=6) == Length.of(100, 2, 10, epochs=6, updates=30)


@given(equal_bins(), st.integers(1, 20), st.floats(0.0, 1.0))
def test_a_share_of_overlapping_batches_is_near_to_a_member_and_the_rest_is_as_before(
    case: tuple[torch.Tensor, int], batch_size: int, share: float
) -> None:
    bins, members = case
    near = (bins + 1) % members
    plain = passed(bins, members, batch_size)
    generator = torch.Generator().manual_seed(1)
    for before, batch in zip(plain, overlapping(plain, near, members, share, generator), strict=True):
        drawn = round(share * before.rows.shape[1])
        assert torch.equal(batch.rows[:, drawn:], before.rows[:, drawn:])
        assert torch.equal(batch.weight, before.weight)
        for member in range(members):
            assert (near[batch.rows[member, :drawn]] == member).all()


def test_a_member_that_is_near_to_nothing_keeps_its_batches() -> None:
    bins = torch.tensor([0, 1, 0, 1, 0, 1])
    plain = passed(bins, 2, 2)
    overlapped = overlapping(plain, torch.zeros(6, dtype=torch.int64), 2, 1.0, torch.Generator().manual_seed(0))
    for before, batch in zip(plain, overlapped, strict=True):
        assert torch.equal(batch.rows[1], before.rows[1])
