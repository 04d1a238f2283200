"""Ray does what local worker processes do: the same bytes, whatever is lost on the way."""

import re
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from builders import CAR, RUN, write_log
from cluster_jobs import always_lost, converted_once_lost, failing, imported_once_lost, lost_once, squared, trained
from foreign_logs import SECOND, json_log, save, source, states_and_commands
from strategies import random_transitions

from addressed_dynamics.base import cluster as launching
from addressed_dynamics.base.errors import ClusterError, TrainingError
from addressed_dynamics.base.processes import worker_processes
from addressed_dynamics.importing import import_logs, importer
from addressed_dynamics.sources.transitions import conversion
from addressed_dynamics.sources.transitions.conversion import convert_recording
from addressed_dynamics.sources.transitions.params import ConvertParams
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.jobs import run_jobs

LOGS = 40


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def weights(epoch: Epoch) -> bytes:
    return b"".join(parameter.detach().numpy().tobytes() for parameter in epoch.network.parameters())


def convert(recording: Path, folder: Path) -> dict[str, bytes]:
    folder.mkdir()
    convert_recording(
        recording, folder / "tables", folder / "reports", ConvertParams(), cores=1, progress=lambda _: None
    )
    return bytes_of(folder)


def ended(jobs: dict[str, Any], workers: int = 1) -> tuple[list[tuple[str, int, dict[str, float]]], dict[str, bytes]]:
    """Return name, index and metrics of every epoch by name and index, and the networks of the last ones."""
    epochs = list(run_jobs(jobs, processes=1, workers=workers))
    told = sorted(((name, epoch.index, epoch.metrics) for name, epoch in epochs), key=lambda each: each[:2])
    return told, {name: weights(epoch) for name, epoch in epochs if epoch.last}


@pytest.mark.usefixtures("cluster")
def test_forty_logs_are_converted_to_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker is killed on the way, and nothing is left of what it had begun."""
    recording = tmp_path / "raw"
    recording.mkdir()
    for number in range(LOGS):
        transitions = random_transitions(CAR, [7, 12, 5], np.random.default_rng(number))
        write_log(recording / f"log-{number:02d}.mcap", transitions, run=replace(RUN, seed=number))
    with monkeypatch.context() as patch:
        patch.setattr(conversion, "_convert", converted_once_lost)
        on_cluster = convert(recording, tmp_path / "cluster")
    monkeypatch.setenv(launching.ENGINE, "local")
    assert on_cluster == convert(recording, tmp_path / "local")


@pytest.mark.usefixtures("cluster")
def test_logs_of_others_are_imported_to_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A worker is killed on the way, and nothing is left of what it had begun."""
    save(tmp_path, **{f"log_{n}": json_log(states_and_commands(1.0, (100 + n) * SECOND)) for n in range(5)})
    section = source(files=[str(tmp_path / "logs" / "*.mcap")])
    with monkeypatch.context() as patch:
        patch.setattr(importer, "_attempt", imported_once_lost)
        import_logs(section, tmp_path / "cluster", name="arm", progress=lambda _: None)
    monkeypatch.setenv(launching.ENGINE, "local")
    import_logs(section, tmp_path / "local", name="arm", progress=lambda _: None)
    on_cluster = bytes_of(tmp_path / "cluster")
    assert on_cluster == bytes_of(tmp_path / "local")
    assert sorted(on_cluster) == [*(f"{n:04d}-log_{n}.mcap" for n in range(5)), "import.json"]


@pytest.mark.usefixtures("cluster")
def test_results_come_in_the_order_of_the_items_from_other_processes() -> None:
    with worker_processes(1) as ordered_map:
        answers = list(ordered_map(squared, range(20)))
    assert [square for square, _ in answers] == [number**2 for number in range(20)]
    assert len({pid for _, pid in answers}) == 2


@pytest.mark.usefixtures("cluster")
def test_a_killed_worker_loses_nothing(tmp_path: Path) -> None:
    with worker_processes(1) as ordered_map:
        (answer,) = ordered_map(lost_once, [tmp_path / "tried"])
    assert answer.startswith("begun anew")


@pytest.mark.usefixtures("cluster")
def test_an_item_that_is_always_lost_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launching, "RETRIES", 1)
    with worker_processes(1) as ordered_map, pytest.raises(ClusterError, match="Ray lost a task more often") as found:
        list(ordered_map(always_lost, [1]))
    assert "\n" not in str(found.value)


@pytest.mark.usefixtures("cluster")
def test_an_error_of_the_project_comes_through() -> None:
    with worker_processes(1) as ordered_map, pytest.raises(TrainingError, match="not finite"):
        list(ordered_map(failing, [1]))


@pytest.mark.usefixtures("cluster")
def test_two_trainings_end_as_they_do_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One of them in a worker that is killed in the middle: it goes on from its checkpoint."""
    there, here = tmp_path / "there", tmp_path / "here"
    there.mkdir()
    here.mkdir()
    on_cluster = ended({f"seed-{seed}": partial(trained, seed, there, 3 if seed else None) for seed in (0, 1)})
    assert (there / "1.died").exists()
    monkeypatch.setenv(launching.ENGINE, "local")
    assert on_cluster == ended({f"seed-{seed}": partial(trained, seed, here) for seed in (0, 1)})


@pytest.mark.usefixtures("cluster")
@pytest.mark.parametrize("deadly_rank", [None, 0, 1])
def test_two_workers_train_one_ensemble_to_the_bytes_of_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, deadly_rank: int | None
) -> None:
    """Also if one of the two is killed in the middle: both begin anew, from the checkpoint."""
    there, here = tmp_path / "there", tmp_path / "here"
    there.mkdir()
    here.mkdir()
    deadly = {} if deadly_rank is None else {"deadly_epoch": 3, "deadly_rank": deadly_rank}
    on_cluster = ended({"seed-0": partial(trained, 0, there, shares=4, **deadly)}, workers=2)
    workers = {line.split()[1] for line in (there / "workers").read_text().splitlines()}
    assert len(workers) >= 2
    assert (there / "0.died").exists() == (deadly_rank is not None)
    monkeypatch.setenv(launching.ENGINE, "local")
    assert on_cluster == ended({"seed-0": partial(trained, 0, here, shares=4)})
    assert not list(Path.cwd().glob(".*.meeting"))


@pytest.mark.usefixtures("cluster")
def test_more_workers_than_cores_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ClusterError, match="9 workers are asked for, but the cluster has 2 cores"):
        ended({"seed-0": partial(trained, 0, tmp_path, shares=9)}, workers=9)


def test_a_node_that_leaves_takes_nothing_along(cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three nodes with a training each, one leaves when all have begun."""
    there, here = tmp_path / "there", tmp_path / "here"
    there.mkdir()
    here.mkdir()
    leaving = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()

    def begun() -> list[tuple[str, str]]:
        log = there / "workers"
        return [tuple(line.split()[:2]) for line in log.read_text().splitlines()] if log.exists() else []

    def leave() -> None:
        while len({seed for seed, _ in begun()}) < 3:
            time.sleep(0.05)
        cluster.remove_node(leaving, allow_graceful=False)

    thread = threading.Thread(target=leave)
    thread.start()
    on_cluster = ended({f"seed-{seed}": partial(trained, seed, there, slow=0.5) for seed in range(3)})
    thread.join()
    assert len(set(begun())) == 4, "one training was in two processes, the others in one"
    monkeypatch.setenv(launching.ENGINE, "local")
    assert on_cluster == ended({f"seed-{seed}": partial(trained, seed, here) for seed in range(3)})


@pytest.mark.usefixtures("cluster")
def test_a_worker_with_other_code_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launching, "_package_digest", lambda: "another")
    with (
        worker_processes(1) as ordered_map,
        pytest.raises(ClusterError, match="has another version of addressed-dynamics"),
    ):
        list(ordered_map(squared, [1]))


@pytest.mark.usefixtures("cluster")
def test_a_worker_that_does_not_see_the_folder_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    elsewhere = tmp_path / "project"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    with worker_processes(1) as ordered_map:
        elsewhere.rmdir()
        monkeypatch.setattr(Path, "cwd", lambda: elsewhere)
        with pytest.raises(ClusterError, match="does not see the folder"):
            list(ordered_map(squared, [1]))


def test_ray_for_one_command_listens_on_the_loopback_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(launching.ENGINE, "ray")
    with worker_processes(1) as ordered_map:
        assert [square for square, _ in ordered_map(squared, [3])] == [9]
        listening = {
            connection.laddr.ip
            for process in psutil.Process().children(recursive=True)
            for connection in process.net_connections("inet")
            if connection.status == psutil.CONN_LISTEN
        }
    assert listening <= {"127.0.0.1", "::1", "::ffff:127.0.0.1"}
    assert listening


@pytest.mark.parametrize("address", ["127.0.0.1:9", "..:9", f"{'a' * 64}:9"])
def test_where_no_ray_answers_one_line_says_so(monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    monkeypatch.setenv(launching.ENGINE, f"ray:{address}")
    with pytest.raises(ClusterError, match=f"no Ray answers at {re.escape(address)}"), worker_processes(1):
        pass
