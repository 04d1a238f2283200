"""Params files: what is read, and the one-line errors for what is wrong in them."""

import copy
from pathlib import Path
from typing import Any

import pytest
from dvc_settings import apply_overrides
from example_params import EXAMPLE, MOTION, OPTIMISER, RECORD, write_params
from pydantic import ValidationError
from ruamel.yaml import YAML
from stage_dependencies import ROOT

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.params.experiments import (
    load_experiment,
    load_recipes,
    load_record_params,
    load_source_params,
    replaced_keys,
)
from addressed_dynamics.base.params.recording import DqnBehaviour
from addressed_dynamics.base.params.training import EnsembleParams, EnsembleSection
from addressed_dynamics.sources.motion.params import (
    LearnedBlend,
    MotionExperimentParams,
    MotionOptimiser,
    PhaseFunctioned,
)
from addressed_dynamics.sources.transitions.params import ExperimentParams, RecordedRollouts

SINGLE = {"hidden": [8], "activation": "relu", "batch_size": 4}
RECORDED = {"kind": "recorded", "episodes": 3, "steps": 20, "seed": 0}
SHIFT = {"kind": "starts", "environment": {"id": "Car-v0"}, "behaviour": {"kind": "constant", "action": 1}}


def read(tmp_path: Path, section: Any) -> ExperimentParams:
    return load_experiment(write_params(tmp_path / "params.yaml", car=section), "car", "transitions")


def read_motion(tmp_path: Path, section: Any) -> MotionExperimentParams:
    return load_experiment(write_params(tmp_path / "params.yaml", walk=section), "walk", "motion")


def changed(path: str, value: Any, example: dict[str, Any] = EXAMPLE) -> dict[str, Any]:
    """Return the example with the value at the dotted `path` replaced, or removed if it is `...`."""
    section = copy.deepcopy(example)
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


def test_a_shift_stands_under_its_name_and_is_as_long_as_a_history(tmp_path: Path) -> None:
    (shift,) = read(tmp_path, changed("evaluation.shifts", {"fast": SHIFT})).evaluation.shifts
    assert (shift.name, shift.environment.id, shift.episodes, shift.steps) == ("fast", "Car-v0", 40, 100)
    section = changed("evaluation.shifts", {"fast": SHIFT | {"steps": 4}})
    section["features"]["history"] = 4
    assert read(tmp_path, section).evaluation.shifts[0].steps == 4
    section["features"]["history"] = 5
    with pytest.raises(
        ParamsError, match=r"evaluation\.shifts\.fast\.steps is 4, but features.history asks for 5 frames"
    ):
        read(tmp_path, section)
    section["features"]["history"] = "auto"
    with pytest.raises(ParamsError, match=r"features\.history asks for up to 6 frames"):
        read(tmp_path, section)


@pytest.mark.parametrize(
    ("paper", "evaluation", "delivered"),
    [
        (None, {}, "best"),
        ("mountaincar", {}, "addressed"),
        ("mountaincar", {"rollouts": RECORDED}, "addressed"),
        ("mountaincar", {"deliver": "best"}, "best"),
        (None, {"deliver": "addressed"}, "addressed"),
    ],
)
def test_the_addressed_ensemble_is_delivered_by_itself_where_there_is_a_paper_alone(
    tmp_path: Path, paper: str | None, evaluation: dict[str, Any], delivered: str
) -> None:
    section = {"title": "Car", "record": RECORD, "paper": paper, "evaluation": evaluation}
    assert read(tmp_path, section).evaluation.deliver == delivered
    if not evaluation:
        del section["evaluation"]
        assert read(tmp_path, section).evaluation.deliver == delivered


def test_another_recipe_changes_some_keys_of_some_sections(tmp_path: Path) -> None:
    changes = {"ensemble": {"loss": "mae", "optimiser": OPTIMISER}, "features": {"target": "absolute"}}
    section = changed("paper_recipe", changes)
    default, paper = load_recipes(write_params(tmp_path / "params.yaml", car=section), "car", "transitions")
    assert default == read(tmp_path, section)
    assert (paper.ensemble.loss, paper.features.target) == ("mae", "absolute")
    assert paper.ensemble.hidden == default.ensemble.hidden
    # What it says not is the paper's way.
    assert (paper.ensemble.cluster_epochs, paper.addressing.deliver) == (paper.ensemble.epochs, "plain")
    assert paper.addressing.hidden == default.addressing.hidden
    chosen, other = load_recipes(
        write_params(tmp_path / "params.yaml", car=section | {"recipe": "paper"}), "car", "transitions"
    )
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
        ("ensemble.members", "two", "car.ensemble.members: input should be a valid integer, but it is 'two'"),
        ("ensemble.members", True, "car.ensemble.members: input should be a valid integer"),
        ("ensemble.members", 0, "car.ensemble.members: input should be greater than or equal to 1"),
        ("ensemble.optimiser.learning_rate", "1e-3", "car.ensemble.optimiser.learning_rate: input should be a valid"),
        ("ensemble.optimiser.learning_rate", float("inf"), "car.ensemble.optimiser.learning_rate: input should be"),
        ("ensemble.optimiser.betas", [0.9], "car.ensemble.optimiser.betas.1: missing key"),
        ("title", ..., "car.title: missing key"),
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
        ("evaluation.shifts", {"a": SHIFT | {"kind": "end"}}, "car.evaluation.shifts.a.kind: input should be 'starts'"),
        ("evaluation.shifts", {"a b": SHIFT}, "car.evaluation.shifts.a b"),
        ("evaluation.shifts", [SHIFT | {"name": "a"}] * 2, "two shifts are called 'a'"),
        ("evaluation.shifts", {"a": SHIFT | {"behaviour": {"kind": "dqn"}}}, "shifts.a.behaviour: input tag 'dqn'"),
        ("evaluation.shifts", {"a": {"kind": "behaviour", "environment": {"id": "Car"}}}, "a.behaviour: missing key"),
        (
            "evaluation.shifts",
            {"a": SHIFT | {"kind": "behaviour", "behaviour": {"kind": "constant", "action": "left"}}},
            "car.evaluation.shifts.a.behaviour.action: input should be",
        ),
        ("baselines.single_networks.pair", {}, "car.baselines.single_networks.pair"),
        ("baselines.single_networks.two words", SINGLE, "car.baselines.single_networks.two words"),
        ("baselines.single_networks.unequal_bins", SINGLE, "'unequal_bins' has a meaning already"),
        ("baselines.single_networks.wide.epochs", 3, "car.baselines.single_networks.wide.epochs: unknown key"),
        ("baselines.train", ["wide"], "car.baselines.train.0: input should be"),
        ("baselines.pair_epochs", -1, "car.baselines.pair_epochs: input should be greater than or equal to 0"),
        ("addressing.heads", "64-", "car.addressing.heads: it should be a list, but it is '64-'"),
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
        load_experiment(path, "car", "transitions")
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParamsError, match=r"nowhere\.yaml: no such params file"):
        load_experiment(tmp_path / "nowhere.yaml", "car", "transitions")


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ParamsError, match="cannot be read"):
        load_experiment(path, "car", "transitions")


def test_a_whole_section_of_motion_is_read(tmp_path: Path) -> None:
    params = read_motion(tmp_path, MOTION)
    assert params.record is not None
    assert params.record.minutes == MOTION["record"]["minutes"]
    assert params.baselines.phase_functioned.members == 4
    assert params.evaluation.released is None


@pytest.mark.parametrize(
    ("path", "value", "what"),
    [
        ("record.minuts", 2.0, "walk.record.minuts: unknown key"),
        ("record.minutes", 0.0, "walk.record.minutes: input should be greater than 0"),
        ("convert.test_clips", "Walker_jog", "walk.convert.test_clips: it should be a list, but it is"),
        ("convert.test_share", 0.8, "validation_share + test_share must be below 1"),
        ("convert.cycles_share", 0.8, "cycles_share + rows_share + validation_share must be below 1"),
        ("features.target", "relative", "walk.features.target: input should be 'absolute', 'change' or"),
        ("features.joint_input_weight", 0.0, "walk.features.joint_input_weight: input should be greater than 0"),
        ("features.history", 3, "walk.features.history: unknown key"),
        ("features.augmentation.pose_mix", 1.5, "walk.features.augmentation.pose_mix: input should be less than or"),
        ("ensemble.dropout", 1.0, "walk.ensemble.dropout: input should be less than 1"),
        ("ensemble.memebrs", 2, "walk.ensemble.memebrs: unknown key"),
        ("baselines.train", ["pfnn"], "walk.baselines.train.0: input should be"),
        ("baselines.phase_functioned.epochs", 2, "walk.baselines.phase_functioned.epochs: unknown key"),
        ("baselines.learned_blend.optimiser.betas", [0.9], "walk.baselines.learned_blend.optimiser.betas.1: missing"),
        ("evaluation.closed_loop.validation_scripts", 0, "walk.evaluation.closed_loop.validation_scripts: input"),
        ("evaluation.rollouts", {}, "walk.evaluation.rollouts: unknown key"),
        ("evaluation.released", 3, "walk.evaluation.released: input should be a valid string"),
        ("evaluation.released", "elsewhere/pfnn.npz", "walk.evaluation.released: string should match pattern"),
        ("paper_recipe.augmentaton", {}, "walk.paper_recipe.augmentaton: unknown key"),
        ("paper_recipe.features", {"targt": "change"}, "walk.features.targt: unknown key"),
        ("paper_recipe.addressing", {"epoch": 1}, "walk.addressing.epoch: unknown key"),
        ("recipe", "papr", "walk.recipe: input should be 'default' or 'paper', but it is 'papr'"),
    ],
)
def test_a_wrong_value_in_a_section_of_motion_is_one_line_with_the_path_of_its_key(
    tmp_path: Path, path: str, value: Any, what: str
) -> None:
    with pytest.raises(ParamsError) as caught:
        read_motion(tmp_path, changed(path, value, MOTION))
    message = str(caught.value)
    assert what in message
    assert str(tmp_path / "params.yaml") in message
    assert "\n" not in message


def test_the_paper_recipe_of_motion_takes_the_place_of_some_keys(tmp_path: Path) -> None:
    section = MOTION | {
        "paper_recipe": {
            "features": {"augmentation": {"pose_noise": 0.25}},
            "ensemble": {"activation": "tanh"},
            "addressing": {"epochs": 7, "variants": ["plain"]},
        }
    }
    default, paper = load_recipes(write_params(tmp_path / "params.yaml", walk=section), "walk", "motion")
    assert default == read_motion(tmp_path, section)
    assert (paper.features.target, paper.features.joint_input_weight) == ("absolute", 1.0)
    assert dict(paper.features.augmentation) == {"pose_noise": 0.25, "pose_shrink": 0, "pose_mix": 0, "gait_swap": 0}
    assert (paper.ensemble.loss, paper.ensemble.activation, paper.ensemble.dropout) == ("mae", "tanh", 0.0)
    assert paper.ensemble.optimiser.learning_rate == 1e-4
    assert (paper.addressing.epochs, paper.baselines.addressing.epochs) == (7, 7)
    assert paper.baselines.train == default.baselines.train
    path = write_params(tmp_path / "params.yaml", walk=section | {"recipe": "paper"})
    chosen, other = load_recipes(path, "walk", "motion")
    assert chosen.features == paper.features
    assert other.features == default.features
    assert load_experiment(path, "walk", "motion") == chosen


def test_there_are_kinds_of_data_and_the_sections_of_one_are_none_of_another(tmp_path: Path) -> None:
    path = write_params(tmp_path / "params.yaml", walk=MOTION, car=EXAMPLE, jog=3)
    with pytest.raises(ParamsError, match="there is no kind of data 'sound'"):
        load_experiment(path, "walk", "sound")
    with pytest.raises(ParamsError, match=r"walk\.\w+"):
        load_experiment(path, "walk", "transitions")
    with pytest.raises(ParamsError, match=r"car\.\w+"):
        load_recipes(path, "car", "motion")
    with pytest.raises(ParamsError, match="jog: input should be"):
        load_experiment(path, "jog", "motion")


@pytest.mark.parametrize(("load", "what"), [(load_record_params, "record"), (load_source_params, "import")])
def test_an_experiment_without_an_origin_says_what_it_lacks(tmp_path: Path, load: Any, what: str) -> None:
    path = write_params(tmp_path / "params.yaml", walk=MOTION | {"record": None})
    with pytest.raises(ParamsError, match=f"walk: there is nothing to {what}"):
        load(path, "walk", "motion")


def test_the_lists_at_the_top_of_a_file_are_no_experiments(tmp_path: Path) -> None:
    path = write_params(
        tmp_path / "params.yaml", experiments={"walk": {"kind": "motion"}}, imported={"arm": "logs"}, walk=MOTION
    )
    with pytest.raises(ParamsError, match=r"no experiment 'jog' in it \(experiments there: walk\)"):
        load_experiment(path, "jog", "motion")


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"motions": {"walk": "clips"}}, "motions"),
        ({"experiments": ["walk"]}, "a list under 'experiments'"),
        ({"walk": MOTION | {"kind": "motion"}}, "walk.kind"),
        ({"walk": MOTION | {"augmentation": {}}}, "walk.augmentation"),
        ({"walk": MOTION | {"ensemble": MOTION["ensemble"] | {"processes": 2}}}, "walk.ensemble.processes"),
        ({"walk": MOTION | {"walker": {"seed": 0}}}, "walk.walker"),
    ],
)
def test_a_file_of_the_earlier_form_is_one_line_that_says_what_changed(
    tmp_path: Path, changes: dict[str, Any], found: str
) -> None:
    path = write_params(tmp_path / "params.yaml", **{"walk": MOTION} | changes)
    with pytest.raises(ParamsError) as caught:
        load_experiment(path, "walk", "motion")
    assert f"a params file of an earlier form ({found}): 'experiments' is now a mapping" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_section_that_is_given_in_part_keeps_the_other_defaults_of_its_place(tmp_path: Path) -> None:
    section = {
        "title": "Walk",
        "ensemble": {"optimiser": {"learning_rate": 0.5}},
        "baselines": {"phase_functioned": {"optimiser": {"learning_rate": 0.5}}},
    }
    params = read_motion(tmp_path, section)
    assert params.ensemble.optimiser == MotionOptimiser(learning_rate=0.5)
    assert params.baselines.phase_functioned.optimiser == MotionOptimiser(learning_rate=0.5, final_share=1.0)
    assert params.baselines.phase_functioned.weight_penalty == PhaseFunctioned().weight_penalty
    assert params.baselines.learned_blend == LearnedBlend()
    car = read(tmp_path, {"title": "Car", "record": RECORD, "addressing": {"optimiser": {"final_share": 0.5}}})
    assert car.addressing.optimiser.learning_rate == 2e-3


def test_an_experiment_is_its_title_and_its_origin(tmp_path: Path) -> None:
    params = read(tmp_path, {"title": "Car", "record": RECORD})
    assert params.model_dump(exclude={"title", "record"}) == ExperimentParams.model_construct().model_dump(
        exclude={"title", "record"}
    )


@pytest.mark.parametrize(("value", "widths"), [("64-32", (64, 32)), ("8", (8,)), (8, (8,)), ([8, 4], (8, 4)), ([], ())])
def test_widths_are_given_in_a_word_or_in_a_list(tmp_path: Path, value: Any, widths: tuple[int, ...]) -> None:
    assert read(tmp_path, changed("addressing.hidden", value)).addressing.hidden == widths


def test_bins_may_be_made_anew_in_all_epochs(tmp_path: Path) -> None:
    section = changed("ensemble.cluster_epochs", "all")
    assert read(tmp_path, section).ensemble.cluster_epochs == section["ensemble"]["epochs"]
    del section["ensemble"]["epochs"]
    assert read(tmp_path, section).ensemble.cluster_epochs == EnsembleParams().epochs


def test_segments_and_angles_stand_under_their_names(tmp_path: Path) -> None:
    segments = {each["name"]: {key: each[key] for key in each if key != "name"} for each in RECORD["segments"]}
    named = read(tmp_path, changed("record.segments", segments))
    assert named == read(tmp_path, EXAMPLE)
    segments["right"]["behaviour"] = {"kind": "constant", "action": "left"}
    with pytest.raises(ParamsError, match=r"car\.record\.segments\.right\.behaviour\.action: input should be"):
        read(tmp_path, changed("record.segments", segments))
    angles = {"tilt": {"cosine": "c", "sine": "s"}}
    assert read(tmp_path, changed("features.angles", angles)).features.angles[0].name == "tilt"


def overlay(folder: Path, above: Any, name: str = "large.yaml", extends: Any = "params.yaml") -> Path:
    write_params(folder / "params.yaml", car=EXAMPLE)
    return write_params(folder / name, extends=extends, car=above)


def test_a_file_that_extends_another_says_only_what_it_does_otherwise(tmp_path: Path) -> None:
    above = {"title": EXAMPLE["title"], "ensemble": {"epochs": 9, "seeds": [4]}, "evaluation": {"rollouts": RECORDED}}
    path = overlay(tmp_path, above)
    found, base = load_experiment(path, "car", "transitions"), read(tmp_path, EXAMPLE)
    assert found.ensemble == base.ensemble.model_copy(update={"epochs": 9, "seeds": (4,)})
    # Of another kind than the section below it, so nothing of that is mixed in.
    assert found.evaluation.rollouts == RecordedRollouts(kind="recorded", episodes=3, steps=20, seed=0)
    assert found.addressing == base.addressing
    assert [line.partition(":")[0] for line in replaced_keys(path, "car")] == [
        "ensemble.epochs", "ensemble.seeds", "evaluation.rollouts.kind", "evaluation.rollouts.episodes",
        "evaluation.rollouts.steps", "evaluation.rollouts.seed",
    ]  # fmt: skip
    assert replaced_keys(tmp_path / "params.yaml", "car") == []


@pytest.mark.parametrize(
    ("extends", "what"),
    [
        ("nowhere.yaml", "extends: there is no params file"),
        (3, "extends: it should be the name of a params file, but is 3"),
        ("large.yaml", "extends it in turn"),
    ],
)
def test_a_file_that_extends_what_it_cannot_is_one_line(tmp_path: Path, extends: Any, what: str) -> None:
    with pytest.raises(ParamsError, match=what) as caught:
        load_experiment(overlay(tmp_path, {}, extends=extends), "car", "transitions")
    assert str(tmp_path / "large.yaml") in str(caught.value)


@pytest.mark.parametrize("file", sorted((ROOT / "params").glob("*.yaml")), ids=lambda file: file.name)
def test_every_scale_names_the_sections_that_stages_watch(file: Path) -> None:
    """DVC refuses to run a stage whose params are not in the file, if only as `{}`."""
    yaml = YAML(typ="safe", pure=True)
    stages = yaml.load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]
    lists = [names for stage in stages.values() for each in stage["do"]["params"] for names in each.values()]
    watched = {key.removeprefix("${key}.") for names in lists for key in names} - {"source"}
    for name, section in yaml.load(file.read_text(encoding="utf-8")).items():
        if name != "extends":
            assert set(section) == watched


def test_dvc_changes_one_line_of_the_params_and_no_other(tmp_path: Path) -> None:
    changed_file = tmp_path / "params.yaml"
    text = (ROOT / "params.yaml").read_text(encoding="utf-8")
    changed_file.write_text(text, encoding="utf-8")
    apply_overrides(changed_file, ["mountaincar.addressing.epochs=5"])
    before, after = text.splitlines(), changed_file.read_text(encoding="utf-8").splitlines()
    (line,) = (number for number, (old, new) in enumerate(zip(before, after, strict=True)) if old != new)
    assert after[line].strip() == "epochs: 5"


def test_the_same_seed_twice_is_refused() -> None:
    with pytest.raises(ValidationError, match="should be different"):
        EnsembleSection(seeds=(1, 0, 1))
