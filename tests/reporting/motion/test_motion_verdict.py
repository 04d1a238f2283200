"""What is said of a model of motion follows from the numbers, favourable or not."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from motion_report_examples import OWN, candidate, evaluation

from addressed_dynamics.evaluation.motion.records import MotionEvaluation
from addressed_dynamics.reporting.motion.comparison import compare, outcome, rank_correlation
from addressed_dynamics.reporting.motion.targets import judge_targets
from addressed_dynamics.reporting.motion.verdict import findings, verdict

PFNN, SINGLE = "phase_functioned", "total_parameters"


def sentence(found: MotionEvaluation, *, made_up: bool = False) -> str:
    return verdict(found, judge_targets(found), made_up=made_up)


def said(found: MotionEvaluation, *, made_up: bool = False, target: str = "trajectory_change") -> str:
    return " ".join([sentence(found, made_up=made_up), *findings(found, made_up=made_up, target=target, paper=True)])


def met(found: MotionEvaluation) -> list[bool | None]:
    return [target.met for target in judge_targets(found)]


def test_a_model_that_is_better_in_all_beats_pfnn_and_reaches_all_targets() -> None:
    found = evaluation(candidate(PFNN, raw=0.3, score=0.8, skate=20.0))
    assert sentence(found) == (
        "The addressed ensemble reaches all five targets. "
        "It beats the PFNN trained here in MAE, closed-loop score and foot skate."
    )
    assert met(found) == [True] * 5


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        (
            "same_size/seed-0",
            "Use one network, as large as a member (candidate='recommended'): on validation data (score from 0 to 1, "
            "and normalised MAE) it reaches 0.81 in the closed loop and 0.478 one step ahead, where the delivered "
            "ensemble has 0.79 in the closed loop and 0.557 one step ahead. On synthetic clips the addressed ensemble ",
        ),
        (
            f"{OWN}/seed-0",
            "Use the ensemble, argmax addressing: on validation data (score from 0 to 1, and normalised MAE) it "
            "reaches 0.79 in the closed loop and 0.557 one step ahead. On synthetic clips the addressed ensemble ",
        ),
    ],
)
def test_the_first_sentence_says_which_model_to_use(name: str, expected: str) -> None:
    scores = {
        f"{OWN}/seed-0": {"closed_loop": 0.79, "mae_normalised": 0.557},
        "same_size/seed-0": {"closed_loop": 0.81, "mae_normalised": 0.478},
    }
    label = "ensemble, argmax addressing" if name.startswith(OWN) else "one network, as large as a member"
    found = evaluation(recommendation={"candidate": name, "label": label, "scores": scores})
    assert sentence(found, made_up=True).startswith(expected)


def test_a_model_that_is_worse_in_all_is_said_to_be_worse() -> None:
    found = evaluation(
        candidate(PFNN, raw=0.1, score=0.95, skate=5.0), candidate(SINGLE, raw=0.1, score=0.95, skate=5.0)
    )
    text = sentence(found)
    assert "It is worse than the PFNN trained here in MAE, closed-loop score and foot skate" in text
    assert "it is worse than one network of as many parameters" in text
    assert "beats" not in text
    assert met(found)[:2] == [False, False]


def test_a_model_that_slides_is_not_said_to_beat_what_does_not() -> None:
    text = sentence(evaluation(candidate(PFNN, raw=0.3, score=0.8, skate=1.0)))
    assert "better than the PFNN trained here in MAE and closed-loop score, but worse in foot skate" in text


def test_one_network_that_is_better_in_part_is_not_beaten() -> None:
    text = sentence(evaluation(candidate(SINGLE, raw=0.1)))
    assert "It does not beat one network of as many parameters, which is better in MAE." in text


def test_close_figures_are_no_difference() -> None:
    found = evaluation(candidate(PFNN, raw=0.205, score=0.89, skate=10.5))
    assert "It does not clearly differ from the PFNN trained here." in sentence(found)


def test_one_seed_that_is_worse_makes_a_difference_unclear() -> None:
    found = evaluation(
        candidate(PFNN, raw=0.3, score=0.8, skate=20.0), more_seeds=[candidate(OWN, 1, raw=0.4, score=0.5)]
    )
    assert "is better than the PFNN trained here in foot skate" in sentence(found)
    text = said(found)
    assert "From 2 seeds the raw MAE lies between 0.200 and 0.400" in text
    assert "With one seed of each" not in text


@pytest.mark.parametrize(
    ("own", "place"),
    [({"limbs": 2.0}, 2), ({"limbs": 500.0}, 2), ({"alive": False}, 3), ({"raw": 0.4}, 0), ({"score": 0.5}, 1)],
)
def test_a_figure_beyond_its_bound_is_missed(own: dict[str, Any], place: int) -> None:
    found = evaluation(candidate(PFNN, raw=0.3, score=0.8), own=own)
    assert met(found)[place] is False
    assert "reaches all" not in sentence(found)


def test_without_a_trained_pfnn_nothing_is_held_against_it() -> None:
    found = evaluation(candidate(SINGLE))
    assert met(found) == [None, None, True, True, True]
    text = said(found)
    assert "reaches three of the five targets; two could not be measured" in text
    assert "PFNN" not in sentence(found)


def test_a_choice_that_knows_no_more_of_the_phase_than_chance_is_said_so() -> None:
    found = evaluation(information=0.06)
    assert met(found)[4] is False
    assert "tells no more than chance of the phase of the gait cycle" in said(found)
    assert "follows the phase of the gait cycle" in said(evaluation())


def test_synthetic_data_are_named_in_the_verdict_and_only_then() -> None:
    found = evaluation(candidate(PFNN))
    assert sentence(found, made_up=True).startswith("On synthetic clips the addressed ensemble")
    assert "The clips are synthetic" in said(found, made_up=True)
    assert "synthetic" not in said(found)


def test_errors_that_rank_backwards_are_said_to_do_so() -> None:
    dead = [candidate(name, None, raw=raw, score=0.1, alive=False) for name, raw in (("ridge", 0.01), ("mean", 0.02))]
    text = said(evaluation(*dead, candidate(PFNN, raw=0.3, score=0.95)))
    assert "The error one step ahead ranks models almost backwards" in text
    assert (
        "no life in the closed loop: ridge regression (MAE 0.0100, score 0.10) and mean of the training frames" in text
    )


def test_errors_that_rank_rightly_are_said_to_tell_something() -> None:
    others = [candidate(name, raw=raw, score=score) for name, raw, score in ((PFNN, 0.3, 0.8), (SINGLE, 0.1, 0.95))]
    text = said(evaluation(*others))
    assert (
        "says something of the closed loop: over all 3 models the rank correlation of raw MAE and score is −1.00"
        in text
    )
    assert "no life" not in text


def test_a_gait_that_is_not_held_out_is_named() -> None:
    assert "The held-out clips hold no jog" in said(evaluation())


def test_the_part_of_a_lead_that_lies_in_the_trajectory_is_told_where_the_tasks_differ() -> None:
    found = evaluation(candidate(PFNN, raw=0.3))
    # All outputs have the same errors here, and 24 of 311 are the trajectory.
    assert "Of its lead over PFNN in raw MAE, 8\u202f% lies in 24 outputs" in said(found)
    assert "Of its lead" not in said(found, target="absolute")
    assert "Of its lead" not in said(evaluation(candidate(PFNN, raw=0.1)))


@pytest.mark.parametrize(("near", "order"), [(0.05, "the same order"), (0.5, "the opposite order")])
def test_near_copies_stand_beside_what_the_paper_states(near: float, order: str) -> None:
    text = said(evaluation(candidate(PFNN, near=0.2), own={"near": near}))
    assert "The paper states an MAE of 0.69 against 2.21 of PFNN" in text
    assert text.count(order) == 1


values = st.lists(st.integers(-5, 5).map(float), min_size=2, max_size=8)


@given(values)
def test_ranks_of_equal_order_correlate_fully(some: list[float]) -> None:
    expected = None if len(set(some)) == 1 else pytest.approx(1.0)
    assert rank_correlation(some, [3 * value + 1 for value in some]) == expected
    opposite = rank_correlation(some, [-value for value in some])
    assert opposite == (None if expected is None else pytest.approx(-1.0))


@given(st.floats(0.01, 1.0), st.floats(0.01, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_comparison_turned_round_is_its_opposite(
    raw: float, other_raw: float, score: float, other_score: float
) -> None:
    found = evaluation(candidate(PFNN, raw=other_raw, score=other_score), own={"raw": raw, "score": score})
    ours, theirs = found.models[OWN], found.models[PFNN]
    opposite = {"better": "worse", "worse": "better", "unclear": "unclear"}
    there, back = compare(ours, theirs), compare(theirs, ours)
    assert [each.relation for each in back] == [opposite[each.relation] for each in there]
    assert outcome(compare(ours, ours), "itself") == "does not clearly differ from itself"
