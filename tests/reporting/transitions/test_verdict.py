import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st
from report_examples import OTHERS, beside, candidate, evaluation, evaluation_json, table

from addressed_dynamics.evaluation.transitions.records import Evaluation
from addressed_dynamics.reporting.common.comparison import Interval, relate
from addressed_dynamics.reporting.common.targets import Target
from addressed_dynamics.reporting.transitions.paper import PAPER
from addressed_dynamics.reporting.transitions.targets import judge_targets
from addressed_dynamics.reporting.transitions.verdict import findings, verdict

CAR_PAPER = PAPER["mountaincar"]
errors = st.lists(st.floats(1e-12, 1.0), min_size=1, max_size=5)


def judged(found: Evaluation) -> tuple[Target, ...]:
    return judge_targets(found, CAR_PAPER, transitions=1000)


def said(found: Evaluation) -> str:
    return " ".join([verdict(found, judged(found), CAR_PAPER), *findings(found, CAR_PAPER)])


def test_a_model_that_is_better_in_all_beats_one_network_of_the_same_size() -> None:
    assert "It beats one network of as many parameters as members and addressing together" in said(
        evaluation((1e-7, 1e-6), (1e-6, 1e-5))
    )


@pytest.mark.parametrize("others", [(1e-8, 1e-7), (1e-7, 1e-6), (1.05e-7, 1.05e-6)], ids=["worse", "same", "close"])
def test_a_model_that_is_not_clearly_better_does_not_beat_it(others: tuple[float, float]) -> None:
    text = said(evaluation((1e-7, 1e-6), others))
    assert "It does not beat one network of as many parameters as members and addressing together" in text
    assert "It beats" not in text


def test_a_model_that_is_better_in_part_is_said_to_be_better_in_that_part() -> None:
    text = said(evaluation((1e-7, 1e-5), (1e-6, 1e-6)))
    size = "as many parameters as members and addressing together"
    assert f"It is only in part (one step ahead) better than one network of {size}" in text


def test_one_seed_that_is_worse_makes_the_difference_unclear() -> None:
    document = evaluation_json((1e-7, 1e-6), (1e-6, 1e-5))
    document["candidates"]["ensemble/argmax/seed-1"] = candidate(1e-5, 1e-4)
    assert "It does not beat one network of as many parameters as members and addressing together" in said(
        Evaluation.model_validate(document)
    )


def resampled(one_step: tuple[float, float], rollout: tuple[float, float]) -> str:
    """What is said where every other's errors are ten times ours, with these intervals."""
    document = evaluation_json((1e-7, 1e-6), (1e-6, 1e-5))
    for name in OTHERS:
        document["candidates"][name]["beside_ensemble"] = beside(one_step, rollout)
    return said(Evaluation.model_validate(document))


def test_nothing_is_better_where_other_episodes_could_turn_it_round() -> None:
    text = resampled((0.9, 14.0), (0.8, 20.0))
    assert "It does not beat one network of as many parameters as members and addressing together" in text
    assert "against 1.0 × 10⁻⁶ (one seed), 0.900 to 14.0 times the ensemble's: no clear difference" in plain(text)
    assert "It does not beat the paper's one wide network" in text
    text = resampled((6.0, 14.0), (0.8, 20.0))
    assert "It is only in part (one step ahead) better than one network of as many parameters" in text


def test_an_interval_that_leaves_no_doubt_is_said_with_the_numbers() -> None:
    text = resampled((6.0, 14.0), (5.0, 20.0))
    assert "It beats one network of as many parameters as members and addressing together" in text
    assert "against 1.0 × 10⁻⁶ (one seed), 6.00 to 14.0 times the ensemble's: lower" in plain(text)
    assert "(2,000 draws of the held-out episodes, of which 5 are the least) does not have 1 in it." in text


def test_of_too_few_episodes_nothing_is_said_to_be_better() -> None:
    document = evaluation_json((1e-7, 1e-6), (1e-6, 1e-5))
    nothing = {"one_step": None, "rollouts": None, "dimensions": {"position": None, "velocity": None}}
    document["candidates"]["total_parameters/seed-0"]["beside_ensemble"] = nothing
    text = said(Evaluation.model_validate(document))
    assert "It does not beat one network of as many parameters as members and addressing together" in text
    assert "(one seed), of too few episodes to tell: no clear difference; position in rollouts" in text


def plain(text: str) -> str:
    return text.replace("\u202f", " ")


def recommending(name: str, *, why: str, better: bool = True) -> str:
    document = evaluation_json((1e-7, 1e-6), (1e-6, 1e-5))
    document["candidates"]["linear/seed-0"] = candidate(1e-5, 1e-4) | {"label": "linear least squares"}
    score = {"one_step_percent": 0.694, "rollout_percent": 3.0, "horizon_seconds": 100.0}
    own = {"one_step_percent": 0.85, "rollout_percent": 7.0, "horizon_seconds": 85.0}
    document["recommendation"] = {
        "candidate": name, "label": "linear least squares", "beats_references": better, "rollouts": 12,
        "scores": {"linear/seed-0": score, "ensemble/argmax": own},
    }  # fmt: skip
    document["choice"] = {"candidate": "ensemble/argmax" if why == "asked" else name, "why": why}
    return said(Evaluation.model_validate(document))


def test_the_first_sentence_says_which_model_is_delivered_and_why() -> None:
    reached = (
        "on validation episodes its error is 0.69 % of the range after a step, and its rollouts keep it below 10 % for "
        "100 s, where the addressed ensemble has 0.85 % and 85.0 s. "
    )
    assert recommending("linear/seed-0", why="reference", better=False).startswith(
        f"Delivered is linear least squares, for no trained model is worth more: {reached}"
    )
    text = recommending("linear/seed-0", why="best")
    assert text.startswith(f"Delivered is linear least squares, the best: {reached}")
    assert "On held-out episodes linear least squares, which is delivered, has a mean MSE of" in text
    assert recommending("linear/seed-0", why="asked").startswith(
        "Delivered is the addressed ensemble, as the params file asks, but load linear least squares "
        f"(candidate='recommended'): {reached}"
    )


def test_the_first_sentence_says_if_a_reference_is_better_one_step_ahead() -> None:
    text = recommending("ensemble/argmax", why="best")
    assert text.startswith("Delivered is the addressed ensemble, the best: on validation episodes its error is 0.85 %")
    assert "for 85.0 s; one step ahead linear least squares is better (0.69 %). " in text
    assert recommending("ensemble/argmax", why="asked").startswith(
        "Delivered is the addressed ensemble, as the params file asks, and it is the best: on validation"
    )


def test_a_model_that_nobody_could_choose_is_said_to_be_none() -> None:
    document = evaluation_json() | {"choice": {"candidate": "ensemble/argmax", "why": "unmeasured"}}
    text = said(Evaluation.model_validate(document))
    assert text.startswith("Delivered is the addressed ensemble, for there are no validation episodes to choose by. ")


def test_rollouts_of_the_delivered_model_that_fly_off_are_said() -> None:
    document = evaluation_json((1e-7, 1e-6), (1e-6, 1e-5))
    document["candidates"]["ensemble/argmax"] |= {"label": "ensemble, argmax addressing"}
    document["candidates"]["ensemble/argmax"]["rollouts"]["flown_off_share"] = 0.25
    text = said(Evaluation.model_validate(document))
    assert (
        "Of the rollouts of the ensemble, argmax addressing, which is delivered, 25.0\u202f% fly off: a state" in text
    )
    assert "fly off" not in said(evaluation((1e-7, 1e-6), (1e-6, 1e-5)))


@given(errors, errors)
def test_a_relation_turned_round_is_its_opposite(own: list[float], other: list[float]) -> None:
    opposite = {"better": "worse", "worse": "better", "unclear": "unclear"}
    assert relate(other, own) == opposite[relate(own, other)]
    assert relate(own, own) == "unclear"


def test_the_paper_itself_reaches_the_targets_taken_from_it() -> None:
    document = evaluation_json((1e-7, 4.859e-8))
    rows = document["seeds"]["0"]["cost_sensitive"]["members"]
    for row, network in zip(rows, CAR_PAPER.networks, strict=True):
        row |= {"selected": network.selected, "not_selected": network.not_selected}
    document["seeds"]["0"]["cost_sensitive"]["misclassified_per_thousand"] = 27.0
    found = Evaluation.model_validate(document)
    assert all(target.met for target in judged(found))
    assert "reaches all five figures" in said(found)


@pytest.mark.parametrize(
    ("key", "value", "place"),
    [("selected", 1.3e-6, 0), ("ratio", 150.0, 1)],
)
def test_a_figure_beyond_its_bound_is_missed(key: str, value: float, place: int) -> None:
    document = evaluation_json((1e-7, 1e-8))
    document["seeds"]["0"]["cost_sensitive"] = table(**{key: value})
    targets = judged(Evaluation.model_validate(document))
    assert [target.met for target in targets] == [index != place for index in range(5)]


def test_a_member_that_is_never_selected_is_said_and_counts_as_missed() -> None:
    found = evaluation(unused=True)
    first, second, *_ = judged(found)
    assert (first.met, second.met) == (False, None)
    assert "never selected" in first.found
    assert "Subnetwork 2 is never selected" in said(found)


def test_what_cannot_be_measured_is_open_and_not_reached() -> None:
    found = evaluation((1e-7, 1e-8), wall_free=0)
    assert [target.met for target in judged(found)] == [True, True, True, True, None]
    assert "reaches four of the five figures taken from the paper; one could not be measured" in said(found)


def test_recorded_rollouts_say_nothing_of_walls_and_leave_what_needs_them_open() -> None:
    found = evaluation((1e-7, 1e-8), wall_free=None)
    assert [target.met for target in judged(found)] == [True, True, True, True, None]
    (rollouts,) = (
        sentence for sentence in findings(found, CAR_PAPER) if "rollouts" in sentence and "median MSE" in sentence
    )
    assert rollouts.startswith("In 50 free-running rollouts of 30 steps beside held-out episodes the median MSE is")
    assert "wall" not in rollouts


def test_an_experiment_that_is_not_in_the_paper_is_not_held_against_its_claims() -> None:
    text = " ".join(findings(evaluation((1e-9, 1e-6), (1e-6, 1e-5)), None))
    assert "It beats one wide network" in text
    assert "paper" not in text


def test_the_claim_about_the_wide_network_is_held_against_what_it_reached() -> None:
    assert "is not borne out" in said(evaluation((1e-7, 1e-6), (1e-6, 1e-5)))
    assert "is borne out" in said(evaluation((1e-9, 1e-6), (1e-6, 1e-5)))


def test_subnetworks_that_serve_all_samples_alike_hardly_specialise() -> None:
    document = evaluation_json()
    document["seeds"]["0"]["cost_sensitive"] = table(ratio=1.5)
    assert "hardly specialise" in said(Evaluation.model_validate(document))
    assert "The subnetworks specialise" in said(evaluation())


def test_a_model_without_baselines_is_not_compared() -> None:
    document = evaluation_json()
    document["candidates"] = {"ensemble/argmax": document["candidates"]["ensemble/argmax"]}
    text = said(Evaluation.model_validate(document))
    assert "one network" not in text
    assert "Comparisons" not in text


def test_an_experiment_with_another_paper_has_its_figures() -> None:
    assert CAR_PAPER.table is not None
    table = dataclasses.replace(CAR_PAPER.table, misclassified_at_most=1.0)
    paper = dataclasses.replace(CAR_PAPER, table=table, rollouts={})
    assert [target.met for target in judge_targets(evaluation(), paper, transitions=1000)] == [True, True, False]


@given(errors, errors, st.lists(st.tuples(st.floats(0.01, 10), st.floats(0.01, 10)), max_size=3))
def test_an_interval_takes_a_relation_back_and_never_makes_one(
    own: list[float], other: list[float], ends: list[tuple[float, float]]
) -> None:
    intervals = [Interval(min(pair), max(pair)) for pair in ends]
    doubtful = any(each.low <= 1 <= each.high for each in intervals)
    assert relate(own, other, intervals) == ("unclear" if doubtful else relate(own, other))
