"""Params files: what is read, and the one-line errors for what is wrong in them."""

import copy
from pathlib import Path
from typing import Any

import pytest
from example_params import EXAMPLE, OPTIMISER, write_params
from pydantic import ValidationError

from addressed_dynamics.errors import ParamsError
from addressed_dynamics.params import ExperimentParams, RecordedRollouts, load_params, load_recipes
from addressed_dynamics.params_recording import DqnBehaviour

SINGLE = {"hidden": [8], "activation": "relu", "batch_size": 4}
RECORDED = {"kind": "recorded", "episodes": 3, "steps": 20, "seed": 0}


def read(tmp_path: Path, section: Any) -> ExperimentParams:
    return load_params(write_params(tmp_path / "params.yaml", car=section), "car")


def changed(path: str, value: Any) -> dict[str, Any]:
    """Return the example with the value at the dotted `path` replaced, or removed if it is `...`."""
    section = copy.deepcopy(EXAMPLE)
    *parents, last = [int(key) if key.isdigit() else key for key in path.split(".")]
    place: Any = section
    for key in parents:
        place = place[key]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return section


def test_a_whole_section_is_read(tmp_path: Path) -> None:
    params = read(tmp_path, EXAMPLE)
    behaviour = params.record.segments[0].behaviour
    assert isinstance(behaviour, DqnBehaviour)
    assert behaviour.hidden == (16,)
    assert params.ensemble.optimiser.betas == tuple(EXAMPLE["ensemble"]["optimiser"]["betas"])


def test_rollouts_may_replay_what_was_recorded(tmp_path: Path) -> None:
    params = read(tmp_path, changed("evaluation.rollouts", RECORDED))
    assert params.evaluation.rollouts == RecordedRollouts(kind="recorded", episodes=3, steps=20, seed=0)


def test_another_recipe_changes_some_keys_of_some_sections(tmp_path: Path) -> None:
    changes = {"ensemble": {"loss": "mae", "optimiser": OPTIMISER}, "features": {"target": "absolute"}}
    section = changed("paper_recipe", changes)
    default, paper = load_recipes(write_params(tmp_path / "params.yaml", car=section), "car")
    assert default == read(tmp_path, section)
    assert (paper.ensemble.loss, paper.features.target) == ("mae", "absolute")
    assert paper.ensemble.hidden == default.ensemble.hidden
    assert paper.addressing == default.addressing
    chosen, other = load_recipes(write_params(tmp_path / "params.yaml", car=section | {"recipe": "paper"}), "car")
    assert (chosen.ensemble, other.ensemble) == (paper.ensemble, default.ensemble)


def test_what_another_recipe_changes_is_checked_even_if_it_is_not_chosen(tmp_path: Path) -> None:
    with pytest.raises(ParamsError, match=r"car\.ensemble\.losss: unknown key"):
        read(tmp_path, changed("paper_recipe", {"ensemble": {"losss": "mae"}}))


def test_params_cannot_be_changed(tmp_path: Path) -> None:
    params = read(tmp_path, EXAMPLE)
    with pytest.raises(ValidationError, match="frozen"):
        params.title = "other"


@pytest.mark.parametrize(
    ("path", "value", "what"),
    [
        ("ensemble.memebrs", 2, "car.ensemble.memebrs: unknown key"),
        ("ensemble.members", ..., "car.ensemble.members: missing key"),
        ("ensemble.members", "two", "car.ensemble.members: input should be a valid integer, but it is 'two'"),
        ("ensemble.members", True, "car.ensemble.members: input should be a valid integer"),
        ("ensemble.members", 0, "car.ensemble.members: input should be greater than or equal to 1"),
        ("ensemble.optimiser.learning_rate", "1e-3", "car.ensemble.optimiser.learning_rate: input should be a valid"),
        ("ensemble.optimiser.learning_rate", float("inf"), "car.ensemble.optimiser.learning_rate: input should be"),
        ("ensemble.optimiser.betas", [0.9], "car.ensemble.optimiser.betas.1: missing key"),
        ("ensemble", ..., "car.ensemble: missing key"),
        ("record.segments.0.behaviour.hiden", [64], "car.record.segments.0.behaviour.hiden: unknown key"),
        ("record.segments.0.behaviour.kind", "dqm", "car.record.segments.0.behaviour: input tag 'dqm'"),
        ("record.segments.0.environments", 3, "400 transitions cannot be shared equally by 3 environments"),
        ("record.segments.1.name", "learner", "two segments are called 'learner'"),
        ("record.segments.3.behaviour.segment", "random", "'random', which is no earlier dqn segment"),
        ("record.segments.2.behaviour.action", "left", "car.record.segments.2.behaviour.action: input should be"),
        ("record.segments", [], "car.record.segments: "),
        ("convert.test_share", 0.95, "validation_share + test_share must be below 1"),
        ("evaluation.rollouts.kind", "recorder", "car.evaluation.rollouts: input tag 'recorder'"),
        ("evaluation.rollouts.environment.id", 3, "car.evaluation.rollouts.environment.id: input should be"),
        ("evaluation.rollouts.environment", ..., "car.evaluation.rollouts.environment: missing key"),
        ("evaluation.rollouts", RECORDED | {"steps": 1}, "car.evaluation.rollouts.steps: input should be greater than"),
        ("evaluation.rollouts", RECORDED | {"environment": {}}, "car.evaluation.rollouts.environment: unknown key"),
        ("baselines.single_networks.pair", {}, "car.baselines.single_networks.pair"),
        ("baselines.single_networks.two words", SINGLE, "car.baselines.single_networks.two words"),
        ("baselines.single_networks.unequal_bins", SINGLE, "'unequal_bins' has a meaning already"),
        ("baselines.single_networks.wide.epochs", 3, "car.baselines.single_networks.wide.epochs: unknown key"),
        ("baselines.train", ["wide"], "car.baselines.train.0: input should be"),
        ("baselines.pair_epochs", -1, "car.baselines.pair_epochs: input should be greater than or equal to 0"),
        ("addressing.heads", ..., "car.addressing.heads: missing key"),
        ("addressing.heads", [0], "car.addressing.heads.0: input should be greater than or equal to 1"),
        ("features.target", "relative", "car.features.target: input should be 'absolute' or 'change'"),
    ],
)
def test_a_wrong_value_is_one_line_with_the_path_of_its_key(tmp_path: Path, path: str, value: Any, what: str) -> None:
    with pytest.raises(ParamsError) as caught:
        read(tmp_path, changed(path, value))
    message = str(caught.value)
    assert what in message
    assert str(tmp_path / "params.yaml") in message
    assert "\n" not in message


def test_a_section_that_is_no_mapping_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParamsError, match=r"car: input should be"):
        read(tmp_path, 3)


def test_several_problems_are_counted(tmp_path: Path) -> None:
    section = changed("ensemble.members", 0)
    section["ensemble"]["epochs"] = 0
    with pytest.raises(ParamsError, match=r"\(and 1 more\)"):
        read(tmp_path, section)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("a: [1, 2", r"params.yaml, line 1: not a YAML file"),
        ("a: 1\na: 2\n", r"line 2: not a YAML file \(found duplicate key"),
        ("- a\n", "a params file is a mapping of sections, but this one holds list"),
        ("", "but this one holds NoneType"),
        ("1: {}\nother: {}\n", r"there is no experiment 'car' in it \(experiments there: 1, other\)"),
        ("car: {title: 2020-01-01}\n", "a kind that params cannot hold"),
    ],
)
def test_a_file_that_is_no_params_file_is_refused_in_one_line(tmp_path: Path, text: str, what: str) -> None:
    path = tmp_path / "params.yaml"
    path.write_text(text)
    with pytest.raises(ParamsError, match=what) as caught:
        load_params(path, "car")
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParamsError, match=r"nowhere\.yaml: no such params file"):
        load_params(tmp_path / "nowhere.yaml", "car")


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ParamsError, match="cannot be read"):
        load_params(path, "car")
