"""The training stages as they are called, and cut off: kill -9, Ctrl-C, no MLflow server."""

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import termios
from pathlib import Path
from typing import Any

import pytest
import safetensors
from builders import write_log
from example_params import EXAMPLE, write_params
from learning import drive
from pipeline_clones import warm_interpreter
from test_stages import ENVIRONMENT, finished, hear_interrupts, read_terminal

from addressed_dynamics.base.memory import MEMORY
from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.sources.transitions.conversion import convert_recording

EPOCHS = 120
"""Over twice as many as a worker can be ahead of the progress bar: it waits when the pipe to its parent is full."""
STAGES = {"train_ensemble": "ensemble", "train_addressing": "addressing"}
"""The stages, and the folder of models that each makes."""
ONE_EPOCH = re.compile(r"[1-9][\d.]*epoch \[")
"""What the progress bar says once an epoch is finished."""

pytestmark = pytest.mark.slow


def long_training(epochs: int = EPOCHS) -> dict[str, Any]:
    """The tiny params with two trainings side by side in each stage, long enough to be cut off."""
    sides = {"epochs": epochs}
    return EXAMPLE | {
        "ensemble": EXAMPLE["ensemble"] | sides | {"seeds": [0, 1], "cluster_epochs": epochs},
        "addressing": EXAMPLE["addressing"] | sides | {"variants": ["cost_sensitive"]},
    }


def closed_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def start(
    name: str, folder: Path, stderr: int, memory: str | None = None, python: str | Path = sys.executable
) -> subprocess.Popen[str]:
    """Start a stage, by default in an interpreter that gets the signals of its process."""
    command = [python, "-m", f"pipeline.{name}", "car", "--params", "params.yaml"]
    settings = {"MLFLOW_TRACKING_URI": f"http://127.0.0.1:{closed_port()}", "ADDRESSED_DYNAMICS_PROCESSES": "2"}
    environment = ENVIRONMENT | settings | ({} if memory is None else {MEMORY: memory})
    return subprocess.Popen(
        command, cwd=folder, env=environment, stderr=stderr, text=True, start_new_session=True,
        preexec_fn=hear_interrupts,
    )  # fmt: skip


def cut_off(
    name: str, folder: Path, number: signal.Signals, *, group: bool, memory: str | None = None
) -> tuple[int, str]:
    """Send a signal to a stage, or to all of its processes, after an epoch; wait until the last of them has ended."""
    terminal, other_end = os.openpty()
    termios.tcsetwinsize(terminal, (24, 120))
    said, sent = "", False
    with start(name, folder, other_end, memory) as process:
        os.close(other_end)
        for said in read_terminal(terminal):
            if not sent and ONE_EPOCH.search(said):
                sent = True
                (os.killpg if group else os.kill)(process.pid, number)
    os.close(terminal)
    assert sent, said
    return process.returncode, said


def epochs_kept(folder: Path) -> list[int]:
    kept = []
    for path in (folder / ".checkpoints" / "car").glob("*.safetensors"):
        with safetensors.safe_open(path, framework="pt") as file:
            kept.append(len(json.loads(file.metadata()["history"])))
    return kept


def contents(folder: Path) -> dict[str, bytes]:
    """All files under a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with tables, not trained yet."""
    folder = tmp_path_factory.mktemp("project")
    params = load_experiment(write_params(folder / "params.yaml", car=long_training()), "car", "transitions").convert
    data, recording = folder / "data", folder / "data" / "raw" / "car"
    recording.mkdir(parents=True)
    write_log(recording / "learning-env00.mcap", drive((20,) * 30))
    convert_recording(
        recording, data / "tables" / "car", data / "reports" / "car", params, cores=1, progress=lambda _: None
    )
    return folder


@pytest.fixture(scope="module")
def trained(tables: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """The project after both stages, which nothing disturbed but that there is no MLflow server; what they said."""
    folder = Path(shutil.copytree(tables, tmp_path_factory.mktemp("trained") / "project"))
    said = {}
    for name in STAGES:
        with start(name, folder, subprocess.PIPE, python=warm_interpreter() / "python") as process:
            status, said[name] = finished(process)
        assert status == 0, said[name]
    return folder, said


def test_without_an_mlflow_server_training_finishes_with_one_warning_and_its_metrics_in_the_reports(
    trained: tuple[Path, dict[str, str]],
) -> None:
    folder, said = trained
    for name, made in STAGES.items():
        (warning,) = [line for line in said[name].splitlines() if "MLflow" in line]
        assert "going on without tracking" in warning
        assert "Traceback" not in said[name]
        report = json.loads((folder / "data" / "figures" / "car" / made / f"{made}.json").read_text())
        assert len(report.get("validation", report).keys() - {"dropped"}) == 2
        curves = (folder / "data" / "figures" / "car" / made / f"{made}.csv").read_text().splitlines()
        assert len(curves) == 1 + 2 * EPOCHS
        assert list((folder / "data" / "models" / "car" / made).rglob("weights.safetensors"))
    assert epochs_kept(folder) == []


@pytest.mark.parametrize("name", STAGES)
def test_a_stage_that_is_killed_and_run_again_on_samples_in_files_ends_as_if_nothing_had_happened(
    trained: tuple[Path, dict[str, str]], tmp_path: Path, name: str
) -> None:
    made = Path("data") / "models" / "car" / STAGES[name]
    folder = Path(shutil.copytree(trained[0], tmp_path / "project"))
    shutil.rmtree(folder / made)
    status, _ = cut_off(name, folder, signal.SIGKILL, group=False, memory="0")
    assert status == -signal.SIGKILL
    spools = folder / ".checkpoints" / "car" / name
    assert len(list(spools.glob("spool-*/y.bin"))) == 2
    assert not (folder / made).exists()
    kept = epochs_kept(folder)
    assert kept
    assert max(kept) < EPOCHS
    with start(name, folder, subprocess.PIPE, memory="0", python=warm_interpreter() / "python") as process:
        status, said = finished(process)
    assert status == 0, said
    assert not list(spools.iterdir())
    assert contents(folder / made) == contents(trained[0] / made)
    reports = Path("data") / "reports" / "car"
    assert contents(folder / reports) == contents(trained[0] / reports)
    assert epochs_kept(folder) == []


def test_ctrl_c_ends_a_stage_with_one_line_and_leaves_no_process_and_no_part_of_a_model(
    tables: Path, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(tables, tmp_path / "project"))
    write_params(folder / "params.yaml", car=long_training(epochs=100 * EPOCHS))
    # Returns only when the last process has left the terminal.
    status, said = cut_off("train_ensemble", folder, signal.SIGINT, group=True)
    assert status == 130
    assert "Traceback" not in said
    assert said.splitlines()[-1] == "interrupted"
    assert list((folder / "data" / "models" / "car").iterdir()) == []
    assert max(epochs_kept(folder)) < 100 * EPOCHS
