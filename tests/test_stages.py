"""The stages `record` and `convert` as they are called, and how a stage ends when it cannot finish."""

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
from example_params import EXAMPLE, segment, write_params

from addressed_dynamics.errors import LogError
from addressed_dynamics.tables import load_transitions
from pipeline.common import run_stage

ROOT = Path(__file__).parents[1]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}
LONG = {"shard_transitions": 1000, "segments": [segment("long", {"kind": "random", "mean_hold_steps": 5})]}
LONG["segments"][0]["transitions"] = 2_000_000


def stage(name: str, folder: Path, *, stderr: int = subprocess.PIPE, **sections: Any) -> subprocess.Popen[str]:
    params = write_params(folder / "params.yaml", car=EXAMPLE | sections)
    command = [sys.executable, "-W", "error", "-m", f"pipeline.{name}", "--experiment", "car", "--params", str(params)]
    return subprocess.Popen(command, cwd=folder, env=ENVIRONMENT, stderr=stderr, text=True)


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
        status, stderr = finished(stage(name, tmp_path))
        assert status == 0, stderr
    total = sum(each["transitions"] for each in EXAMPLE["record"]["segments"])
    assert len(load_transitions(tmp_path / "data" / "tables" / "car")) == total
    assert (tmp_path / "data" / "reports" / "car" / "data.json").exists()
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
    assert stderr.splitlines()[-1].startswith(f"{word}; what was recorded stays in data/raw/.car.partial")
    assert not (tmp_path / "data" / "raw" / "car").exists()
    assert list((tmp_path / "data" / "raw" / ".car.partial").glob("long-env00-*"))


@pytest.mark.slow
def test_convert_without_a_recording_is_one_line(tmp_path: Path) -> None:
    status, stderr = finished(stage("convert", tmp_path))
    assert status == 1
    assert stderr.splitlines()[-1] == (
        "error: data/raw/car: expected MCAP logs (*.mcap), but there are none; run the record stage first"
    )
    assert "Traceback" not in stderr
    assert not (tmp_path / "data" / "tables" / "car").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "forbidden"), [("record", ["mlflow"]), ("convert", ["mlflow", "torch", "stable_baselines3", "gymnasium"])]
)
def test_a_stage_does_not_import_what_it_does_not_use(name: str, forbidden: list[str]) -> None:
    check = f"import sys, pipeline.{name}; sys.exit(', '.join(set({forbidden}) & set(sys.modules)) or None)"
    done = subprocess.run([sys.executable, "-c", check], env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def call(monkeypatch: pytest.MonkeyPatch, main: Callable[[str, Path], None]) -> int | str | None:
    """Run `main` as a stage in this process and return its status."""
    monkeypatch.setattr(sys, "argv", ["stage", "--experiment", "car", "--params", "some.yaml"])
    previous = signal.getsignal(signal.SIGTERM)
    try:
        with pytest.raises(SystemExit) as ended:
            run_stage(main)
    finally:
        signal.signal(signal.SIGTERM, previous)
    return ended.value.code


def test_a_stage_gets_its_options_and_ends_well(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    assert call(monkeypatch, lambda experiment, params: calls.append((experiment, params))) == 0
    assert calls == [("car", Path("some.yaml"))]


def test_project_errors_and_full_disks_are_one_line_and_bugs_are_not_hidden(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def raising(error: BaseException) -> Callable[[str, Path], None]:
        def main(experiment: str, params: Path) -> None:
            error.add_note(f"while recording {experiment} with {params}")
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
