"""What the report makes of the paper's second experiment: its claims, its targets, and many members."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from acrobot_recordings import acrobot_spaces
from report_examples import (
    candidate,
    evaluation_json,
    example_arrays,
    features_of,
    origin,
    recipe,
    shares,
    table,
    transitions_report,
    with_other_recipe,
    write_results,
)

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.evaluation.common.records import BaselineLosses, Specialisations
from addressed_dynamics.evaluation.transitions.records import Evaluation
from addressed_dynamics.features.transitions.spec import Angle
from addressed_dynamics.reporting.common.blocks import Table
from addressed_dynamics.reporting.common.candidates import Effort
from addressed_dynamics.reporting.common.figures.histograms import loss_histograms, output_histograms
from addressed_dynamics.reporting.common.figures.specialisation import OF_STATES, mean_losses, samples_by_member
from addressed_dynamics.reporting.common.render import render_markdown
from addressed_dynamics.reporting.transitions.claims import claims_table, specialists_table
from addressed_dynamics.reporting.transitions.document import headline
from addressed_dynamics.reporting.transitions.figures.members import loss_profiles, state_maps
from addressed_dynamics.reporting.transitions.paper import PAPER, AngleFigures
from addressed_dynamics.reporting.transitions.results import Arrays, load_results
from addressed_dynamics.reporting.transitions.targets import judge_targets, targets_caption
from addressed_dynamics.reporting.transitions.verdict import findings, verdict

PAPER_SCALE, QUICK = 200_000, 50_000
ACROBOT_PAPER = PAPER["acrobot"]
SPACES = acrobot_spaces()
EXAMPLE: dict[str, Any] = {"spaces": SPACES, "members": 8, "wall_free": None, "segments": {"swings": 3, "slow": 2}}


def angles() -> AngleFigures:
    assert ACROBOT_PAPER.angles is not None
    return ACROBOT_PAPER.angles


def document(own: tuple[float, float] = (1e-7, 1e-6), others: tuple[float, float] = (1e-6, 1e-5)) -> dict[str, Any]:
    return evaluation_json(own, others, loss="mae", **EXAMPLE)


def said(found: dict[str, Any], transitions: int = PAPER_SCALE) -> str:
    evaluation = Evaluation.model_validate(found)
    targets = judge_targets(evaluation, ACROBOT_PAPER, transitions=transitions)
    return " ".join([verdict(evaluation, targets, ACROBOT_PAPER), *findings(evaluation, ACROBOT_PAPER)])


def met(found: dict[str, Any], transitions: int) -> list[bool | None]:
    """Agreement, cosines and sines, velocity, least used member."""
    evaluation = Evaluation.model_validate(found)
    return [target.met for target in judge_targets(evaluation, ACROBOT_PAPER, transitions=transitions)]


def own_table(found: dict[str, Any]) -> dict[str, Any]:
    delivered: dict[str, Any] = found["seeds"]["0"]["cost_sensitive"]
    return delivered


def own_dimensions(found: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {each["name"]: each for each in found["candidates"]["ensemble/argmax"]["one_step"]["dimensions"]}


def both(members: int, *, unused: bool = False) -> Specialisations:
    return Specialisations.model_validate({split: shares(members, 500, unused=unused) for split in ("train", "test")})


@pytest.mark.parametrize(
    ("agreement", "transitions", "expected"),
    [
        (0.95, PAPER_SCALE, True),
        (0.85, PAPER_SCALE, False),
        (0.9, PAPER_SCALE, False),
        (0.85, PAPER_SCALE - 1, True),
        (0.8, QUICK, False),
    ],
)
def test_the_number_of_transitions_decides_the_agreement_that_is_asked_for(
    agreement: float, transitions: int, expected: bool
) -> None:
    found = document()
    own_table(found)["agreement"] = agreement
    assert met(found, transitions) == [expected, True, True, True]


@pytest.mark.parametrize(("transitions", "at_most"), [(PAPER_SCALE, 1e-6), (QUICK, 1e-5)])
def test_cosines_and_sines_are_judged_by_their_mean_square(transitions: int, at_most: float) -> None:
    for factor, expected in ((0.99, True), (1.01, False)):
        found = document()
        for name in angles().direction_names:
            own_dimensions(found)[name]["squared"]["mean"] = at_most * factor
        assert met(found, transitions) == [True, expected, True, True]
        target = judge_targets(Evaluation.model_validate(found), ACROBOT_PAPER, transitions=transitions)[1]
        assert "(MAE 1.0" in target.found
        caption = targets_caption(ACROBOT_PAPER, transitions)
        assert ("targets are those of the quick scale" in caption) == (transitions == QUICK)


def test_the_worse_velocity_is_judged_by_its_mean_absolute_error() -> None:
    found = document()
    own_dimensions(found)["velocity_2"]["absolute"]["mean"] = 0.011
    own_dimensions(found)["velocity_2"]["squared"]["mean"] = 0.5
    assert met(found, PAPER_SCALE) == [True, True, False, True]
    target = judge_targets(Evaluation.model_validate(found), ACROBOT_PAPER, transitions=QUICK)[2]
    assert target.found == "1.1\u202f×\u202f10⁻² (MSE 0.50)"


def test_a_member_that_serves_too_few_points_is_missed() -> None:
    found = document()
    own_table(found)["members"][3]["share"] = 0.049
    assert met(found, QUICK) == [True, True, True, False]
    assert "reaches three of the four targets" in said(found)


def test_an_angle_that_was_not_measured_is_named() -> None:
    found = document()
    dimensions = found["candidates"]["ensemble/argmax"]["one_step"]["dimensions"]
    found["candidates"]["ensemble/argmax"]["one_step"]["dimensions"] = dimensions[:6]
    with pytest.raises(ReportError, match="'angle_1'; run evaluate again"):
        claims_table(Evaluation.model_validate(found), angles())


def test_the_claims_stand_beside_squared_and_absolute_errors() -> None:
    claims = claims_table(Evaluation.model_validate(document()), angles())
    assert [row.cells[0] for row in claims.rows if row.kind] == [
        "cosines and sines, together",
        "angles, together",
        "velocities, together",
    ]
    assert [row.cells[2] for row in claims.rows if row.kind] == ["10⁻⁶", "10⁻⁶", "10⁻²"]
    assert [row.cells[1] for row in claims.rows if row.kind] == ["", "rad", "rad/s"]
    assert len(claims.rows) == 3 + 8


def test_the_agreement_of_the_paper_is_held_against_training_points() -> None:
    found = document()
    found["specialisation"]["train"]["agreement"] = 0.812
    found["specialisation"]["test"]["agreement"] = 0.733
    text = said(found)
    assert "lowest loss for 81.2\u202f% of them, where the paper has 77.5\u202f%" in text
    assert "on held-out episodes for 73.3\u202f%" in text
    caption = samples_by_member(Evaluation.model_validate(found).specialisation, 0.775).caption
    assert "81.2\u202f% of the training points and 73.3\u202f% of the held-out ones (the paper" in caption


@pytest.mark.parametrize(
    ("others", "outcome"),
    [
        ((3e-7, 1e-5), "eight specialists beats one network"),
        ((1e-8, 1e-7), "eight specialists does not beat one network"),
        ((3e-7, 1e-7), "eight specialists is only in part (one step ahead) better than one network"),
        ((1e-8, 1e-5), "eight specialists is only in part (in 6 of 7 errors) better than one network"),
    ],
)
def test_specialists_are_held_against_one_network_whichever_way_it_goes(
    others: tuple[float, float], outcome: str
) -> None:
    text = said(document((1e-7, 1e-6), others))
    size = "as many parameters as members and addressing together"
    assert f"Hard addressing of {outcome} of {size}, trained as long: one step ahead" in text


def test_the_spread_over_seeds_of_both_sides_is_in_the_sentence_and_in_a_table() -> None:
    found = document()
    for seed, error in ((1, 2e-7), (2, 3e-7)):
        found["candidates"][f"ensemble/argmax/seed-{seed}"] = candidate(error, 1e-6, SPACES, wall_free=None)
        found["candidates"][f"total_parameters/seed-{seed}"] = candidate(error * 10, 1e-5, SPACES, wall_free=None)
    found["seeds"]["2"] = found["seeds"]["1"]
    ours = "2.0\u202f×\u202f10⁻⁷ (3 seeds: 1.0\u202f×\u202f10⁻⁷ to 3.0\u202f×\u202f10⁻⁷)"
    theirs = "2.0\u202f×\u202f10⁻⁶ (3 seeds: 1.0\u202f×\u202f10⁻⁶ to 3.0\u202f×\u202f10⁻⁶)"
    assert f"one step ahead {ours} against {theirs}: lower; in rollouts lower for all 6 dimensions." in said(found)
    efforts = {"ensemble": Effort(77, 4928), "total_parameters/seed-2": Effort(77, None)}
    found["candidates"]["ensemble/argmax/seed-1"]["multiply_adds"] = 5678
    seeds = specialists_table(Evaluation.model_validate(found), efforts)
    assert isinstance(seeds, Table)
    titles = [*(f"seed {seed}" for seed in range(3)), "lowest to highest"]
    expected = [f"{model}, {title}" for model in ("8 specialists", "one network") for title in titles]
    assert [row.cells[0] for row in seeds.rows] == expected
    assert seeds.rows[0].cells[1:5] == ("1,234", "77", "4,928", "–")
    assert seeds.rows[1].cells[1:5] == ("1,234", "77", "4,928", "5,678")
    assert seeds.rows[5].cells[1:5] == ("1,234", "–", "–", "–")
    assert seeds.rows[6].cells[1:5] == ("1,234", "77", "–", "–")
    assert [row.cells[5] for row in seeds.rows if row.kind] == [
        "1.0\u202f×\u202f10⁻⁷ – 3.0\u202f×\u202f10⁻⁷",
        "1.0\u202f×\u202f10⁻⁶ – 3.0\u202f×\u202f10⁻⁶",
    ]


def test_one_network_like_a_member_stands_beside_them_in_the_table_and_in_a_sentence() -> None:
    found = document((1e-7, 1e-6), (3e-7, 1e-5))
    found["candidates"]["same_size/seed-0"] = candidate(5e-8, 1e-5, SPACES, wall_free=None)
    seeds = specialists_table(Evaluation.model_validate(found), {})
    assert isinstance(seeds, Table)
    assert [row.cells[0] for row in seeds.rows[-2:]] == [
        "one like a member, seed 0",
        "one like a member, lowest to highest",
    ]
    assert "and one as large as a member, trained for as many updates: every seed of each (2, 1 and 1)" in seeds.caption
    better = "is only in part (in 6 of 7 errors) better than one network as large as a member, trained as long"
    assert f"Hard addressing of eight specialists {better}" in said(found)


def test_without_one_network_of_the_same_size_there_is_no_such_table() -> None:
    found = document()
    del found["candidates"]["total_parameters/seed-0"]
    assert specialists_table(Evaluation.model_validate(found), {}) is None
    assert "specialists" not in said(found)


def test_several_single_networks_are_named_with_their_errors() -> None:
    found = document((1e-7, 1e-6), (1e-6, 1e-5))
    found["candidates"]["small/seed-0"] = candidate(1e-8, 1e-5, SPACES, wall_free=None)
    text = said(found)
    assert "one wide network 1.0\u202f×\u202f10⁻⁶ and small 1.0\u202f×\u202f10⁻⁸" in text
    assert "1.0\u202f×\u202f10⁻⁷, is clearly lower than that of one wide network." in text
    assert "unable to learn" not in text


@pytest.mark.parametrize(
    ("ratios", "expected"),
    [
        ([500.0] * 8, "The subnetworks specialise: on samples"),
        ([1.5] * 8, "The subnetworks hardly specialise"),
        ([1.5] * 2 + [50.0] * 6, "Of the eight subnetworks six specialise"),
    ],
)
def test_how_many_members_specialise_is_said(ratios: list[float], expected: str) -> None:
    found = document()
    for member, ratio in zip(own_table(found)["members"], ratios, strict=True):
        member["not_selected"] = ratio * member["selected"]
    assert expected in said(found)


def test_all_members_that_are_never_selected_are_named() -> None:
    found = document()
    for member in (2, 7):
        own_table(found)["members"][member] = table(8, unused=True)["members"][7]
    assert "Subnetworks 3 and 8 are never selected" in said(found)


@pytest.mark.parametrize(("members", "unused"), [(2, False), (5, False), (8, True)])
def test_each_chart_of_specialisation_has_both_splits_and_cites_the_paper_where_it_is_its(
    members: int, unused: bool
) -> None:
    found = both(members, unused=unused)
    baselines = BaselineLosses.model_validate(
        {split: {"wide/seed-0": 1e-5, "wide/seed-1": 2e-5, "other/seed-0": 0.0} for split in ("train", "test")}
    )
    for paper in (True, False):
        words = replace(OF_STATES, paper=paper)
        charts = [
            samples_by_member(found, None, words),
            mean_losses(found, baselines, words),
            loss_histograms(found, words),
            output_histograms(found, words),
        ]
        for chart, number in zip(charts, (8, 9, 10, 11), strict=True):
            assert (f"(Fig. {number} of the paper)" in chart.caption) == paper
            assert [view.choice for view in chart.views] == [("training points",), ("held-out episodes",)]
            assert "nan" not in chart.caption
            assert all(len(view.lines) >= members for view in chart.views)
    assert "other, 0." in charts[1].caption


def test_the_charts_of_specialisation_have_the_numbers_that_were_measured() -> None:
    found = both(3)
    samples = samples_by_member(found, None).views[1]
    assert [line.values[0] for line in samples.lines] == pytest.approx(
        [100 * count / found.test.samples for count in found.test.addressed], rel=5e-4
    )
    losses = mean_losses(found, BaselineLosses(train={}, test={})).views[0]
    assert [line.high[0] for line in losses.lines[:3]] == pytest.approx(list(found.train.mean_loss.all), rel=5e-4)
    assert [line.low[0] for line in losses.lines[:3]] == pytest.approx(list(found.train.mean_loss.own), rel=5e-4)
    counted = output_histograms(found).views[1]
    assert [line.values for line in counted.lines] == [pytest.approx(each) for each in found.test.output_counts]
    assert sum(line.shown for line in counted.lines) == 3


def test_figures_without_single_networks_or_losses_say_nothing_of_them() -> None:
    found = both(2)
    assert "single" not in mean_losses(found, BaselineLosses(train={}, test={})).caption
    assert "the paper, " not in samples_by_member(found, None).caption


def arrays(members: int, *, pair: bool) -> Arrays:
    values = example_arrays(SPACES, members, walls=False)
    if pair:
        profile = np.stack([np.full(300, 1e-5), np.full(300, 1e-3)])
        values |= {"pair_profile": profile, "pair_profile_untrained": profile * 10}
    return Arrays(**values)


def test_profiles_of_many_members_are_drawn_of_a_small_ensemble_of_two() -> None:
    figure = loss_profiles(arrays(8, pair=True))
    assert figure is not None
    assert "of an ensemble of two, which was trained for this figure beside that of 8" in figure.caption
    assert "its colour is the network with the lower loss after training" in figure.caption


@pytest.mark.parametrize(("members", "pair"), [(8, False), (2, True), (2, False)])
def test_other_profiles_are_of_the_delivered_model(members: int, pair: bool) -> None:
    figure = loss_profiles(arrays(members, pair=pair))
    assert figure is not None
    assert "ensemble of two" not in figure.caption
    assert "the addressing network selects after training" in figure.caption


def test_maps_are_over_the_angles_where_there_are_any() -> None:
    shown = [Angle(f"angle_{k}", f"cos_angle_{k}", f"sin_angle_{k}", None) for k in (1, 2)]
    for angles, axes in ((shown, "over angle_1 and angle_2"), ([], "over cos_angle_1 and sin_angle_1")):
        figure = state_maps(arrays(2, pair=False), SPACES, angles)
        assert figure is not None
        assert all(axes in panel.alternative for panel in figure.panels)


def test_bounds_far_beyond_the_data_do_not_squash_the_maps() -> None:
    drawn = []
    for far in (math.inf, 1e9):
        wide = tuple(replace(each, low=-far, high=far) for each in SPACES.observation)
        figure = state_maps(arrays(2, pair=False), replace(SPACES, observation=wide))
        assert figure is not None
        drawn.append([panel.content for panel in figure.panels])
    assert drawn[0] == drawn[1]


@pytest.mark.slow
def test_the_report_of_acrobot_is_whole(tmp_path: Path) -> None:
    theirs = recipe(features_of(SPACES, target="absolute"))
    kind = {name: value for name, value in EXAMPLE.items() if name != "members"}
    both = with_other_recipe(document(), theirs, (1e-5, 1e-4), **kind)
    added = {name: both[name] for name in ("candidates", "other_recipe")}
    results = load_results(*write_results(tmp_path, loss="mae", **EXAMPLE, **added))
    report = transitions_report(results, origin(SPACES, title="Acrobot"), ACROBOT_PAPER)
    titles = [section.title for section in report.sections]
    assert {"Subnetworks", "Specialisation"} < set(titles)
    assert titles[titles.index("Specialisation") + 1] == "The two recipes"
    (stated,) = (section for section in report.sections if section.title == "The paper's figures")
    assert [type(block) for block in stated.blocks] == [Table, Table], "the targets, and the errors that it states"
    shown = {chart.name for chart in report.charts}
    assert {f"specialisation-{name}" for name in ("samples", "mean-loss", "losses", "outputs")} < shown
    text = render_markdown(report)
    assert "nan" not in text.lower()
    assert "the paper, one rollout figure" not in text
    assert "wall contact" not in text
    assert "| they predict | the change of the state | the next state |" in text
    assert headline(results, ACROBOT_PAPER)["targets/reached"] == 4.0
