import json
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.evaluation.transitions.addressing_table import addressing_table
from addressed_dynamics.evaluation.transitions.one_step import summarise


@st.composite
def cases(draw: st.DrawFn) -> tuple[torch.Tensor, torch.Tensor]:
    """Losses (member, sample), sometimes with ties, and choices."""
    members, samples = draw(st.integers(1, 5)), draw(st.integers(1, 40))
    generator = torch.Generator().manual_seed(draw(st.integers(0, 2**31)))
    losses = torch.rand(members, samples, generator=generator, dtype=torch.float64) ** 4
    losses = (losses * 4).round() if draw(st.booleans()) else losses
    return losses, torch.randint(0, members, (samples,), generator=generator)


def naive(losses: list[list[float]], chosen: list[int]) -> dict[str, Any]:
    """Go through the samples one after the other: the oracle."""
    members, samples = len(losses), len(chosen)
    columns = [[losses[member][sample] for member in range(members)] for sample in range(samples)]
    best = [column.index(min(column)) for column in columns]
    confusion = [[0] * members for _ in range(members)]
    for sample in range(samples):
        confusion[best[sample]][chosen[sample]] += 1
    rows = []
    for member in range(members):
        own = [column[member] for column, choice in zip(columns, chosen, strict=True) if choice == member]
        other = [column[member] for column, choice in zip(columns, chosen, strict=True) if choice != member]
        wrong = [columns[s][member] for s in range(samples) if chosen[s] == member and best[s] != member]
        rows.append({
            "share": len(own) / samples,
            "selected": np.mean(own) if own else None,
            "not_selected": np.mean(other) if other else None,
            "per_thousand": 1000 * len(wrong) / samples,
            "median": np.median(wrong) if wrong else 0.0,
            "mean": np.mean(wrong) if wrong else 0.0,
            "max": max(wrong, default=0.0),
        })  # fmt: skip
    regret = [columns[s][chosen[s]] - min(columns[s]) for s in range(samples)]
    agreement = sum(a == b for a, b in zip(best, chosen, strict=True)) / samples
    return {"rows": rows, "confusion": confusion, "agreement": agreement, "regret": regret}


@given(cases())
def test_it_equals_a_loop_over_the_samples(case: tuple[torch.Tensor, torch.Tensor]) -> None:
    losses, chosen = case
    table, expected = addressing_table(losses, chosen), naive(losses.tolist(), chosen.tolist())
    assert table["samples"] == len(chosen)
    assert table["confusion"] == expected["confusion"]
    assert table["agreement"] == pytest.approx(expected["agreement"])
    assert table["misclassified_per_thousand"] == pytest.approx(1000 * (1 - expected["agreement"]))
    assert table["regret"]["mean"] == pytest.approx(np.mean(expected["regret"]))
    assert table["regret"]["max"] == pytest.approx(max(expected["regret"]))
    for member, (found, row) in enumerate(zip(table["members"], expected["rows"], strict=True)):
        flat = {**found, **found["misclassified"]}
        assert found["member"] == member
        for name, value in row.items():
            assert flat[name] == (None if value is None else pytest.approx(value)), name


@given(cases())
def test_choosing_the_best_member_leaves_no_regret(case: tuple[torch.Tensor, torch.Tensor]) -> None:
    losses, _ = case
    table = addressing_table(losses, losses.argmin(dim=0))
    assert table["agreement"] == 1.0
    assert table["regret"]["max"] == 0.0
    assert all(row["misclassified"]["per_thousand"] == 0.0 for row in table["members"])


@given(cases())
def test_it_can_be_written_as_json(case: tuple[torch.Tensor, torch.Tensor]) -> None:
    json.dumps(addressing_table(*case), allow_nan=False)


@given(st.lists(st.floats(0.0, 1e6), min_size=1, max_size=200))
def test_a_summary_equals_that_of_numpy(values: list[float]) -> None:
    found = summarise(torch.tensor(values, dtype=torch.float64))
    assert found == pytest.approx(
        {
            "mean": np.mean(values),
            "median": np.median(values),
            "p99": np.quantile(values, 0.99),
            "max": max(values),
        }
    )


def test_a_summary_of_nothing_is_zero() -> None:
    assert set(summarise(torch.zeros(0)).values()) == {0.0}
