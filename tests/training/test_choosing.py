import pytest
from hypothesis import given
from hypothesis import strategies as st
from learning import ENSEMBLE

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.params.training import EnsembleSection
from addressed_dynamics.training.choosing import ABOUT_AS_GOOD, best_number, brief


def test_a_smaller_number_is_chosen_if_it_is_about_as_good() -> None:
    assert best_number({1: 1.019, 2: 1.0, 4: 1.5}) == 1
    assert best_number({1: 1.021, 2: 1.01, 4: 1.0}) == 2
    assert best_number({1: 3.0, 2: 2.0, 4: 1.5, 8: 1.0}) == 8


def test_a_training_that_went_off_is_not_chosen() -> None:
    assert best_number({1: float("nan"), 2: 1.0, 4: float("inf")}) == 2
    with pytest.raises(TrainingError, match="1, 2 subnetworks has a finite loss"):
        best_number({1: float("nan"), 2: float("inf")})


@given(st.dictionaries(st.integers(1, 16), st.floats(1e-9, 1e3), min_size=1))
def test_what_is_chosen_is_about_as_good_as_the_best_and_nothing_smaller_is(losses: dict[int, float]) -> None:
    chosen, lowest = best_number(losses), min(losses.values())
    assert losses[chosen] <= ABOUT_AS_GOOD * lowest
    assert all(loss > ABOUT_AS_GOOD * lowest for number, loss in losses.items() if number < chosen)


@pytest.mark.parametrize(
    ("epochs", "cluster_epochs", "restart", "expected"),
    [
        (40, 5, False, (10, 5)),
        (24, 24, False, (6, 3)),
        (1, 1, False, (1, 1)),
        (2, 1, True, (2, 1)),
        (17, 4, True, (5, 2)),
    ],
)
def test_a_brief_training_is_as_the_whole_one_in_fewer_epochs(
    epochs: int, cluster_epochs: int, restart: bool, expected: tuple[int, int]
) -> None:
    section = EnsembleSection(members="auto", epochs=epochs, cluster_epochs=cluster_epochs, restart=restart)
    params = brief(section, 4)
    assert (params.members, params.epochs, params.cluster_epochs) == (4, *expected)
    whole = section.with_members(4).model_dump() | {"epochs": params.epochs, "cluster_epochs": params.cluster_epochs}
    assert params.model_dump() == whole


def test_a_number_of_members_changes_nothing_else() -> None:
    assert ENSEMBLE.with_members(5).model_dump() == ENSEMBLE.model_dump() | {"members": 5}
    assert list(ENSEMBLE.with_members(5).model_dump()) == list(ENSEMBLE.model_dump())
