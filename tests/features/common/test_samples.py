import pytest
import torch
from learning import car_samples

from addressed_dynamics.base.errors import TransitionsError
from addressed_dynamics.features.common.samples import Samples


def samples(rows: int = 4) -> Samples:
    return Samples(torch.zeros(rows, 5), torch.zeros(rows, 2), torch.zeros(rows).long(), torch.arange(rows))


def test_their_length_is_the_number_of_rows() -> None:
    assert len(samples(4)) == 4


@pytest.mark.parametrize(
    "wrong",
    [{"x": torch.zeros(3, 5)}, {"y": torch.zeros(4)}, {"episode": torch.zeros(5).long()}, {"step": torch.arange(1)}],
)
def test_lengths_and_shapes_that_do_not_fit_are_refused(wrong: dict[str, torch.Tensor]) -> None:
    with pytest.raises(TransitionsError, match="equal lengths"):
        Samples(**(vars(samples()) | wrong))


@pytest.mark.parametrize("name", ["x", "y"])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_value_that_is_not_finite_is_refused(name: str, value: float) -> None:
    broken = getattr(samples(), name).clone()
    broken[2, 1] = value
    with pytest.raises(TransitionsError, match="not finite"):
        Samples(**(vars(samples()) | {name: broken}))


def test_the_fingerprint_tells_other_values_and_shapes_apart_and_nothing_else() -> None:
    _, first, _ = car_samples()
    _, again, other = car_samples()
    assert first.fingerprint() == again.fingerprint()
    changed = first.y.clone()
    changed[0, 0] += 1e-6
    reshaped = Samples(torch.zeros(4, 2), torch.zeros(4, 5), torch.zeros(4).long(), torch.arange(4))
    prints = {
        first.fingerprint(),
        other.fingerprint(),
        Samples(first.x, changed, first.episode, first.step).fingerprint(),
        samples().fingerprint(),
        reshaped.fingerprint(),
    }
    assert len(prints) == 5
