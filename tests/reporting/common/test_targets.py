"""How many targets were reached is said in words, and each has a row."""

import pytest

from addressed_dynamics.reporting.common.targets import Target, reached, reached_words, target_table


def targets(*met: bool | None) -> list[Target]:
    return [Target(f"figure {index}", "at most 1", "2", each) for index, each in enumerate(met)]


@pytest.mark.parametrize(
    ("met", "words"),
    [
        ((True, True), "all two targets"),
        ((True, False, False), "one of the three targets"),
        ((False, False), "none of the two targets"),
        ((True, False, None), "one of the three targets; one could not be measured"),
    ],
)
def test_what_was_reached_is_said_in_words(met: tuple[bool | None, ...], words: str) -> None:
    assert reached_words(targets(*met)) == words
    assert reached(targets(*met)) == met.count(True)


def test_every_target_has_a_row_that_stands_out_by_its_outcome() -> None:
    table = target_table(targets(True, False, None), "What to reach.")
    assert [row.kind for row in table.rows] == ["reached", "missed", "open"]
    assert table.rows[1].cells == ("figure 1", "at most 1", "2", "missed")
