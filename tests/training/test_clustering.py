import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.errors import TrainingError
from addressed_dynamics.training.clustering import assign_to_bins


def assign_one_by_one(losses: torch.Tensor) -> torch.Tensor:
    """Transcribe Algorithm 1 as the paper prints it: the oracle."""
    samples, members = losses.shape
    room = [samples // members + (member < samples % members) for member in range(members)]
    norms = torch.linalg.vector_norm(losses, dim=1)
    assigned = torch.full((samples,), -1)
    for sample in torch.argsort(norms, descending=True, stable=True).tolist():
        for member in sorted(range(members), key=lambda m: (float(losses[sample, m]), m)):  # noqa: B023 - used at once
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

    return st.tuples(st.integers(0, 60), st.integers(1, 9), st.integers(0, 2**31)).map(draw)


@given(profiles())
def test_it_equals_the_naive_loop(losses: torch.Tensor) -> None:
    assert torch.equal(assign_to_bins(losses), assign_one_by_one(losses))


@given(profiles(levels=3))
def test_it_equals_the_naive_loop_when_losses_and_norms_tie(losses: torch.Tensor) -> None:
    assert torch.equal(assign_to_bins(losses), assign_one_by_one(losses))


@given(profiles())
def test_bins_differ_by_at_most_one_and_no_sample_is_dropped(losses: torch.Tensor) -> None:
    counts = torch.bincount(assign_to_bins(losses), minlength=losses.shape[1])
    assert counts.sum() == len(losses)
    assert counts.max() - counts.min() <= 1


@given(profiles(), st.randoms(use_true_random=False))
def test_relabelling_members_changes_nothing_but_the_labels(losses: torch.Tensor, random: object) -> None:
    samples, members = losses.shape
    losses = losses[: samples - samples % members]  # equal capacities, or the odd samples follow the labels
    order = list(range(members))
    random.shuffle(order)  # type: ignore[attr-defined]
    relabelled = assign_to_bins(losses[:, order])
    assert torch.equal(torch.tensor(order)[relabelled], assign_to_bins(losses))


def test_the_hardest_samples_choose_first() -> None:
    losses = torch.tensor([[0.1, 0.2], [5.0, 9.0], [0.3, 0.4], [6.0, 8.0]])
    assert assign_to_bins(losses).tolist() == [1, 0, 1, 0]


def test_a_loss_that_is_not_finite_is_refused() -> None:
    with pytest.raises(TrainingError, match="not finite"):
        assign_to_bins(torch.tensor([[0.0, float("nan")]]))


def test_losses_that_are_not_a_matrix_are_refused() -> None:
    with pytest.raises(TrainingError, match="shape"):
        assign_to_bins(torch.zeros(3))
