"""The stages that get data as they are called, and how a stage ends when it cannot finish."""

import os
import re
import signal
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import torch
from example_params import EXAMPLE, MOTION, segment, write_params
from pipeline_clones import warm_interpreter

from addressed_dynamics.base.errors import LogError, ParamsError
from addressed_dynamics.episodes.parquet import load_transitions
from addressed_dynamics.sources.motion.splits import MOTION_SPLITS
from addressed_dynamics.sources.motion.tables import read_columns
from pipeline import convert, record, train_baselines, train_ensemble
from pipeline.stage import Call, available_cores, counted, first_of, median_of, run_stage, training_processes

ROOT = Path(__file__).parents[1]
ENVIRONMENT = os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'src'}"}
LONG = {"shard_transitions": 1000, "segments": [segment("long", {"kind": "random", "mean_hold_steps": 5})]}
LONG["segments"][0]["transitions"] = 2_000_000


def stage(
    name: str, folder: Path, *, stderr: int = subprocess.PIPE, python: str | Path = sys.executable, **sections: Any
) -> subprocess.Popen[str]:
    """Start a stage, by default in an interpreter that gets the signals of its process."""
    params = write_params(folder / "params.yaml", car=EXAMPLE | sections)
    command = [python, "-W", "error", "-m", f"pipeline.{name}", "car", "--params", str(params)]
    return subprocess.Popen(command, cwd=folder, env=ENVIRONMENT, stderr=stderr, text=True, preexec_fn=hear_interrupts)


def hear_interrupts() -> None:
    """Let a new process hear Ctrl-C: a shell's background jobs ignore it, and so would what these tests start there."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def finished(process: subprocess.Popen[str]) -> tuple[int, str]:
    with process:
        _, stderr = process.communicate()
    return process.returncode, stderr


def read_terminal(terminal: int) -> Iterator[str]:
    """Yield all that was said on a terminal, each time more is, until the last process has left it."""
    said = b""
    # At the end a read fails on Linux and is empty elsewhere.
    with suppress(OSError):
        while more := os.read(terminal, 4096):
            said += more
            yield said.decode(errors="replace").replace("\r\n", "\n")


@pytest.mark.slow
def test_record_and_convert_make_tables_of_an_experiment(tmp_path: Path) -> None:
    for name in ("record", "convert"):
        status, stderr = finished(stage(name, tmp_path, python=warm_interpreter() / "python"))
        assert status == 0, stderr
    total = sum(each["transitions"] for each in EXAMPLE["record"]["segments"])
    assert len(load_transitions(tmp_path / "data" / "tables" / "car")) == total
    assert (tmp_path / "data" / "figures" / "car" / "convert" / "data.json").exists()
    assert [path.name for path in (tmp_path / "data" / "raw").iterdir()] == ["car"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "status", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]
)
def test_an_interrupted_recording_is_one_line_and_leaves_nothing_under_its_name(
    tmp_path: Path, number: signal.Signals, status: int, word: str
) -> None:
    # On a terminal, as a person would see it: only there is progress reported at once.
    terminal, other_end = os.openpty()
    termios.tcsetwinsize(terminal, (24, 120))
    stderr, counted = "", False
    with stage("record", tmp_path, stderr=other_end, record=LONG) as process:
        os.close(other_end)
        for stderr in read_terminal(terminal):
            if not counted and re.search(r"[1-9]\S*/2\.00M", stderr):
                counted = True
                process.send_signal(number)
    os.close(terminal)
    assert process.returncode == status, stderr
    assert "Traceback" not in stderr
    # A signal may come after a file was opened and before anyone has it to close; Python says so, as tests ask it to.
    lines = [line for line in stderr.splitlines() if "ResourceWarning: unclosed file" not in line]
    assert lines[-1].startswith(f"{word}; what was recorded stays in data/raw/.car.partial")
    assert not (tmp_path / "data" / "raw" / "car").exists()
    assert list((tmp_path / "data" / "raw" / ".car.partial").glob("long-env00-*"))


@pytest.mark.slow
def test_convert_without_a_recording_is_one_line(tmp_path: Path) -> None:
    status, stderr = finished(stage("convert", tmp_path, python=warm_interpreter() / "python"))
    assert status == 1
    assert stderr.splitlines()[-1] == (
        "error: data/raw/car: expected MCAP logs (*.mcap), but there are none; run the record stage first"
    )
    assert "Traceback" not in stderr
    assert not (tmp_path / "data" / "tables" / "car").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "forbidden"),
    [
        ("record", ["mlflow", "torch", "gymnasium", "pyarrow"]),
        ("convert", ["mlflow", "torch", "stable_baselines3", "gymnasium"]),
        ("import_data", ["mlflow", "torch", "gymnasium"]),
    ],
)
def test_a_stage_does_not_import_what_it_does_not_use(name: str, forbidden: list[str]) -> None:
    check = f"import sys, pipeline.{name}; sys.exit(', '.join(set({forbidden}) & set(sys.modules)) or None)"
    done = subprocess.run([sys.executable, "-c", check], env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def call(monkeypatch: pytest.MonkeyPatch, main: Callable[[Call], str | None], *more: str) -> int | str | None:
    """Run `main` as a stage in this process, with `more` options, and return its status."""
    monkeypatch.setattr(sys, "argv", ["stage", "car", "--params", "some.yaml", *more])
    previous = signal.getsignal(signal.SIGTERM)
    try:
        with pytest.raises(SystemExit) as ended:
            run_stage(main)
    finally:
        signal.signal(signal.SIGTERM, previous)
    return ended.value.code


@pytest.fixture
def somewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A working folder with a params file in which there is nothing."""
    monkeypatch.chdir(tmp_path)
    Path("some.yaml").write_text("{}\n")


@pytest.mark.usefixtures("somewhere")
def test_a_stage_gets_its_options_and_ends_well(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Call] = []
    assert call(monkeypatch, lambda of: calls.append(of)) == 0
    assert call(monkeypatch, lambda of: calls.append(of), "--kind", "motion", "--path", "logs/a.npz") == 0
    assert calls == [
        Call("car", Path("some.yaml"), "transitions", Path("data/raw/car")),
        Call("car", Path("some.yaml"), "motion", Path("logs/a.npz")),
    ]


def test_a_stage_says_which_params_another_file_takes_the_place_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_params(tmp_path / "params.yaml", car=EXAMPLE)
    above = {"title": EXAMPLE["title"], "ensemble": {"epochs": 9}}
    write_params(tmp_path / "some.yaml", extends="params.yaml", car=above)
    assert call(monkeypatch, lambda _: None) == 0
    assert capsys.readouterr().err == "some.yaml takes the place of ensemble.epochs: 2 -> 9\n"


@pytest.mark.usefixtures("somewhere")
def test_project_errors_and_full_disks_are_one_line_and_bugs_are_not_hidden(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def raising(error: BaseException) -> Callable[[Call], None]:
        def main(of: Call) -> None:
            error.add_note(f"while recording {of.experiment} with {of.params_file}")
            raise error

        return main

    assert call(monkeypatch, raising(LogError("a.mcap: damaged"))) == 1
    assert capsys.readouterr().err == "error: a.mcap: damaged; while recording car with some.yaml\n"
    assert call(monkeypatch, raising(OSError(28, "No space left on device", "t.parquet"))) == 1
    assert capsys.readouterr().err.startswith("error: [Errno 28] No space left on device: 't.parquet'; while")
    assert call(monkeypatch, raising(KeyboardInterrupt())) == 130
    assert capsys.readouterr().err == "interrupted; while recording car with some.yaml\n"
    with pytest.raises(ZeroDivisionError):
        call(monkeypatch, raising(ZeroDivisionError()))


@pytest.mark.usefixtures("somewhere")
def test_sigterm_cleans_up_like_ctrl_c(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    cleaned = []

    def main(*_: Any) -> None:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            signal.pause()
        finally:
            cleaned.append(True)

    assert call(monkeypatch, main) == 143
    assert cleaned == [True]
    assert capsys.readouterr().err == "terminated\n"


def test_the_number_of_trainings_at_the_same_time_is_a_setting_of_the_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ADDRESSED_DYNAMICS_PROCESSES", raising=False)
    assert training_processes() == available_cores()
    assert training_processes(gpu=True) == 1
    monkeypatch.setenv("ADDRESSED_DYNAMICS_PROCESSES", "3")
    assert training_processes() == training_processes(gpu=True) == 3
    for wrong in ("0", "-1", "two", ""):
        monkeypatch.setenv("ADDRESSED_DYNAMICS_PROCESSES", wrong)
        with pytest.raises(ParamsError, match=f"should be a positive whole number, but is '{wrong}'"):
            training_processes()


def test_a_kind_of_data_that_does_not_exist_is_one_line(
    motion_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(monkeypatch, convert.main, "--kind", "sound") == 1
    assert capsys.readouterr().err.startswith("error: there is no kind of data 'sound': a kind is a package")
    assert list(motion_folder.iterdir()) == [motion_folder / "some.yaml"]


@pytest.fixture
def motion_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder with the params of an experiment of motion, in which stages are called."""
    monkeypatch.chdir(tmp_path)
    write_params(tmp_path / "some.yaml", car=MOTION)
    return tmp_path


def test_a_gpu_that_is_asked_for_and_not_there_is_one_line_before_anything_is_read(
    motion_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("ADDRESSED_DYNAMICS_DEVICE", "cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    for setting in ("use_deterministic_algorithms", "set_flush_denormal"):  # they hold for the whole process
        monkeypatch.setattr(torch, setting, lambda *_, **__: None)
    for stage in (train_ensemble, train_baselines):
        assert call(monkeypatch, stage.main, "--kind", "motion") == 1
        error = capsys.readouterr().err.removesuffix("\n")
        assert error.startswith("error: ADDRESSED_DYNAMICS_DEVICE asks for 'cuda:0', but torch ")
        assert error.endswith("or unset ADDRESSED_DYNAMICS_DEVICE for the CPU")
        assert "\n" not in error
    assert list(motion_folder.iterdir()) == [motion_folder / "some.yaml"]


@pytest.mark.slow
def test_clips_are_made_up_and_imported(motion_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert call(monkeypatch, record.main, "--kind", "motion") == 0
    assert [path.name for path in (motion_folder / "data" / "raw").iterdir()] == ["car"]
    assert call(monkeypatch, convert.main, "--kind", "motion") == 0
    splits = read_columns(motion_folder / "data" / "tables" / "car", ["split"])["split"]
    # As few minutes as will do: some frames are left for everything that they are needed for.
    assert set(splits.tolist()) == set(MOTION_SPLITS)
    assert (motion_folder / "data" / "figures" / "car" / "convert" / "data.json").exists()


def missing(source: Path) -> None:
    assert not source.exists()


def text_file(source: Path) -> None:
    source.write_text("no arrays\n")


def empty_file(source: Path) -> None:
    source.touch()


def empty_folder(source: Path) -> None:
    source.mkdir()


def clip_without_side_files(source: Path) -> None:
    source.mkdir()
    (source / "walk.bvh").write_text("HIERARCHY\n")
    (source / "walk.phase").write_text("0.5\n")


@pytest.mark.parametrize("make", [missing, text_file, empty_file, empty_folder, clip_without_side_files])
def test_a_bad_source_of_motion_is_one_line_and_nothing_is_half_written(
    motion_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    make: Callable[[Path], None],
) -> None:
    make(motion_folder / "database.npz")
    assert call(monkeypatch, convert.main, "--kind", "motion", "--path", "database.npz") == 1
    *_, last = capsys.readouterr().err.splitlines()
    assert last.startswith("error: database.npz: ")
    assert [path for path in motion_folder.rglob("*") if "data" in path.parts and path.is_file()] == []
    assert not (motion_folder / "data" / "tables" / "car").exists()


def test_what_cannot_be_made_up_is_one_line(
    motion_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for walker, what in {None: "it has no 'record'", 0.5: "has no gait cycle"}.items():
        section = MOTION | {"record": walker and {"minutes": walker, "seed": 0}}
        write_params(motion_folder / "some.yaml", car=section)
        assert call(monkeypatch, record.main, "--kind", "motion") == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("error: ")
        assert what in line
        assert not (motion_folder / "data" / "raw" / "car").exists()


TRAIN_BASELINES = """
import shutil
from pathlib import Path
from pipeline import convert, record, train_baselines
from pipeline.stage import Call
call = Call("car", Path("params.yaml"), "motion", Path("data/raw/car"))
record.main(call)
convert.main(call)
for name in ("first", "second"):
    train_baselines.main(call)
    shutil.copytree("data/models/car", f"{name}/models")
    shutil.copytree("data/figures/car", f"{name}/figures")
"""
"""In one process, which gets ready to train once."""


@pytest.mark.slow
def test_all_baselines_of_motion_are_trained_again_to_the_same_bytes(tmp_path: Path) -> None:
    names = ["phase_functioned", "learned_blend", "total_parameters", "same_size", "other_recipe"]
    write_params(tmp_path / "params.yaml", car=MOTION | {"baselines": MOTION["baselines"] | {"train": names}})
    environment = ENVIRONMENT | {"OMP_NUM_THREADS": "1", "ADDRESSED_DYNAMICS_PROCESSES": "1"}
    done = subprocess.run(
        [warm_interpreter() / "python", "-W", "error", "-c", TRAIN_BASELINES],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    written = [
        {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (tmp_path / "first", tmp_path / "second")
    ]
    first, second = written
    assert first == second
    folders = {Path(name).parts[2] for name in first if name.endswith(".safetensors")}
    assert folders == {"phase_functioned", "learned_blend", "total_parameters", "same_size", "paper_recipe"}
    assert {"figures/baselines/baselines.json", "figures/baselines/baselines.csv"} <= set(first)
    assert not [path for path in (tmp_path / ".checkpoints").rglob("*") if path.is_file()]


@pytest.mark.usefixtures("somewhere")
def test_a_stage_ends_in_a_line_that_says_what_came_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(monkeypatch, lambda _: "3 logs are in data/raw/car") == 0
    assert capsys.readouterr().err == "car: 3 logs are in data/raw/car\n"


def test_results_are_said_in_words() -> None:
    assert counted({"train": {"clips": 2, "rows": 4070}, "test": {"rows": 91}}) == "4,070 for train, 91 for test"
    assert first_of({"one_step": 1.0, "two": 0.123456, "three": 3.0, "four": 4.0}, 2) == "one step 1, two 0.1235"
    assert median_of({"a": {"loss": 0.5}}, "loss") == "0.5"
    assert median_of({"a": {"loss": 0.5}, "b": {"loss": 1.5}, "c": {}}, "loss") == "1 (median of 2)"


def test_numpy_has_one_thread_in_a_stage_whatever_there_is() -> None:
    code = "import pipeline, numpy, threadpoolctl as t; print({each['num_threads'] for each in t.threadpool_info()})"
    settings = ENVIRONMENT | {"OPENBLAS_NUM_THREADS": "2"}

    said = subprocess.run([sys.executable, "-c", code], env=settings, capture_output=True, text=True, check=True).stdout

    assert said == "{1}\n"


@pytest.mark.parametrize("package", ["pipeline", "addressed_dynamics.cli"])
def test_ctrl_c_while_modules_are_imported_shows_no_traceback(package: str) -> None:
    code = f"import {package}, os, signal; os.kill(os.getpid(), signal.SIGINT)"

    ended = subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, capture_output=True, text=True, check=False)

    assert (ended.returncode, ended.stderr) == (-signal.SIGINT, "")
