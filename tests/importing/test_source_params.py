"""The section `source`, and that an experiment has either it or a recording plan."""

import copy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from example_params import EXAMPLE, write_params
from foreign_logs import SOURCE, json_log, save, states_and_commands
from ruamel.yaml import YAML

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.params.experiments import load_experiment, load_record_params, load_source_params
from addressed_dynamics.base.params.recording import RecordParams
from addressed_dynamics.base.params.source import EXAMPLES
from addressed_dynamics.sources.transitions.reading import read_transitions
from pipeline import import_data, record
from pipeline.stage import Call

ROOT = Path(__file__).parents[2]
WITHOUT_RECORD = {key: value for key, value in EXAMPLE.items() if key != "record"}


def params_file(folder: Path, **sections: Any) -> Path:
    return write_params(folder / "params.yaml", car=WITHOUT_RECORD | sections)


@pytest.mark.parametrize(
    ("path", "value", "what"),
    [
        ("kind", "rosbag", "car.source: input tag 'rosbag'"),
        ("files", [], "car.source.files: "),
        ("observation.joint.field", "", "car.source.observation.joint.field: "),
        ("observation.joint.units", "rad", "car.source.observation.joint.units: unknown key"),
        ("action.discrete", {"field": "/a.b", "names": ["x"]}, "either continuous or discrete; give one of the two"),
        ("rate_hz", 0.0, "car.source.rate_hz: input should be greater than 0"),
        ("episode", {"by": "gap"}, "car.source.episode.seconds: missing key"),
        ("episode", {}, "car.source.episode: missing key 'by'"),
        ("episode", {"by": "column", "column": "c"}, "car.source.episode: input tag 'column'"),
        ("min_length", 1, "car.source.min_length: input should be greater than or equal to 2"),
        ("time", "wall", "car.source.time: input should be 'log', 'publish' or 'header'"),
        ("topics", {"/a": {"hold": True, "tolerance_s": 1.0}}, "may be of any age; leave out 'tolerance_s' or 'hold'"),
    ],
)
def test_a_wrong_value_in_a_source_is_one_line_with_the_path_of_its_key(
    tmp_path: Path, path: str, value: Any, what: str
) -> None:
    section = copy.deepcopy(SOURCE)
    *parents, last = path.split(".")
    place: Any = section
    for key in parents:
        place = place[key]
    place[last] = value
    with pytest.raises(ParamsError) as caught:
        load_experiment(params_file(tmp_path, source=section), "car", "transitions")
    assert what in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_experiment_is_not_both_recorded_and_imported(tmp_path: Path) -> None:
    with pytest.raises(ParamsError, match="either 'record' or 'source', but this one has both"):
        load_experiment(params_file(tmp_path, record=EXAMPLE["record"], source=SOURCE), "car", "transitions")
    assert load_experiment(params_file(tmp_path), "car", "transitions").source is None


def car(params: Path) -> Call:
    """What the stages are called with."""
    return Call("car", params, "transitions", Path("data/raw/car"))


def test_the_stage_of_the_other_kind_says_which_one_to_run(tmp_path: Path) -> None:
    imported = params_file(tmp_path, source=SOURCE)
    with pytest.raises(ParamsError, match="car: there is nothing to record, because it has no 'record'"):
        record.main(car(imported))
    assert load_source_params(imported, "car", "transitions").kind == "mcap"
    recorded = params_file(tmp_path, record=EXAMPLE["record"])
    with pytest.raises(ParamsError, match="car: there is nothing to import, because it has no 'source'"):
        import_data.main(car(recorded))
    assert isinstance(load_record_params(recorded, "car", "transitions"), RecordParams)


def test_the_stage_starts_without_the_libraries_that_take_seconds_to_import() -> None:
    check = "import sys, pipeline.import_data; print({'torch', 'mlflow', 'gymnasium', 'minari'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", check], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_the_stage_leaves_whole_recordings_or_the_one_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    params = params_file(tmp_path, source=SOURCE)
    save(tmp_path, a=json_log(states_and_commands()))
    import_data.main(car(params))
    before = read_transitions(tmp_path / "data" / "raw" / "car")
    save(tmp_path, b=json_log(states_and_commands())[:-50])
    with pytest.raises(Exception, match=r"b\.mcap: byte"):
        import_data.main(car(params))
    assert len(read_transitions(tmp_path / "data" / "raw" / "car")) == len(before) == 9
    assert [each.name for each in (tmp_path / "data" / "raw").iterdir()] == ["car"]


@pytest.mark.parametrize(
    ("files", "rate_hz", "words"),
    [
        (1, 10.0, "transitions were imported; "),
        (1, 100.0, "imported with one warning; "),
        (2, 100.0, "with 2 warnings; "),
    ],
)
def test_the_stage_says_how_many_warnings_there_were_and_the_first_in_full(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    files: int,
    rate_hz: float,
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    save(tmp_path, **dict(zip("ab"[:files], [json_log(states_and_commands())] * files, strict=True)))
    line = import_data.main(car(params_file(tmp_path, source=SOURCE | {"rate_hz": rate_hz})))
    assert words in line
    said = [each for each in capsys.readouterr().err.splitlines() if "warning" in each]
    if rate_hz == 10.0:
        assert said == []
    else:
        (first,) = said
        assert first.startswith(
            "car: warning: logs/a.mcap: the clock ticks at 100 Hz, but /joint_states has 20 messages"
        )
        assert first.endswith("lower rate_hz")


def test_one_pattern_of_files_may_stand_alone(tmp_path: Path) -> None:
    file = params_file(tmp_path, source=SOURCE | {"files": "logs/*.mcap"})
    assert load_source_params(file, "car", "transitions").files == ("logs/*.mcap",)


def test_exogenous_inputs_cannot_be_asked_of_an_environment(tmp_path: Path) -> None:
    section = SOURCE | {"exogenous": {"wind": {"field": "/cmd.wind"}}}
    rollouts = WITHOUT_RECORD["evaluation"]["rollouts"]
    assert rollouts["kind"] == "environment"
    with pytest.raises(ParamsError, match=r"^[^\n]*no environment tells; set evaluation.rollouts to 'kind: recorded'"):
        load_experiment(params_file(tmp_path, source=section), "car", "transitions")
    recorded = {"rollouts": {"kind": "recorded"}}
    found = load_experiment(params_file(tmp_path, source=section, evaluation=recorded), "car", "transitions")
    assert list(found.source.exogenous) == ["wind"]


def test_all_missing_keys_of_a_source_are_named_at_once_with_an_example_of_its_kind(tmp_path: Path) -> None:
    section = {key: value for key, value in SOURCE.items() if key not in ("rate_hz", "min_length", "reward")}
    with pytest.raises(ParamsError) as caught:
        load_experiment(params_file(tmp_path, source=section | {"episode": {"by": "gap"}}), "car", "transitions")
    assert (
        "car.source: missing keys: reward, min_length, rate_hz, episode.seconds; for example {kind: mcap, files: "
        in str(caught.value)
    )


@pytest.mark.parametrize("kind", EXAMPLES)
def test_the_examples_of_sources_are_sources(tmp_path: Path, kind: str) -> None:
    example = YAML(typ="safe", pure=True).load(f"{{kind: {kind}, {EXAMPLES[kind]}}}")
    assert load_source_params(params_file(tmp_path, source=example), "car", "transitions").kind == kind


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        (
            {"clock": {"column": "t", "frame": "f"}},
            "car.source.clock: a clock is a time or counts rows; give one of the",
        ),
        ({"clock": {}}, "car.source.clock: a clock is a time or counts rows"),
        ({"separator": ",,"}, "car.source.separator: "),
        ({"decimal": ","}, "car.source: separator and decimal are both ','"),
        ({"episode": {"by": "end"}}, "car.source: episode: {by: end} needs a field"),
    ],
)
def test_choices_of_tables_that_contradict_each_other_are_refused(
    tmp_path: Path, changes: dict[str, Any], what: str
) -> None:
    section = YAML(typ="safe", pure=True).load(f"{{kind: csv, {EXAMPLES['csv']}}}") | changes
    with pytest.raises(ParamsError) as caught:
        load_experiment(params_file(tmp_path, source=section), "car", "transitions")
    assert what in str(caught.value)


def test_a_minari_dataset_knows_its_ends(tmp_path: Path) -> None:
    section = YAML(typ="safe", pure=True).load(f"{{kind: minari, {EXAMPLES['minari']}}}") | {"terminated": "x"}
    with pytest.raises(ParamsError, match="leave out terminated and truncated"):
        load_experiment(params_file(tmp_path, source=section), "car", "transitions")
