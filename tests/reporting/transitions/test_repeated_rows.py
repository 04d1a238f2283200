"""What the report says of test transitions that stand in training, and of errors that fall."""

from dataclasses import replace
from pathlib import Path

import pytest
from builders import CAR
from report_examples import origin, write_results

from addressed_dynamics.evaluation.transitions.records import Falling, FallingPart, Repeats
from addressed_dynamics.reporting.common.blocks import Text
from addressed_dynamics.reporting.transitions.document import account
from addressed_dynamics.reporting.transitions.quality import repeated_words
from addressed_dynamics.reporting.transitions.results import load_results

FOUND = Repeats(rows=4000, among=9000, exact=12, alike=400, percent=0.5, percent_without=0.75)


def test_repeats_are_told_with_the_errors_without_them() -> None:
    (words,) = repeated_words(FOUND)
    assert words == (
        "Of the 4,000 test transitions, 0.30\u202f% begin in exactly the state, with the action, of one of the 9,000 "
        "for training, and 10.00\u202f% do so up to the rounding of single precision. The delivered model may know "
        "them by heart: its error one step ahead is 0.500 % of the range; without them it is 0.750 %."
    )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"exact": 0, "alike": 0}, "None of the 4,000 test transitions begins as one of the 9,000 for training does."),
        ({"alike": 4000, "percent_without": None}, "all of them do, so that it says nothing of others."),
    ],
)
def test_none_and_all_are_said(changes: dict[str, object], words: str) -> None:
    assert repeated_words(FOUND.model_copy(update=changes))[0].endswith(words)
    assert repeated_words(None) == ()


def test_both_are_in_the_sections_they_belong_to_and_only_where_they_were_found(tmp_path: Path) -> None:
    results = load_results(*write_results(tmp_path))
    part = FallingPart(first_step=1, last_step=3, percent=2.0, held_share=0.1, held_percent=0.1, free_percent=2.0)
    falls = Falling(highest=part, end=part.model_copy(update={"percent": 0.5, "held_share": 0.7}))
    texts = []
    for update in ({}, {"repeats": FOUND, "falling": falls}):
        found = replace(results, evaluation=results.evaluation.model_copy(update=update))
        told = account(found, origin(CAR), None)
        rollouts = next(section for section in told.found if section.title == "Rollouts")
        texts.append([
            " ".join(" ".join(block.paragraphs) for block in blocks if isinstance(block, Text))
            for blocks in (told.data, rollouts.blocks)
        ])  # fmt: skip
    assert "test transitions" not in texts[0][0]
    assert "falls again" not in texts[0][1]
    assert "Of the 4,000 test transitions" in texts[1][0]
    assert "The median error of the delivered model falls again" in texts[1][1]
