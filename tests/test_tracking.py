import json
import logging
import os
import platform
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest
from pipeline_clones import warm_interpreter
from stage_dependencies import ROOT

from addressed_dynamics import tracking
from addressed_dynamics.base.errors import TrackingError
from addressed_dynamics.base.versions import output_digests
from addressed_dynamics.reporting.common.blocks import Facts
from addressed_dynamics.reporting.common.runs import run_blocks
from addressed_dynamics.tracking import runs
from addressed_dynamics.tracking.parents import Parents
from addressed_dynamics.tracking.store import _make_tables, prepare_mlflow
from addressed_dynamics.tracking.ui import opening_on

LOCK = """
schema: '2.0'
stages:
  convert@mountaincar:
    outs:
    - path: data/tables/mountaincar
      hash: md5
      md5: 0123456789abcdef0123456789abcdef.dir
"""


def new_project(folder: Path, patch: pytest.MonkeyPatch) -> Path:
    (folder / ".dvc").mkdir()
    patch.chdir(folder)
    patch.delenv("DVC_ROOT", raising=False)
    patch.delenv("MLFLOW_TRACKING_URI", raising=False)
    return folder


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return new_project(tmp_path, monkeypatch)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """One project whose store all tests share, because making its tables takes seconds; each has its experiment."""
    with pytest.MonkeyPatch.context() as patch:
        yield new_project(tmp_path_factory.mktemp("project"), patch)


def client(root: Path) -> Any:
    from mlflow import MlflowClient

    return MlflowClient(f"sqlite:///{root / '.mlflow' / 'mlflow.db'}")


def only_run(root: Path, experiment: str) -> Any:
    server = client(root)
    (found,) = server.search_runs([server.get_experiment_by_name(experiment).experiment_id])
    return found


def test_a_run_keeps_its_name_params_tags_and_the_metrics_of_every_step(store: Path) -> None:
    params = {"members": 2, "optimiser": {"betas": [0.9, 0.99]}}
    with tracking.run(
        stage="train_ensemble", experiment="keeps", name="n=2", params=params, params_file=Path("params.yaml")
    ) as run:
        for step in range(3):
            run.log({"loss/train": 1.0 / (step + 1)}, step=step)
    kept = only_run(store, "keeps")
    assert kept.info.run_id == run.id
    assert kept.info.run_name == "n=2"
    assert kept.info.status == "FINISHED"
    assert kept.data.params == {"members": "2", "optimiser.betas": "[0.9, 0.99]"}
    assert kept.data.tags["stage"] == "train_ensemble"
    assert kept.data.tags["params_file"] == "params.yaml"
    history = client(store).get_metric_history(run.id, "loss/train")
    assert [(metric.step, metric.value) for metric in history] == [(0, 1.0), (1, 0.5), (2, 1.0 / 3)]


def test_more_metrics_than_one_request_may_hold_all_arrive(store: Path) -> None:
    with tracking.run(stage="s", experiment="many", name="n", params={}) as run:
        run.log({f"loss_member/{member}": float(member) for member in range(1700)}, step=0)
    assert len(only_run(store, "many").data.metrics) == 1700


def log_and_fail() -> None:
    with tracking.run(stage="s", experiment="fails", name="n", params={}) as run:
        run.log({"loss/train": 1.0}, step=0)
        raise ZeroDivisionError


def test_an_exception_marks_the_run_failed_and_goes_on(store: Path) -> None:
    with pytest.raises(ZeroDivisionError):
        log_and_fail()
    kept = only_run(store, "fails")
    assert kept.info.status == "FAILED"
    assert kept.data.metrics == {"loss/train": 1.0}


@pytest.mark.parametrize("stop", [KeyboardInterrupt, SystemExit])
def test_an_interrupt_marks_the_run_killed_and_goes_on(store: Path, stop: type[BaseException]) -> None:
    with pytest.raises(stop), tracking.run(stage="s", experiment=stop.__name__, name="n", params={}):
        raise stop
    assert only_run(store, stop.__name__).info.status == "KILLED"


def test_the_dataset_is_logged_with_the_digest_that_dvc_has_for_it(store: Path) -> None:
    (store / "dvc.lock").write_text(LOCK)
    with tracking.run(stage="s", experiment="dataset", name="n", params={}) as run:
        run.log_dataset("mountaincar", Path("data/tables/mountaincar"))
    kept = only_run(store, "dataset")
    (used,) = kept.inputs.dataset_inputs
    assert (used.dataset.name, used.dataset.digest) == ("mountaincar", "0123456789abcdef0123456789abcdef")
    assert kept.data.tags["data_md5"] == "0123456789abcdef0123456789abcdef"


def test_files_and_folders_are_kept_beside_the_store(store: Path) -> None:
    (store / "figures").mkdir()
    (store / "figures" / "bins.svg").write_text("<svg/>")
    (store / "report.html").write_text("<p>")
    with tracking.run(stage="s", experiment="files", name="n", params={}) as run:
        run.log_artifact(store / "report.html")
        run.log_artifact(store / "figures", "figures")
    kept = store / ".mlflow" / "artifacts" / "files" / str(run.id) / "artifacts"
    assert {path.relative_to(kept).as_posix() for path in kept.rglob("*.*")} == {"report.html", "figures/bins.svg"}


def test_a_new_experiment_has_a_saved_view_with_metric_columns(store: Path) -> None:
    with tracking.run(stage="s", experiment="view", name="n", params={}):
        pass
    tags = client(store).get_experiment_by_name("view").tags
    state = json.loads(json.loads(tags["mlflow.sharedViewState.overview"])["state"])
    assert "metrics.`loss/validation`" in state["selectedColumns"]


def test_without_a_server_training_goes_on_after_one_warning(
    project: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with socket.socket() as reserved:
        reserved.bind(("127.0.0.1", 0))  # bound but not listening: connections are refused
        monkeypatch.setenv("MLFLOW_TRACKING_URI", f"http://127.0.0.1:{reserved.getsockname()[1]}")
        with tracking.run(stage="s", experiment="down", name="n", params={}) as run:
            run.log({"loss/train": 1.0}, step=0)
            run.log_dataset("mountaincar", project)
            run.log_output(project)
    assert run.id is None
    assert run.url is None
    assert [record.levelno for record in caplog.records if record.name == tracking.__name__] == [logging.WARNING]


def test_with_a_broken_store_training_goes_on_after_one_warning(
    project: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (project / ".mlflow").mkdir()
    (project / ".mlflow" / "mlflow.db").write_bytes(b"this is no database" * 1000)
    for name in ("first", "second"):
        with tracking.run(stage="s", experiment="broken", name=name, params={}) as run:
            run.log({"loss/train": 1.0}, step=0)
        assert run.id is None
    assert len([record for record in caplog.records if record.name == tracking.__name__]) == 1


@pytest.mark.slow
def test_two_first_users_at_once_share_one_store(project: Path) -> None:
    program = (
        "import sys; from addressed_dynamics import tracking\n"
        "with tracking.run(stage='s', experiment='shared', name=sys.argv[1], params={}): pass"
    )
    python, environment = warm_interpreter() / "python", os.environ | {"PYTHONPATH": str(ROOT / "src")}
    users = [
        subprocess.Popen([python, "-c", program, name], cwd=project, env=environment) for name in ("first", "second")
    ]
    assert [user.wait() for user in users] == [0, 0]
    server = client(project)
    kept = server.search_runs([server.get_experiment_by_name("shared").experiment_id])
    assert {(run.info.run_name, run.info.status) for run in kept} == {("first", "FINISHED"), ("second", "FINISHED")}


def test_importing_tracking_does_not_import_mlflow() -> None:
    program = "import sys; from addressed_dynamics import tracking; sys.exit('mlflow' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def write_output(folder: Path, text: str = "weights") -> str:
    """Write one file into `folder` and return the folder's digest."""
    folder.mkdir(parents=True)
    (folder / "weights.safetensors").write_text(text)
    return output_digests(folder)["."]


def test_a_run_writes_nothing_into_its_output_and_is_found_by_its_digest(store: Path, tmp_path: Path) -> None:
    digest, before = write_output(tmp_path / "seed-0"), sorted(tmp_path.rglob("*"))
    with tracking.run(stage="s", experiment="found", name="the name", params={}) as run:
        run.log_output(tmp_path / "seed-0")
    assert sorted(tmp_path.rglob("*")) == before
    found = tracking.find_runs("found", [digest, "0" * 16])
    assert list(found) == [digest]
    assert (found[digest].run_id, found[digest].name) == (run.id, "the name")
    assert tracking.run_link(found[digest]) == run.url
    assert only_run(store, "found").data.tags["output"] == digest


def test_the_filters_in_a_report_find_the_runs(store: Path, tmp_path: Path) -> None:
    for name in ("first", "second"):
        write_output(tmp_path / name, name)
        with tracking.run(stage="s", experiment="filters", name=name, params={}) as run:
            run.log_output(tmp_path / name)
    (facts,) = (block for block in run_blocks("filters", output_digests(tmp_path)) if isinstance(block, Facts))
    server = client(store)
    experiments = [server.get_experiment_by_name("filters").experiment_id]
    found = {output: server.search_runs(experiments, wanted) for output, wanted in facts.items.items()}
    assert {output: [run.info.run_name for run in runs] for output, runs in found.items()} == {
        "first": ["first"],
        "second": ["second"],
    }


@pytest.mark.usefixtures("store")
def test_a_run_of_several_outputs_is_found_by_each(tmp_path: Path) -> None:
    digests = [write_output(tmp_path / part, part) for part in ("network", "addressing")]
    with tracking.run(stage="s", experiment="several", name="n", params={}) as run:
        run.log_output(tmp_path / "network")
        run.log_output(tmp_path)
    assert {digest: found.run_id for digest, found in tracking.find_runs("several", digests).items()} == {
        digest: run.id for digest in digests
    }


def test_a_stage_took_from_the_begin_of_its_first_run_to_the_end_of_its_last(store: Path, tmp_path: Path) -> None:
    digests = list[str]()
    for stage, name in (("train_ensemble", "0"), ("train_ensemble", "1"), ("train_addressing", "0")):
        digests.append(write_output(tmp_path / stage / name, stage + name))
        with tracking.run(stage=stage, experiment="long", name=name, params={}) as run:
            run.log_output(tmp_path / stage / name)
    server, begin = client(store), 1_700_000_000_000
    runs = server.search_runs([server.get_experiment_by_name("long").experiment_id], order_by=["start_time ASC"])
    for run, (first, last) in zip(runs, ((0, 3_000), (1_000, 5_000), (6_000, 8_500)), strict=True):
        server.set_terminated(run.info.run_id, end_time=begin + last)
        with closing(sqlite3.connect(store / ".mlflow" / "mlflow.db")) as database, database:
            database.execute("UPDATE runs SET start_time = ? WHERE run_uuid = ?", (begin + first, run.info.run_id))
    assert tracking.stage_seconds("long", [*digests, "0" * 16]) == {"train_ensemble": 5.0, "train_addressing": 2.5}
    assert tracking.stage_seconds("never", digests) == {}


@pytest.mark.usefixtures("store")
def test_of_runs_that_made_the_same_the_last_is_found(tmp_path: Path) -> None:
    digest = write_output(tmp_path / "seed-0")
    for name in ("first", "second"):
        with tracking.run(stage="s", experiment="twice", name=name, params={}) as run:
            run.log_output(tmp_path / "seed-0")
    assert tracking.find_runs("twice", [digest])[digest].name == "second"


def log_output_and_stop(experiment: str, folder: Path, stop: type[BaseException]) -> None:
    with tracking.run(stage="s", experiment=experiment, name="n", params={}) as run:
        run.log_output(folder)
        raise stop


@pytest.mark.parametrize("stop", [ZeroDivisionError, KeyboardInterrupt])
def test_a_run_that_did_not_end_well_made_nothing(store: Path, tmp_path: Path, stop: type[BaseException]) -> None:
    digest, experiment = write_output(tmp_path / "seed-0"), f"made nothing {stop.__name__}"
    with pytest.raises(stop):
        log_output_and_stop(experiment, tmp_path / "seed-0", stop)
    assert tracking.find_runs(experiment, [digest]) == {}
    assert "output" not in only_run(store, experiment).data.tags


def test_a_run_that_was_never_closed_made_nothing(store: Path) -> None:
    with tracking.run(stage="s", experiment="open", name="n", params={}) as run:
        client(store).set_tag(run.id, "output", "0123456789abcdef")
        assert tracking.find_runs("open", ["0123456789abcdef"]) == {}
    assert list(tracking.find_runs("open", ["0123456789abcdef"])) == ["0123456789abcdef"]


def test_an_output_without_files_costs_a_warning_and_no_tag(
    store: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with tracking.run(stage="s", experiment="no files", name="n", params={}) as run:
        run.log_output(tmp_path)
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert "output" not in only_run(store, "no files").data.tags


def test_a_store_whose_making_is_cut_off_is_made_anew(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import mlflow

    prepare_mlflow()
    folder, made = project / ".mlflow", list[Path]()
    folder.mkdir()

    def making(uri: str) -> Any:
        made.append(Path(uri.removeprefix("sqlite:///")))
        made[-1].write_text("half a store")
        if len(made) == 1:
            raise KeyboardInterrupt
        return MagicMock()

    monkeypatch.setattr(mlflow, "MlflowClient", making)
    with pytest.raises(KeyboardInterrupt):
        _make_tables(folder)
    assert list(folder.iterdir()) == []
    _make_tables(folder)
    assert [path.name for path in folder.iterdir()] == ["mlflow.db"]
    assert all(path.name.endswith(".partial") for path in made)


def test_looking_for_runs_makes_no_store(project: Path) -> None:
    assert tracking.find_runs("mountaincar", ["0123456789abcdef"]) == {}
    assert not (project / ".mlflow").exists()


def test_looking_for_runs_in_a_broken_store_costs_a_warning_and_finds_none(
    project: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (project / ".mlflow").mkdir()
    (project / ".mlflow" / "mlflow.db").write_bytes(b"this is no database" * 1000)
    assert tracking.find_runs("mountaincar", ["0123456789abcdef"]) == {}
    assert len([record for record in caplog.records if record.name == tracking.__name__]) == 1


def test_a_copied_project_keeps_its_runs_and_writes_nothing_into_the_first_ones_store(
    project: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    (project / "first.txt").write_text("of the first project")
    with tracking.run(stage="s", experiment="moves", name="first", params={}) as first:
        first.log_artifact(project / "first.txt")
    copy = tmp_path_factory.mktemp("a copy") / "project"
    shutil.copytree(project, copy)
    before = {path: path.stat().st_mtime_ns for path in (project / ".mlflow").rglob("*")}
    monkeypatch.chdir(copy)
    (copy / "second.txt").write_text("of the copy")
    with tracking.run(stage="s", experiment="moves", name="second", params={}) as second:
        second.log_artifact(copy / "second.txt")
    with tracking.run(stage="s", experiment="another", name="third", params={}) as third:
        third.log_artifact(copy / "second.txt")
    assert {path: path.stat().st_mtime_ns for path in (project / ".mlflow").rglob("*")} == before
    kept = {path.relative_to(copy / ".mlflow" / "artifacts").as_posix() for path in copy.rglob("artifacts/*/*.txt")}
    kept |= {path.relative_to(copy / ".mlflow" / "artifacts").as_posix() for path in copy.rglob("artifacts/*.txt")}
    assert kept == {
        f"moves/{first.id}/artifacts/first.txt",
        f"moves/{second.id}/artifacts/second.txt",
        f"another/{third.id}/artifacts/second.txt",
    }
    # Of the copy's own, the first run's file is found where it is now.
    assert client(copy).list_artifacts(str(first.id))[0].path == "first.txt"
    assert client(copy).get_run(str(first.id)).info.artifact_uri.startswith((copy / ".mlflow").as_uri())


PARAMS = """
experiments:
  NAME: {kind: transitions, raw: data/raw/car}
NAME:
  title: A car
  ensemble: {epochs: EPOCHS}
"""


def write_params(root: Path, experiment: str, epochs: int = 3) -> None:
    (root / "params.yaml").write_text(PARAMS.replace("NAME", experiment).replace("EPOCHS", str(epochs)))


def log_stage(experiment: str, name: str, **figures: float) -> tracking.Run:
    with tracking.run(
        stage=name, experiment=experiment, name=f"car {name}", params={}, params_file=Path("params.yaml"),
        data=Path("data/tables/car"),
    ) as run:  # fmt: skip
        run.log(figures, step=0)
    return run


def runs_of(root: Path, experiment: str) -> dict[str, Any]:
    server = client(root)
    found = server.search_runs([server.get_experiment_by_name(experiment).experiment_id])
    return {run.info.run_name: run for run in found}


def test_stages_on_the_same_data_and_params_are_nested_below_one_run_of_the_pipeline(store: Path) -> None:
    write_params(store, "nests")
    (store / "dvc.lock").write_text(LOCK.replace("mountaincar", "car"))
    log_stage("nests", "train_ensemble")
    log_stage("nests", "evaluate", **{"loss/test": 0.5})
    write_params(store, "nests", 4)
    (store / "dvc.lock").write_text(LOCK.replace("mountaincar", "car"))
    log_stage("nests", "train_ensemble")
    server = client(store)
    found = server.search_runs([server.get_experiment_by_name("nests").experiment_id], order_by=["start_time ASC"])
    above = {run.info.run_id: run.data for run in found if run.data.tags["stage"] == "pipeline"}
    below = [
        (run.data.tags["stage"], run.data.tags["mlflow.parentRunId"]) for run in found if run.info.run_id not in above
    ]
    first, second = above
    assert sorted(below) == sorted([("train_ensemble", first), ("evaluate", first), ("train_ensemble", second)])
    assert [each.params["ensemble.epochs"] for each in above.values()] == ["3", "4"]
    assert all(each.params["ensemble.batch_size"] for each in above.values())
    assert {run.info.status for run in found} == {"FINISHED"}
    assert {run.data.tags["data_md5"] for run in found} == {"0123456789abcdef0123456789abcdef"}


def test_a_dvc_experiment_is_told_from_another_by_name_and_tag(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_params(store, "labels")
    for label in ("pale-hare", "ruby-fern"):
        monkeypatch.setenv("DVC_EXP_NAME", label)
        log_stage("labels", "evaluate")
    kept = runs_of(store, "labels")
    assert {name: run.data.tags["dvc_experiment"] for name, run in kept.items()} == {
        "labels pale-hare": "pale-hare", "car evaluate (pale-hare)": "pale-hare",
        "labels ruby-fern": "ruby-fern", "car evaluate (ruby-fern)": "ruby-fern",
    }  # fmt: skip
    state = json.loads(json.loads(experiment_tags(store, "labels")["mlflow.sharedViewState.overview"])["state"])
    assert "tags.`dvc_experiment`" in state["selectedColumns"]


def test_a_stage_that_fails_leaves_the_run_of_the_pipeline_failed_until_the_next_one(store: Path) -> None:
    write_params(store, "breaks")

    def fail() -> None:
        with tracking.run(
            stage="evaluate", experiment="breaks", name="n", params={}, params_file=Path("params.yaml"), data=store
        ):
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    (above,) = (run for run in runs_of(store, "breaks").values() if run.data.tags["stage"] == "pipeline")
    assert above.info.status == "FAILED"
    with tracking.run(
        stage="evaluate", experiment="breaks", name="again", params={}, params_file=Path("params.yaml"), data=store
    ):
        assert client(store).get_run(above.info.run_id).info.status == "RUNNING"
    assert client(store).get_run(above.info.run_id).info.status == "FINISHED"


def stage_of(experiment: str, name: str) -> AbstractContextManager[tracking.Run]:
    return tracking.run(
        stage=name, experiment=experiment, name=name, params={"a": 1}, params_file=Path("params.yaml"),
        data=Path("data/tables/car"),
    )  # fmt: skip


def test_the_run_of_the_pipeline_ends_with_the_last_of_stages_that_run_side_by_side(
    store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_params(store, "beside")

    def above() -> str:
        (run,) = (run for run in runs_of(store, "beside").values() if run.data.tags["stage"] == "pipeline")
        return str(run.info.status)

    def fail() -> None:
        with monkeypatch.context() as patches:
            patches.setattr(runs, "_parents", Parents())  # as another process has it
            with stage_of("beside", "train_baselines"):
                raise ZeroDivisionError

    with stage_of("beside", "train_ensemble"):
        with pytest.raises(ZeroDivisionError):
            fail()
        assert above() == "RUNNING"
    assert above() == "FAILED"
    # What another process has left open because it was killed is waited for by nobody.
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    with monkeypatch.context() as patches:
        patches.setattr(runs, "_parents", Parents())
        patches.setattr(runs, "this_process", lambda: f"{platform.node()} {ended.pid}")
        stage_of("beside", "report").__enter__().flush()
    with stage_of("beside", "evaluate"):
        assert above() == "RUNNING"
    assert above() == "FINISHED"


def test_a_run_that_cannot_be_opened_leaves_none_open(
    store: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*_: object) -> None:
        message = "the disk is full"
        raise OSError(message)

    write_params(store, "unopened")
    monkeypatch.setattr(runs, "log_params", fail)
    monkeypatch.setattr(runs, "_PATIENCE", 0)  # the store is not left alone
    with stage_of("unopened", "evaluate") as run:
        assert run.id is None
    assert "could not open a run" in caplog.text
    assert {run.info.status for run in runs_of(store, "unopened").values()} == {"FAILED"}
    monkeypatch.undo()
    with stage_of("unopened", "report"):
        pass
    found = {run.data.tags["stage"]: run.info.status for run in runs_of(store, "unopened").values()}
    assert found == {"evaluate": "FAILED", "report": "FINISHED", "pipeline": "FINISHED"}


@pytest.mark.usefixtures("store")
def test_a_store_that_is_waited_for_in_vain_is_not_waited_for_by_every_run(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now, calls = [0.0], list[str]()

    def wait_in_vain(*arguments: object, **named: object) -> None:
        calls.append(str(arguments or named))
        now[0] += 30.0
        message = "database is locked"
        raise OSError(message)

    monkeypatch.setattr(runs, "time", SimpleNamespace(monotonic=lambda: now[0], time=lambda: 0.0))
    monkeypatch.setattr(runs, "_lost", {})
    with ExitStack() as stack:
        opened = [
            stack.enter_context(tracking.run(stage="s", experiment="locked", name=f"run {number}", params={}))
            for number in range(4)
        ]
        assert all(run.id for run in opened)
        for name in ("log_batch", "set_terminated"):
            monkeypatch.setattr(type(opened[0]._client), name, wait_in_vain)
        monkeypatch.setattr(runs, "connect", wait_in_vain)
        opened[0].log({"loss/train": 1.0}, 0)
        opened[0].flush()
        for run in opened[1:]:
            run.log({"loss/train": 1.0}, 0)
        with tracking.run(stage="s", experiment="locked", name="one more", params={}) as more:
            assert more.id is None
    assert len(calls) == 1
    (said,) = [record.getMessage() for record in caplog.records if record.name == tracking.__name__]
    assert said.startswith("MLflow: could not keep metrics (database is locked)")
    now[0] += 30.0 * runs._PATIENCE
    with tracking.run(stage="s", experiment="locked", name="later", params={}) as later:
        assert later.id is None
    assert len(calls) == 2  # it is tried again


def test_a_machine_that_cannot_be_watched_costs_a_warning_and_nothing_else(
    store: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    from mlflow.system_metrics.system_metrics_monitor import SystemMetricsMonitor

    def fail(_: object) -> None:
        message = "no psutil here"
        raise RuntimeError(message)

    monkeypatch.setattr(SystemMetricsMonitor, "start", fail)
    write_params(store, "unwatched")
    log_stage("unwatched", "evaluate", **{"loss/test": 0.5})
    assert [record.getMessage() for record in caplog.records if record.name == tracking.__name__] == [
        "MLflow: could not watch the machine (no psutil here); going on without system metrics"
    ]
    assert {run.info.status for run in runs_of(store, "unwatched").values()} == {"FINISHED"}


def experiment_tags(root: Path, experiment: str) -> dict[str, str]:
    return dict(client(root).get_experiment_by_name(experiment).tags)


def test_what_mlflow_says_of_the_metrics_of_the_machine_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    from mlflow.system_metrics.system_metrics_monitor import SystemMetricsMonitor

    prepare_mlflow()
    said, handler = list[str](), logging.Handler()
    monkeypatch.setattr(handler, "emit", lambda record: said.append(record.getMessage()))
    logger = logging.getLogger(SystemMetricsMonitor.__module__)
    monkeypatch.setattr(logger, "handlers", [handler])
    logger.warning("Failed to get mlflow run: database is locked\n[SQL: SELECT runs.run_uuid\nFROM runs]")
    assert said == ["Failed to get mlflow run: database is locked"]


def test_the_verdict_describes_the_run_of_the_pipeline_and_the_experiment(store: Path) -> None:
    write_params(store, "concludes")
    digest = write_output(store / "seed-0")
    with tracking.run(stage="train_ensemble", experiment="concludes", name="trained alone", params={}) as trained:
        trained.log_output(store / "seed-0")
    with tracking.run(
        stage="report", experiment="concludes", name="n", params={}, params_file=Path("params.yaml"), data=store
    ) as run:
        run.conclude("It is good.", {"loss/test": 0.25}, [digest])
    (above,) = (each for each in runs_of(store, "concludes").values() if each.data.tags["stage"] == "pipeline")
    assert above.data.metrics["loss/test"] == 0.25
    assert above.data.tags["mlflow.note.content"] == (
        "It is good.\n\nTrained in an earlier run of the pipeline:\n\n"
        f"- [trained alone](#/experiments/{above.info.experiment_id}/runs/{trained.id}?workflowType=machine_learning)"
    )
    note = experiment_tags(store, "concludes")["mlflow.note.content"]
    assert note.startswith("It is good.\n\n[Runs with losses and parameters](#/experiments/")
    assert "127.0.0.1" not in note


def test_a_description_that_somebody_wrote_stays(store: Path) -> None:
    with tracking.run(stage="s", experiment="noted", name="n", params={}):
        pass
    server, mine = client(store), "the car with the worn tyres"
    server.set_experiment_tag(server.get_experiment_by_name("noted").experiment_id, "mlflow.note.content", mine)
    with tracking.run(stage="report", experiment="noted", name="n", params={}) as run:
        run.conclude("It is good.", {})
    assert experiment_tags(store, "noted")["mlflow.note.content"] == mine


def test_what_falls_by_powers_of_ten_is_drawn_on_a_logarithmic_scale(store: Path) -> None:
    with tracking.run(stage="s", experiment="curves", name="n", params={}):
        pass
    view = json.loads(experiment_tags(store, "curves")["mlflow.sharedViewState.overview"])
    scales = {each["metricKey"]: each["scaleType"] for each in json.loads(view["state"])["compareRunCharts"]}
    assert scales["loss/validation"] == "log"
    assert scales["agreement"] == "linear"


def test_the_first_page_opens_on_the_saved_view_of_an_experiment() -> None:
    page = opening_on("<html><head><title>MLflow</title></head></html>", "7")
    assert page.startswith("<html><head><script>")
    assert page.endswith("<title>MLflow</title></head></html>")
    assert '"#/experiments/7/runs?workflowType=machine_learning&viewStateShareKey=overview"' in page
    assert "#/experiments/7" not in opening_on("<head></head>", None)


def test_a_password_of_the_server_does_not_get_into_links(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "https://user:secret@runs.example:8443/mlflow/")
    link = tracking.run_link(tracking.RunReference("r", "7", "n"))
    assert link.startswith("https://runs.example:8443/mlflow/#/experiments/7/runs/r")


@pytest.mark.usefixtures("project")
def test_a_password_of_the_server_is_not_said(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(runs, "_lost", {})
    address = f"127.0.0.1:{free_port()}"
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"http://user:secret@secret@{address}")
    with tracking.run(stage="s", experiment="e", name="n", params={}) as run:
        assert run.id is None
    (said,) = [record.getMessage() for record in caplog.records if record.name == tracking.__name__]
    assert f"http://{address}" in said
    assert "secret" not in caplog.text


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.mark.usefixtures("project")
def test_the_ui_without_a_store_says_how_to_get_one() -> None:
    with pytest.raises(TrackingError, match="dvc repro"):
        tracking.serve_ui()


def test_the_ui_says_when_its_port_is_taken(project: Path) -> None:
    (project / ".mlflow").mkdir()
    (project / ".mlflow" / "mlflow.db").touch()
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(TrackingError, match="choose another"):
            tracking.serve_ui(other.getsockname()[1])


def test_the_ui_of_a_broken_store_says_so(project: Path) -> None:
    (project / ".mlflow").mkdir()
    (project / ".mlflow" / "mlflow.db").write_bytes(b"this is no database" * 1000)
    with pytest.raises(TrackingError, match="cannot be opened"):
        tracking.serve_ui(free_port())


def test_the_ui_of_a_server_is_on_that_server(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://runs.example")
    with pytest.raises(TrackingError, match=r"open http://runs\.example in a browser"):
        tracking.serve_ui()


@pytest.mark.slow
@pytest.mark.usefixtures("store")
def test_the_ui_serves_the_store_until_it_is_interrupted() -> None:
    with tracking.run(stage="s", experiment="served", name="n", params={}):
        pass
    port = free_port()
    program = f"from addressed_dynamics import tracking; tracking.serve_ui({port})"
    server = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert server.stdout is not None
    with server.stdout as lines:
        assert any(f"running on http://127.0.0.1:{port}" in line for line in lines)
        server.send_signal(signal.SIGINT)
        assert "Traceback" not in lines.read()  # ends when the last process that could write has ended
    server.wait()
