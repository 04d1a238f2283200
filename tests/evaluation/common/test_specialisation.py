from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.evaluation.common.records import Specialisation
from addressed_dynamics.evaluation.common.specialisation import specialisation


def example(members: int, samples: int, seed: int) -> tuple[Tensor, Tensor]:
    """Losses over nine powers of ten, a tenth of them 0, and probabilities that often follow the lowest loss."""
    generator = torch.Generator().manual_seed(seed)
    losses = 10.0 ** (torch.rand(members, samples, generator=generator) * 9 - 10)
    losses[torch.rand(members, samples, generator=generator) < 0.1] = 0.0
    scores = torch.randn(samples, members, generator=generator) - losses.clamp(min=1e-9).log10().T
    return losses, torch.softmax(scores, dim=1)


def by_loops(losses: Tensor, probabilities: Tensor, edges: list[float]) -> dict[str, Any]:
    """The same, sample by sample; `edges` are those of the losses."""
    members, samples = losses.shape
    lowest, addressed = [0] * members, [0] * members
    loss_counts = [[0] * (len(edges) - 1) for _ in range(members)]
    output_counts = [[0] * 20 for _ in range(members)]
    own: list[list[float]] = [[] for _ in range(members)]
    agreeing = 0
    for sample in range(samples):
        profile, outputs = losses[:, sample].tolist(), probabilities[sample].tolist()
        best, chosen = profile.index(min(profile)), outputs.index(max(outputs))
        lowest[best] += 1
        addressed[chosen] += 1
        agreeing += best == chosen
        own[chosen].append(profile[chosen])
        interval = sum(profile[chosen] >= edge for edge in edges[1:-1])
        loss_counts[chosen][interval] += 1
        for member in range(members):
            output_counts[member][sum(outputs[member] >= k / 20 for k in range(1, 20))] += 1
    return {
        "samples": samples,
        "agreement": agreeing / samples,
        "lowest_loss": lowest,
        "addressed": addressed,
        "mean_loss": {
            "all": [sum(row) / samples for row in losses.tolist()],
            "own": [sum(values) / len(values) if values else None for values in own],
        },
        "loss_counts": loss_counts,
        "output_counts": output_counts,
    }


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 8), st.integers(1, 60), st.integers(0, 10_000))
def test_it_is_what_loops_over_the_samples_find(members: int, samples: int, seed: int) -> None:
    losses, probabilities = example(members, samples, seed)
    found = specialisation(losses.double(), probabilities)
    expected = by_loops(losses.double(), probabilities, found["loss_edges"])
    for key in ("samples", "lowest_loss", "addressed", "loss_counts", "output_counts"):
        assert found[key] == expected[key], key
    assert found["agreement"] == pytest.approx(expected["agreement"])
    assert found["mean_loss"]["all"] == pytest.approx(expected["mean_loss"]["all"])
    for here, there in zip(found["mean_loss"]["own"], expected["mean_loss"]["own"], strict=True):
        assert here is None if there is None else here == pytest.approx(there)


@given(st.integers(1, 8), st.integers(1, 60), st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_every_sample_is_counted_once_for_each_figure(members: int, samples: int, seed: int) -> None:
    found = Specialisation.model_validate(specialisation(*example(members, samples, seed)))
    assert sum(found.lowest_loss) == sum(found.addressed) == samples
    assert [sum(row) for row in found.loss_counts] == list(found.addressed)
    assert {sum(row) for row in found.output_counts} == {samples}
    edges = np.array(found.loss_edges)
    assert len(edges) == 11
    np.testing.assert_allclose(np.diff(np.log(edges)), np.log(edges[-1] / edges[0]) / 10, rtol=1e-6)


def test_two_networks_of_which_each_serves_its_own() -> None:
    losses = torch.tensor([[1e-6, 1e-6, 1e-2], [1e-2, 1e-2, 1e-5]], dtype=torch.float64)
    found = specialisation(losses, torch.tensor([[0.9, 0.1], [0.2, 0.8], [0.02, 0.98]]))
    assert (found["lowest_loss"], found["addressed"]) == ([2, 1], [1, 2])
    assert found["agreement"] == pytest.approx(2 / 3)
    assert found["mean_loss"]["own"] == pytest.approx([1e-6, (1e-2 + 1e-5) / 2])


def test_a_network_that_is_never_selected_has_no_loss_of_its_own() -> None:
    losses = torch.tensor([[1e-6, 1e-6], [1e-3, 1e-3]])
    found = specialisation(losses, torch.tensor([[0.9, 0.1], [0.8, 0.2]]))
    assert found["addressed"] == [2, 0]
    assert found["mean_loss"]["own"][1] is None
    assert found["mean_loss"]["all"][1] == pytest.approx(1e-3)
    assert sum(found["loss_counts"][1]) == 0
    assert sum(found["output_counts"][1]) == 2


@pytest.mark.parametrize("loss", [0.0, 1e-6])
def test_losses_that_are_all_alike_fall_into_the_first_interval(loss: float) -> None:
    found = specialisation(torch.full((1, 5), loss, dtype=torch.float64), torch.ones(5, 1))
    assert found["loss_counts"] == [[5] + [0] * 9]
    assert found["output_counts"] == [[0] * 19 + [5]]
    assert found["agreement"] == 1.0


def test_a_softmax_that_is_rounded_above_one_is_counted_as_one() -> None:
    found = specialisation(torch.tensor([[1e-6], [1e-3]]), torch.tensor([[1.0000001, 0.0]]))
    assert found["output_counts"][0][-1] == found["output_counts"][1][0] == 1


@pytest.mark.parametrize(
    ("losses", "probabilities", "expected"),
    [
        (torch.ones(2, 0), torch.ones(0, 2), "at least one sample"),
        (torch.ones(2, 3), torch.ones(2, 3), r"shapes \(2, 3\) and \(2, 3\)"),
        (torch.tensor([[float("nan")]]), torch.ones(1, 1), "diverged"),
        (torch.ones(1, 1), torch.tensor([[float("inf")]]), "diverged"),
    ],
)
def test_what_cannot_be_counted_is_refused(losses: Tensor, probabilities: Tensor, expected: str) -> None:
    with pytest.raises(EvaluationError, match=expected):
        specialisation(losses, probabilities)
