"""What the report says of the recipe of a run, and of the default and the paper's beside each other."""

import copy
from pathlib import Path
from typing import Any

import pytest
from acrobot_recordings import acrobot_spaces
from builders import CAR
from example_params import EXAMPLE, OPTIMISER
from report_examples import (
    ACROBOT_ANGLES,
    evaluation_json,
    features_of,
    origin,
    recipe,
    shares,
    with_other_recipe,
    write_results,
)

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.base.params.training import AddressingParams, EnsembleParams
from addressed_dynamics.evaluation.transitions.records import Evaluation
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.reporting.common.blocks import Table
from addressed_dynamics.reporting.common.origin import Origin, run_facts
from addressed_dynamics.reporting.transitions.paper import PAPER, PaperFigures
from addressed_dynamics.reporting.transitions.recipes import recipes_finding, recipes_table
from addressed_dynamics.reporting.transitions.results import load_results
from addressed_dynamics.reporting.transitions.settings import SETTINGS, model_words
from addressed_dynamics.reporting.transitions.tables import one_step_table
from addressed_dynamics.reporting.transitions.verdict import findings

ACROBOT = acrobot_spaces()
ACROBOT_KIND: dict[str, Any] = {"spaces": ACROBOT, "wall_free": None, "segments": {"swings": 3, "slow": 2}}
CONSTANT = OPTIMISER | {"final_share": 1.0}
OURS = recipe(features_of(ACROBOT, ACROBOT_ANGLES, history=6, history_weight=0.3))
THEIRS = recipe(
    features_of(
        ACROBOT, ACROBOT_ANGLES, history=6, target="absolute", angle_from="weighted", velocity="difference"
    ),
    {"optimiser": CONSTANT, "batch_size": 8},
    heads=[4, 4],
)  # fmt: skip


def acrobot(errors: tuple[float, float] = (1e-5, 1e-4), **changes: Any) -> Evaluation:
    document = evaluation_json((1e-7, 1e-6), loss="mae", members=8, **ACROBOT_KIND)
    return Evaluation.model_validate(with_other_recipe(document, THEIRS, errors, **ACROBOT_KIND, **changes))


def cells(table: Table | None) -> dict[str, tuple[str, ...]]:
    assert table is not None
    return {name: values for name, *values in (row.cells for row in table.rows)}


def facts(found: Origin[FeatureSpec]) -> dict[str, str]:
    return dict(run_facts(found, model_words(found.features), 0).items)


def test_a_run_says_its_recipe_and_what_its_networks_are_given_and_asked_for() -> None:
    said = facts(origin())
    assert said["Recipe"] == "the default"
    assert said["Inputs"] == "one frame: a state with its action"
    assert said["Subnetworks"].endswith("they predict the change of the state")
    assert "Angles" not in said
    assert said["Addressing"] == "hidden layers 16, relu"
    assert "dropout" not in "".join(said.values())


def test_a_run_with_dropout_says_so_of_both_phases() -> None:
    ensemble = EnsembleParams.model_validate(EXAMPLE["ensemble"] | {"dropout": 0.1}, strict=False)
    addressing = AddressingParams.model_validate(EXAMPLE["addressing"] | {"dropout": 0.2}, strict=False)
    said = facts(origin(ensemble=ensemble, addressing=addressing))
    assert said["Phase 1"].endswith(", dropout 0.1")
    assert said["Phase 2"].endswith(", dropout 0.2")


def test_a_run_with_history_angles_and_heads_says_all_of_them() -> None:
    features = features_of(ACROBOT, ACROBOT_ANGLES, history=6, history_weight=0.3, velocity="difference")
    heads = {"hidden": [512, 512], "heads": [256, 256]}
    addressing = AddressingParams.model_validate(EXAMPLE["addressing"] | heads, strict=False)
    said = facts(origin(ACROBOT, features=features, addressing=addressing, recipe="paper"))
    assert said["Recipe"] == "the paper's"
    assert said["Inputs"] == "6 frames in a row, each a state with its action; older frames weigh 0.3 times the last"
    assert said["Angles"] == (
        "angle_1 and angle_2 from cosine and sine by atan2; their velocities are differences of successive angles"
    )
    assert said["Addressing"] == (
        "a trunk with hidden layers 512 × 512, on it 2 heads with hidden layers 256 × 256, relu"
    )
    predicted = features_of(ACROBOT, ACROBOT_ANGLES, history=6, angle_from="weighted")
    said = facts(origin(ACROBOT, features=predicted))
    assert said["Inputs"] == "6 frames in a row, each a state with its action"
    assert said["Angles"].endswith("by the paper's weighted mean (Section 3.3); their velocities are predicted")


def test_the_table_has_the_settings_that_differ_and_no_others() -> None:
    found = cells(recipes_table(acrobot(), OURS))
    assert {name for name in SETTINGS if name in found} == {
        "they are given",
        "they predict",
        "angles",
        "velocities of angles",
        "optimiser",
        "samples per network and update",
        "addressing network",
    }
    assert found["they predict"] == ["the change of the state", "the next state"]
    assert found["velocities of angles"] == ["predicted", "differences of successive angles"]
    assert found["samples per network and update"] == ["32", "8"]
    assert [", constant," in words for words in found["optimiser"]] == [False, True]


def test_the_table_has_what_came_of_both_recipes() -> None:
    evaluation = acrobot()
    found = cells(recipes_table(evaluation, OURS))
    assert evaluation.other_recipe is not None
    own, other = evaluation.specialisation, evaluation.other_recipe.specialisation
    agreement = [f"{100 * each.test.agreement:.1f}\u202f%" for each in (own, other)]
    assert found["agreement on held-out points"] == agreement
    errors = ["1.0\u202f×\u202f10⁻⁷", "1.0\u202f×\u202f10⁻⁵"]
    for name in (
        "one step, MAE of scaled states",
        "one step, MSE of cosines and sines",
        "one step, MAE of cosines and sines",
        "one step, MAE of angles in rad",
        "one step, MSE of velocities of angles in (rad/s)²",
    ):
        assert found[name] == errors, name
    assert found["rollouts, median MSE of velocity_2"] == ["1.0\u202f×\u202f10⁻⁶", "1.0\u202f×\u202f10⁻⁴"]
    assert found["rollouts, median time until an angle is off by 0.5 rad, in s"] == ["7.25", "7.25"]


def test_without_angles_the_table_has_every_dimension() -> None:
    ours, theirs = recipe(features_of(CAR)), recipe(features_of(CAR, target="absolute"))
    document = with_other_recipe(evaluation_json(), theirs, (1e-6, 1e-5))
    found = cells(recipes_table(Evaluation.model_validate(document), ours))
    errors = {name for name in found if name.startswith("one step, M")}
    assert errors == {
        "one step, MSE of scaled states",
        "one step, MAE of position in m",
        "one step, MSE of position in m²",
        "one step, MAE of velocity in m/step",
        "one step, MSE of velocity in (m/step)²",
    }
    assert not any("angle" in name for name in found)


@pytest.mark.parametrize(
    ("name", "headers", "first"),
    [
        ("paper_recipe", ["", "the default recipe, chosen", "the paper's recipe"], "the change of the state"),
        ("default_recipe", ["", "the default recipe", "the paper's recipe, chosen"], "the next state"),
    ],
)
def test_the_default_stands_before_the_paper_s_whichever_was_chosen(name: str, headers: list[str], first: str) -> None:
    table = recipes_table(acrobot(name=name), OURS)
    assert table is not None
    assert [column.header for column in table.columns] == headers
    assert cells(table)["they predict"][0] == first


@pytest.mark.parametrize(
    ("errors", "name", "expected"),
    [
        ((1e-5, 1e-4), "paper_recipe", "The default recipe beats the paper's recipe: one step ahead 1.0"),
        ((1e-9, 1e-8), "paper_recipe", "The default recipe does not beat the paper's recipe"),
        ((1e-5, 1e-8), "default_recipe", "The paper's recipe is only in part (one step ahead) better than the default"),
    ],
)
def test_which_recipe_is_better_is_said_whichever_way_it_goes(
    errors: tuple[float, float], name: str, expected: str
) -> None:
    evaluation = acrobot(errors, name=name)
    (sentence,) = (text for text in findings(evaluation, PAPER["acrobot"]) if text.startswith(expected))
    assert evaluation.other_recipe is not None
    least = min(evaluation.other_recipe.specialisation.test.addressed) / 300
    assert sentence.endswith(f"of the held-out points, against {100 * least:.1f}\u202f%.")


def test_the_other_recipe_is_no_single_network() -> None:
    assert acrobot().single_networks == ["wide"]


def test_one_recipe_alone_is_not_compared() -> None:
    evaluation = Evaluation.model_validate(evaluation_json())
    assert recipes_table(evaluation, OURS) is None
    assert recipes_finding(evaluation) is None


def test_of_several_seeds_of_the_other_recipe_the_first_stands_in_the_table() -> None:
    document = acrobot().model_dump(mode="json")
    second = copy.deepcopy(document["candidates"]["paper_recipe/seed-0"])
    second["one_step"]["scaled"]["mean"] = 0.5
    document["candidates"]["paper_recipe/seed-1"] = second
    found = recipes_table(Evaluation.model_validate(document, strict=False), OURS)
    assert found == recipes_table(acrobot(), OURS)
    assert found is not None


def test_an_evaluation_that_does_not_say_whether_there_is_another_recipe_is_refused(tmp_path: Path) -> None:
    document = with_other_recipe(evaluation_json(), THEIRS, (1e-6, 1e-5))
    del document["candidates"]["paper_recipe/seed-0"]
    folders = write_results(tmp_path, other_recipe=document["other_recipe"])
    with pytest.raises(ReportError, match="'paper_recipe' is the other recipe, so there should be a candidate of it"):
        load_results(*folders)


@pytest.mark.parametrize(
    ("evaluation", "paper", "remarked"),
    [
        (Evaluation.model_validate(evaluation_json()), PAPER["mountaincar"], True),
        (Evaluation.model_validate(evaluation_json()), None, False),
        (acrobot(), PAPER["acrobot"], False),
    ],
    ids=["mountaincar", "imported", "acrobot"],
)
def test_the_paper_s_remark_on_one_wide_network_stands_where_it_was_made(
    evaluation: Evaluation, paper: PaperFigures | None, *, remarked: bool
) -> None:
    caption = one_step_table(evaluation, {}, paper).caption
    assert ("One network of three layers of 512 is the paper's own comparison" in caption) == remarked
    assert any("claim that one wide network" in text for text in findings(evaluation, paper)) == remarked


def test_the_smallest_share_is_of_the_points_that_were_addressed() -> None:
    document = with_other_recipe(evaluation_json(), recipe(features_of(CAR)), (1e-6, 1e-5))
    document["specialisation"]["test"] = shares(2, 300) | {"addressed": [297, 3]}
    found = cells(recipes_table(Evaluation.model_validate(document), recipe(features_of(CAR))))
    assert found["held-out points of the least used network"][0] == "1.0\u202f%"
