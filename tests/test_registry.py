"""Delivered models in MLflow's registry: versions, the champion among them, and what loads and serves them."""

import json
import logging
import os
import shutil
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from driven import motion_model
from learning import drive, untrained_model
from packed_models import write_addressed, write_trusted
from pipeline_clones import warm_interpreter
from stage_dependencies import ROOT

from addressed_dynamics import tracking
from addressed_dynamics.base.criteria import Criterion, is_better
from addressed_dynamics.simulators import serving_motion, serving_transitions
from addressed_dynamics.simulators.packing import packed
from addressed_dynamics.simulators.serving import Served
from addressed_dynamics.tracking.registry import Registered

LOCK = """
schema: '2.0'
stages:
  convert@car:
    outs:
    - path: data/tables/car
      md5: MD5.dir
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """One project whose store all tests share, because making its tables takes seconds; each has its model."""
    folder = tmp_path_factory.mktemp("project")
    (folder / ".dvc").mkdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("DVC_ROOT", raising=False)
        patch.delenv("MLFLOW_TRACKING_URI", raising=False)
        yield folder


def client(root: Path) -> Any:
    from mlflow import MlflowClient

    return MlflowClient(f"sqlite:///{root / '.mlflow' / 'mlflow.db'}")


def reached(horizon: float, error: float = 1.0) -> tuple[Criterion, ...]:
    return (
        Criterion("horizon_seconds", horizon, higher_is_better=True),
        Criterion("one_step_percent", error, higher_is_better=False),
    )


def evaluated(
    name: str,
    models: Path,
    criteria: Sequence[Criterion] = (),
    *,
    steps: int = 10,
    data: str = "0" * 32,
    load: Callable[[Path], Served] = serving_transitions.load_served,
) -> Registered:
    """Register what is delivered in a folder of models, as the stage does."""
    root = Path.cwd()
    (root / "dvc.lock").write_text(LOCK.replace("MD5", data))
    with tracking.run(stage="evaluate", experiment=name, name="n", params={}) as run:
        found = run.register(
            name,
            partial(packed, models, load),
            criteria=criteria,
            figures={"loss": 0.25},
            evaluation={"rollouts": {"steps": steps}},
            data=Path("data/tables/car"),
        )
    assert found is not None
    return found


def car(folder: Path, seed: int) -> Path:
    return write_addressed(folder / f"car-{seed}", untrained_model(drive(), seed=seed))


def champion(root: Path, name: str) -> str:
    return str(client(root).get_model_version_by_alias(name, "champion").version)


def test_the_first_figure_that_is_not_as_good_decides() -> None:
    other = {"horizon_seconds": 2.0, "one_step_percent": 1.0}
    assert is_better(reached(3.0, 9.0), other)
    assert not is_better(reached(1.0, 0.1), other)
    assert is_better(reached(2.0, 0.9), other)
    assert not is_better(reached(2.0, 1.0), other)
    near = (Criterion("horizon_seconds", 2.01, higher_is_better=True, tie=0.02), *reached(2.0, 1.1)[1:])
    assert not is_better(near, other)


def test_a_model_is_registered_once_and_its_metrics_are_linked_to_it(project: Path, tmp_path: Path) -> None:
    models = car(tmp_path, 0)
    first = evaluated("once", models, reached(2.0))
    assert (first.version, first.is_new) == ("1", True)
    server = client(project)
    before = server.get_model_version("once", "1").description
    again = evaluated("once", models, reached(2.0))
    assert (again.version, again.model_id, again.is_new) == ("1", first.model_id, False)
    assert again.why == "it is the champion still"
    assert server.get_model_version("once", "1").description == before
    logged = server.get_logged_model(first.model_id)
    assert {each.key: each.value for each in logged.metrics} == {
        "validation/horizon_seconds": 2.0, "validation/one_step_percent": 1.0, "test/loss": 0.25,
    }  # fmt: skip
    assert {(each.dataset_name, each.dataset_digest) for each in logged.metrics} == {("once", "0" * 32)}
    assert logged.params == {
        "kind": "transitions", "mode": "argmax", "history": "1", "step_seconds": "0.0333333", "candidate": "ensemble",
        "seed": "0", "variant": "plain",
    }  # fmt: skip
    (linked,) = json.loads(logged.tags["mlflow.modelVersions"])
    assert (linked["name"], str(linked["version"])) == ("once", "1")
    kept = project / ".mlflow" / "artifacts" / "once" / "models"
    assert len(list(kept.iterdir())) == 1


def test_another_mode_of_the_same_networks_is_another_version(project: Path, tmp_path: Path) -> None:
    model = untrained_model(drive())
    evaluated("modes", write_addressed(tmp_path / "argmax", model))
    model.mode = "mixture"
    assert evaluated("modes", write_addressed(tmp_path / "mixture", model)).version == "2"
    assert champion(project, "modes") == "1"


def test_the_champion_is_replaced_by_what_is_better_on_the_same_data_alone(project: Path, tmp_path: Path) -> None:
    models = [car(tmp_path, seed) for seed in range(6)]
    assert evaluated("judged", models[0], reached(2.0)).why == "it is the champion, because no other version was"
    worse = evaluated("judged", models[1], reached(1.0, 0.1))
    assert "version 1 stays the champion, because this one is no better" in worse.why
    assert "horizon_seconds 1 and not 2" in worse.why
    elsewhere = evaluated("judged", models[2], reached(9.0), data="1" * 32)
    assert "version 1 stays the champion, because it was measured on other data" in elsewhere.why
    shorter = evaluated("judged", models[3], reached(9.0), steps=5)
    assert "evaluated with other params" in shorter.why
    unmeasured = evaluated("judged", models[4])
    assert "not measured on validation data" in unmeasured.why
    assert champion(project, "judged") == "1"
    better = evaluated("judged", models[5], reached(2.0, 0.5))
    assert better.why.startswith("it is the champion in place of version 1, because it is better on validation data")
    assert (better.version, champion(project, "judged")) == ("6", "6")
    assert better.why in client(project).get_model_version("judged", "6").description


def test_what_was_measured_anew_can_be_compared_anew(project: Path, tmp_path: Path) -> None:
    first, second = car(tmp_path, 0), car(tmp_path, 1)
    evaluated("anew", first, reached(2.0), steps=5)
    assert "other params" in evaluated("anew", second, reached(3.0)).why
    assert evaluated("anew", first, reached(2.0)).why == "it is the champion still"
    assert evaluated("anew", second, reached(3.0)).why.startswith("it is the champion in place of version 1")
    assert champion(project, "anew") == "2"


@pytest.mark.usefixtures("project")
def test_a_model_that_cannot_be_packed_costs_a_warning_and_leaves_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with tracking.run(stage="evaluate", experiment="broken", name="n", params={}) as run:
        found = run.register(
            "broken", partial(packed, tmp_path, serving_transitions.load_served), criteria=(), figures={},
            evaluation={}, data=tmp_path,
        )  # fmt: skip
        run.log({"loss/test": 1.0}, step=0)
    assert found is None
    (warning,) = caplog.records
    assert warning.levelno == logging.WARNING
    assert "could not keep the delivered model of broken" in warning.getMessage()
    assert client(Path.cwd()).search_registered_models("name = 'broken'") == []


LOADING = """
import sys, warnings
warnings.simplefilter("ignore")
seen = []
sys.addaudithook(lambda event, _: seen.append(event) if event.startswith("pickle.") else None)
import mlflow
mlflow.set_tracking_uri(sys.argv[1])
model = mlflow.pyfunc.load_model(sys.argv[2], suppress_warnings=True)
frame = model.predict(model.input_example)
print(seen, list(frame), len(frame))
import pickle
pickle.loads(pickle.dumps(sys.exit))
assert seen, "the hook sees what is unpickled"
"""


@pytest.mark.slow
def test_the_champion_of_a_moved_project_loads_and_unpickles_nothing(project: Path, tmp_path: Path) -> None:
    evaluated("moved", write_trusted(tmp_path / "models"), reached(2.0))
    copy = Path(shutil.copytree(project, tmp_path / "copy"))
    uri = f"sqlite:///{copy / '.mlflow' / 'mlflow.db'}"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(copy)
        assert tracking.find_runs("moved", []) == {}  # the first use of a store tells it where it is
        shutil.rmtree(project / ".mlflow" / "artifacts" / "moved")
    done = subprocess.run(
        [warm_interpreter() / "python", "-c", LOADING, uri, "models:/moved@champion"],
        env=os.environ | {"PYTHONPATH": str(ROOT / "src")}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    names = [f"next_observation.{name}{end}" for end in ("", ".low", ".high") for name in ("position", "speed")]
    assert done.stdout.strip() == f"[] {[*names, 'trust']} 2"


def ask(port: int, question: dict[str, Any]) -> tuple[int, Any]:
    asked = urllib.request.Request(
        f"http://127.0.0.1:{port}/invocations", json.dumps(question).encode(), {"Content-Type": "application/json"}
    )
    try:
        with urllib.request.urlopen(asked, timeout=30) as answer:
            return answer.status, json.load(answer)
    except urllib.error.HTTPError as error:
        return error.code, json.load(error)


@contextmanager
def serving(project: Path, model: str) -> Iterator[int]:
    """Serve a model as its user does; the port. It ends by itself when it is asked to, and leaves the port free."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = ["-m", "mlflow", "models", "serve", "--model-uri", model, "--env-manager", "local",
               "--host", "127.0.0.1", "--port", str(port)]  # fmt: skip
    uri = f"sqlite:///{project / '.mlflow' / 'mlflow.db'}"
    environment = {**os.environ, "MLFLOW_TRACKING_URI": uri, "MLFLOW_DISABLE_TELEMETRY": "true"}
    environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{environment['PATH']}"
    server = subprocess.Popen(
        [sys.executable, *command], env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        start_new_session=True,
    )  # fmt: skip
    assert server.stdout is not None
    with server.stdout as lines:
        try:
            said = ""
            for line in lines:
                said += line
                if "Uvicorn running" in line:
                    break
            assert "Uvicorn running" in said, said
            yield port
        finally:
            os.killpg(server.pid, signal.SIGINT)
            rest = lines.read()  # ends when the last process that could write has ended
            server.wait()
    assert "Uvicorn running" not in rest
    with socket.socket() as again:
        again.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        again.bind(("127.0.0.1", port))


@pytest.mark.slow
def test_mlflow_serves_the_champion_over_http(project: Path, tmp_path: Path) -> None:
    models = write_trusted(tmp_path / "models")
    evaluated("served", models, reached(2.0))
    served = serving_transitions.load_served(models)
    with serving(project, "models:/served@champion") as port:
        rows = [{"observation.position": 0.5, "observation.speed": -1, "action.thrust": 0.25}]
        status, answer = ask(port, {"dataframe_records": rows, "params": {"coverage": 0.8}})
        assert status == 200, answer
        expected = served.predict({name: [value] for name, value in rows[0].items()}, {"coverage": 0.8})
        (found,) = answer["predictions"]
        assert found == pytest.approx(expected.iloc[0].to_dict())
        status, answer = ask(port, {"dataframe_records": [{**rows[0], "observation.speed": None}]})
        assert (status, "should be finite" in json.dumps(answer)) == (400, True)
        del rows[0]["observation.speed"]
        status, answer = ask(port, {"dataframe_records": rows})
        assert (status, "missing inputs ['observation.speed']" in json.dumps(answer)) == (400, True)


@pytest.mark.slow
def test_mlflow_serves_a_model_of_motion_over_http(project: Path, tmp_path: Path) -> None:
    models = write_addressed(tmp_path / "models", motion_model())
    evaluated("walker", models, reached(2.0), load=serving_motion.load_served)
    served = serving_motion.load_served(models)
    example = {name: values.tolist() for name, values in served.example().items()}
    rows = [dict(zip(example, values, strict=True)) for values in zip(*example.values(), strict=True)]
    with serving(project, "models:/walker@champion") as port:
        status, answer = ask(port, {"dataframe_records": rows})
        assert status == 200, answer
        expected = served.predict(example)
        assert len(expected.columns) == 311
        for row, found in enumerate(answer["predictions"]):
            assert found == pytest.approx(expected.iloc[row].to_dict(), rel=1e-5, abs=1e-5)
        del rows[1][served.inputs[-1].name], rows[0][served.inputs[-1].name]
        status, answer = ask(port, {"dataframe_records": rows})
        assert (status, f"missing inputs ['{served.inputs[-1].name}']" in json.dumps(answer)) == (400, True)
