import pytest

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.memory import MEMORY, free_memory, memory_for_samples


@pytest.mark.parametrize(
    ("asked", "expected"),
    [("0", 0), ("8GiB", 2**33), ("1.5 GB", 1_500_000_000), (" 200mib", 200 * 2**20), (f"{10**400}", 10**400)],
)
def test_the_environment_says_how_much_memory_samples_may_take(
    monkeypatch: pytest.MonkeyPatch, asked: str, expected: int
) -> None:
    monkeypatch.setenv(MEMORY, asked)
    assert memory_for_samples() == expected


@pytest.mark.parametrize("asked", ["", "-1", "much", "8 elephants", "8GiB or so", "inf"])
def test_what_is_no_size_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch, asked: str) -> None:
    monkeypatch.setenv(MEMORY, asked)
    with pytest.raises(ParamsError, match=r"ADDRESSED_DYNAMICS_MEMORY should be a size such as 8GiB") as caught:
        memory_for_samples()
    assert "\n" not in str(caught.value)


def test_without_a_word_they_may_take_half_of_what_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(MEMORY, raising=False)
    assert 0.3 * free_memory() < memory_for_samples() < 0.7 * free_memory()
