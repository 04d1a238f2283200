"""`inspect`, `new` and `remove`: from somebody's files to an experiment, and back."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from builders import RUN, car_transitions, write_log
from dvc_settings import apply_overrides
from foreign_logs import json_log, states_and_commands
from ruamel.yaml import YAML
from stage_dependencies import ROOT

from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.cli import main as cli
from addressed_dynamics.cli.new import section_text
from addressed_dynamics.episodes.transitions import LEARNED
from addressed_dynamics.importing.importer import wanted_signals
from addressed_dynamics.importing.looking_at_tables import MOST_FILES
from addressed_dynamics.importing.units import read_samples
from addressed_dynamics.sources.transitions.conversion import convert_recording


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the params file of the repository and somebody's logs; the commands run in it."""
    (tmp_path / "params.yaml").write_bytes((ROOT / "params.yaml").read_bytes())
    (tmp_path / "bags").mkdir()
    for number in range(2):
        log = json_log(states_and_commands(10.0, start=(100 + 1000 * number) * 10**9))
        (tmp_path / "bags" / f"bag_{number}.mcap").write_bytes(log)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, *arguments: str) -> tuple[int, str, str]:
    """Run the command line in this process: its exit status and what it wrote."""
    monkeypatch.setattr(sys, "argv", ["addressed-dynamics", *arguments])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    out, err = capsys.readouterr()
    return int(caught.value.code or 0), out, err


def test_a_new_experiment_is_one_that_the_pipeline_reads_and_its_undo_leaves_nothing(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = (folder / "params.yaml").read_bytes()
    status, out, err = run(capsys, monkeypatch, "new", "arm-2", "bags", "--yes")
    assert (status, err) == (0, "")
    assert out.splitlines()[-1] == "next: dvc repro report@arm-2"
    params = load_experiment(folder / "params.yaml", "arm-2", "transitions")
    assert params.source.files == ("bags/*.mcap",)
    assert params.title == "Arm 2"
    assert (params.ensemble.horizon, params.ensemble.linear, params.ensemble.early_stopping) == (4, True, 15)
    assert (params.features.history, params.ensemble.members) == ("auto", 2)
    assert params.evaluation.deliver == "best"
    text = (folder / "params.yaml").read_text()
    apply_overrides(folder / "params.yaml", ["arm-2.ensemble.epochs=5"])
    changed = (folder / "params.yaml").read_text().splitlines()
    assert len([line for line, old in zip(changed, text.splitlines(), strict=True) if line != old]) == 1
    assert run(capsys, monkeypatch, "remove", "arm-2")[0] == 0
    assert (folder / "params.yaml").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["new", "arm", "bags", "--action", "/cmd.speed"], "there is no field '/cmd.speed'"),
        (["new", "acrobot", "bags", "--yes"], "there is a 'acrobot' in it already"),
        (["new", "2arm", "bags", "--yes"], "cannot be the name of an experiment"),
        (["new", "arm", "nowhere", "--yes"], "there is no such file or folder"),
        (["new", "2arm", "nowhere"], "cannot be the name of an experiment"),
        (["new", "acrobot", "nowhere"], "there is a 'acrobot' in it already"),
        (["new", "arm", "bags", "--yes", "--rate", "0.01"], "no episode is worth training on"),
        (["new", "arm", "bags", "--yes", "--rate", "-1"], "source.rate_hz"),
        (["remove", "acrobot"], "was not made by 'addressed-dynamics new'"),
        (["inspect", "bags", "--rate", "5", "--observation", "/x.y"], "there is no field '/x.y'"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_leaves_the_params_as_they_were(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, arguments: list[str], what: str
) -> None:
    before = sorted((path, path.read_bytes()) for path in folder.rglob("*") if path.is_file())
    status, _, err = run(capsys, monkeypatch, *arguments)
    assert status == 1
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert what in err
    assert sorted((path, path.read_bytes()) for path in folder.rglob("*") if path.is_file()) == before


def test_an_interruption_while_it_writes_leaves_the_params_as_they_were(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = (folder / "params.yaml").read_bytes()

    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupted)
    run(capsys, monkeypatch, "new", "arm", "bags", "--yes")
    monkeypatch.undo()
    assert (folder / "params.yaml").read_bytes() == before
    assert sorted(path.name for path in folder.iterdir()) == ["bags", "params.yaml"]


def test_logs_of_transitions_are_taken_as_they_are(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "own").mkdir()
    write_log(folder / "own" / "a.mcap", car_transitions([20, 600]))
    before = (folder / "params.yaml").read_bytes()
    status, out, _ = run(capsys, monkeypatch, "new", "car", "own")
    assert status == 0
    assert out.splitlines()[-1] == "next: dvc repro report@car"
    document = YAML(typ="safe").load((folder / "params.yaml").read_text())
    assert document["experiments"]["car"] == {"kind": "transitions", "raw": "own"}
    assert "car" not in (document["imported"] or {})
    params = load_experiment(folder / "params.yaml", "car", "transitions")
    assert (params.source, params.record, params.convert.split) == (None, None, "blocks")
    assert run(capsys, monkeypatch, "remove", "car")[0] == 0
    assert (folder / "params.yaml").read_bytes() == before
    (folder / "own" / "deep").mkdir()
    write_log(folder / "own" / "deep" / "b.mcap", car_transitions([20]))
    status, _, err = run(capsys, monkeypatch, "new", "car", "own")
    assert (status, err.count("\n")) == (1, 1)
    assert "logs of transitions have to be in one folder, but these are in 2" in err


def test_logs_of_predictions_are_taken_only_where_somebody_wants_them(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "own").mkdir()
    write_log(folder / "own" / "a.mcap", car_transitions([20, 30]))
    write_log(folder / "own" / "b.mcap", car_transitions([20], seed=1), run=replace(RUN, environment=LEARNED))
    before = (folder / "params.yaml").read_bytes()
    status, out, err = run(capsys, monkeypatch, "new", "car", "own", "--yes")
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert "own/b.mcap: recorded in a learned model" in err
    assert "say --predictions" in err
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr(cli.typer, "confirm", lambda *_, **__: False)
    assert run(capsys, monkeypatch, "new", "car", "own")[0] == 1
    assert (folder / "params.yaml").read_bytes() == before
    monkeypatch.setattr(cli.typer, "confirm", lambda *_, **__: True)
    assert run(capsys, monkeypatch, "new", "car", "own")[0] == 0
    assert run(capsys, monkeypatch, "new", "car2", "own", "--yes", "--predictions")[0] == 0
    for name in ("car", "car2"):
        params = load_experiment(folder / "params.yaml", name, "transitions").convert
        assert params.predictions
        convert_recording(folder / "own", folder / name, folder / "reports", params, cores=1, progress=lambda _: None)


def test_what_cannot_be_guessed_is_asked_for(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    messages = [
        ("/out", at, {"level": message["torque"]}) if topic == "/cmd" else (topic, at, message)
        for topic, at, message in states_and_commands(10.0)
    ]
    (folder / "bags" / "bag_0.mcap").write_bytes(json_log(messages))
    (folder / "bags" / "bag_1.mcap").unlink()
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True)
    asked = list[str]()

    def answer(question: str) -> str:
        asked.append(question)
        return "4"

    monkeypatch.setattr(cli.typer, "prompt", answer)
    monkeypatch.setattr(cli.typer, "confirm", lambda *_, **__: True)
    status, _, _ = run(capsys, monkeypatch, "new", "arm", "bags")
    assert status == 0
    assert "  4  /out.level" in asked[0]
    action = load_experiment(folder / "params.yaml", "arm", "transitions").source.action
    assert action.continuous["level"].field == "/out.level"
    status, _, err = run(capsys, monkeypatch, "new", "arm2", "bags", "--yes")
    assert "the files do not say it; give --action" in err


@pytest.mark.usefixtures("folder")
def test_inspect_shows_what_can_be_imported_and_what_it_is_good_for(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    status, out, _ = run(capsys, monkeypatch, "inspect", "bags")
    assert status == 0
    for word in ("bag_0.mcap", "/joint_states.position[0]", "12.5 Hz", "Guessed rate", "2 to use", "torque"):
        assert word in out
    status, out, _ = run(capsys, monkeypatch, "inspect", "bags", "--json", "--rate", "10")
    found = json.loads(out)
    assert found["totals"]["files"] == 2
    assert found["import"]["source"]["rate_hz"] == 10
    assert [each["verdict"] for each in found["import"]["assessment"]["episodes"]] == ["use", "use"]


def test_what_float32_cannot_hold_gets_an_offset_and_what_the_import_would_refuse_is_told(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = "".join(f"{i / 10},{5301234 + (i * i % 97) / 100},{i % 3}\n" for i in range(100))
    (folder / "map.csv").write_text(f"t,north,torque\n{rows}")
    assert run(capsys, monkeypatch, "new", "map", "map.csv", "--yes")[0] == 0
    north = load_experiment(folder / "params.yaml", "map", "transitions").source.observation["north"]
    assert north.offset == 5301234.0


@pytest.mark.parametrize("name", ["lab [1]", "c: d", "# h", "it's", "{x}", "123", "null", "äö ü"])
def test_folders_may_be_called_anything(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (folder / "bags").rename(folder / name)
    before = (folder / "params.yaml").read_bytes()
    assert run(capsys, monkeypatch, "new", "arm", name, "--yes")[0] == 0
    assert YAML(typ="safe").load(folder / "params.yaml")["imported"]["arm"] == name
    source = load_experiment(folder / "params.yaml", "arm", "transitions").source
    assert [each for each, _ in read_samples(source, wanted_signals(source))] == [
        f"{name}/bag_0.mcap", f"{name}/bag_1.mcap"]  # fmt: skip
    assert run(capsys, monkeypatch, "remove", "arm")[0] == 0
    assert (folder / "params.yaml").read_bytes() == before


def test_a_file_is_not_a_pattern_for_others(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "bags" / "bag_0.mcap").rename(folder / "bags" / "b*.mcap")
    fields = ("--observation", "/joint_states.position", "--action", "/cmd.torque")
    assert run(capsys, monkeypatch, "new", "arm", "bags/b*.mcap", "--yes", *fields)[0] == 0
    source = load_experiment(folder / "params.yaml", "arm", "transitions").source
    assert [each for each, _ in read_samples(source, wanted_signals(source))] == ["bags/b*.mcap"]


def test_of_many_tables_it_is_said_how_many_were_looked_at(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{i * i % 7},{i % 3}\n" for i in range(25))
    for number in range(MOST_FILES + 1):
        (tmp_path / f"{number:03d}.csv").write_text(f"q,u\n{rows}")
    _, out, _ = run(capsys, monkeypatch, "inspect", ".", "--rate", "20")
    assert f"These are of the first {MOST_FILES} files or episodes alone." in out
    (tmp_path / "000.csv").unlink()
    assert "alone" not in run(capsys, monkeypatch, "inspect", ".", "--rate", "20")[1]


def test_files_in_which_nothing_can_be_read_are_refused_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.mcap").write_bytes(json_log([("/q", 100, b"{")]))
    (tmp_path / "params.yaml").write_text("experiments: {}\nimported: {}\n")
    status, _, err = run(capsys, monkeypatch, "new", "arm", "a.mcap", "--yes")
    assert (status, err.count("\n")) == (1, 1)
    assert "a.mcap: there is nothing in the files that could be imported (Expecting property name" in err


@pytest.mark.parametrize("command", ["inspect", "new"])
def test_a_folder_that_nobody_may_look_into_is_named(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    def refuse(_: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("os.listdir", refuse)
    status, out, err = run(capsys, monkeypatch, command, *(["arm"] if command == "new" else []), str(folder / "bags"))
    assert (status, out) == (1, "")
    assert err == f"error: {folder}/bags: it cannot be read (Permission denied); ask whoever owns it, or copy it\n"


@pytest.mark.parametrize(
    ("lengths", "expected"),
    [([999], {"split": "blocks", "validation_share": 0.2}), ([1600], {"split": "blocks"}), ([90] * 12, {})],
)
def test_a_short_record_has_more_than_one_block_for_validation(lengths: list[int], expected: dict[str, Any]) -> None:
    section = YAML(typ="safe").load(section_text("dryer", (), lengths))
    assert section["convert"] == expected
