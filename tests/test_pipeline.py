import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import numpy as np
import pytest
from pipeline_clones import KINDS, STAGES, dvc, edit_params, environment, new_clone, stages_run
from reading_pages import front_sentences, words_seen
from ruamel.yaml import YAML
from stage_dependencies import ROOT, first_party

from addressed_dynamics.base.params.experiments import load_experiment, load_recipes
from addressed_dynamics.cli.verdicts import verdict_lines
from addressed_dynamics.comparing.comparison import compare
from addressed_dynamics.comparing.revisions import find_revision, version_of


@pytest.mark.parametrize("experiment", KINDS)
def test_the_tiny_params_are_params(experiment: str) -> None:
    params = load_experiment(ROOT / "tests" / "tiny_params.yaml", experiment, KINDS[experiment])
    assert params.ensemble.epochs == 2


@pytest.mark.parametrize("file", ["params.yaml", "params/paper.yaml"])
def test_the_scales_are_params_and_name_themselves(file: str) -> None:
    for experiment, kind in KINDS.items():
        default, paper = load_recipes(ROOT / file, experiment, kind)
        assert default.recipe == "default"
        assert paper.features.target == "absolute"
        # So that every experiment that `recorded` names in params.yaml can be recorded at either scale.
        assert default.record is not None
    document = YAML(typ="safe", pure=True).load((ROOT / "params.yaml").read_text(encoding="utf-8"))
    assert document["params_file"] == "params.yaml"
    assert {name: each["kind"] for name, each in document["experiments"].items()} == KINDS


def pinned(lock: str) -> set[str]:
    """The packages in a lock, each at one version."""
    lines = (ROOT / lock).read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    form = r'[a-z0-9-]+==[0-9][0-9a-z.]*(; python_version < "3\.[0-9]+")?'
    assert all(re.fullmatch(form, pin) for pin in pins), "no build of one machine"
    return {pin.partition("==")[0] for pin in pins}


def names(requirements: list[str]) -> set[str]:
    return {re.split(r"[^A-Za-z0-9._-]", each)[0].lower().replace("_", "-").replace(".", "-") for each in requirements}


def test_the_locks_pin_every_declared_dependency_once() -> None:
    runs, checks = pinned("requirements.lock"), pinned("requirements-dev.lock")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    optional = project["optional-dependencies"]
    assert names(project["dependencies"] + optional["pipeline"]) <= runs
    assert names(optional["dev"]) - {project["name"]} <= runs | checks
    assert not runs & checks


def dependencies(stage: str, kind: str) -> set[str]:
    """The files and directories that a stage depends on, but for data."""
    document = YAML(typ="safe", pure=True).load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))
    deps = [dep.replace("${item.kind}", kind) for dep in document["stages"][stage]["do"]["deps"]]
    if stage == "record":
        deps = [dep.replace("${item}", kind) for dep in deps]
    named = [dep.replace("${src}", document["vars"][0]["src"]) for dep in deps]
    return {dep for dep in named if dep.startswith(("src/", "pipeline/"))}


TRACKING = ("__init__", "parents", "registry", "runs", "store", "ui", "views")
UNSEEN = {
    "pipeline/__init__.py",
    "src/addressed_dynamics/__init__.py",
    *(f"src/addressed_dynamics/tracking/{name}.py" for name in TRACKING),
}
"""What no stage depends on: the front door, and what is said to MLflow, which no output shows."""


@pytest.mark.parametrize(
    ("stage", "kind"),
    [*((stage, kind) for stage in STAGES for kind in ("transitions", "motion")), ("import", "transitions")],
)
def test_every_module_that_a_stage_imports_is_in_a_directory_that_it_depends_on(stage: str, kind: str) -> None:
    named = dependencies(stage, kind)
    script = {"import": "import_data"}.get(stage, stage)
    assert f"pipeline/{script}.py" in named
    assert all((ROOT / dep).exists() for dep in named)
    imported = first_party(ROOT, script, kind) - UNSEEN
    assert len(imported) > 5
    missing = [path for path in imported if not any(Path(path).is_relative_to(dep) for dep in named)]
    assert [path for path in missing if Path(path).name != "__init__.py"] == []


def test_lazy_imports_count_but_not_those_of_a_package_that_is_passed(tmp_path: Path) -> None:
    sources = {
        "pipeline/__init__.py": "",
        "pipeline/stage.py": "def main():\n    from addressed_dynamics.models.net import Net\n",
        "src/addressed_dynamics/__init__.py": "def __getattr__(name):\n    from addressed_dynamics import front\n",
        "src/addressed_dynamics/front.py": "",
        "src/addressed_dynamics/types.py": "",
        "src/addressed_dynamics/errors.py": "",
        "src/addressed_dynamics/models/__init__.py": "",
        "src/addressed_dynamics/models/net.py": (
            "from typing import TYPE_CHECKING\nfrom addressed_dynamics import errors\n"
            "if TYPE_CHECKING:\n    import addressed_dynamics.types\n"
        ),
    }
    for name, text in sources.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    not_run = {"src/addressed_dynamics/front.py", "src/addressed_dynamics/types.py"}
    assert first_party(tmp_path, "stage", "transitions") == set(sources) - not_run


@pytest.mark.slow
def test_the_pipeline_ends_in_a_report_metrics_and_tracked_runs(finished: Path) -> None:
    report = (finished / "data" / "reports" / "mountaincar" / "report.html").read_text(encoding="utf-8")
    assert "Table 1" in report
    assert len(report.encode()) < 4e6
    assert words_seen(report) < 2500
    assert len(front_sentences(report)) <= 6
    assert (finished / ".mlflow" / "mlflow.db").exists()
    shown = dvc(finished, "metrics", "show")
    assert all(name in shown for name in ("best_network_chosen_percent", "held_out_mae", "closed_loop_score"))
    plots = json.loads(dvc(finished, "plots", "show", "--json"))["data"]
    assert len(plots) == 7
    for title, (plot,) in plots.items():
        assert "DVC_METRIC" not in json.dumps(plot), title
        assert len(plot["content"]["data"]["values"]) > 1, title


@pytest.mark.slow
def test_what_dvc_keeps_of_an_evaluation_can_be_compared(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(finished)
    revision = find_revision(finished, "workspace")
    assert revision is not None
    assert {"evaluation.json", "arrays.npz"} <= set(revision.listing("data/evaluation/mountaincar"))
    found = version_of(revision, "mountaincar")
    assert found.notes == ()
    assert found.errors is not None
    assert found.errors.scale is not None
    assert compare(found, found).errors[0].said in {"the same", "no interval"}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of what MLflow uses of SQLAlchemy
def test_what_each_experiment_delivers_is_the_champion_of_its_registered_model(finished: Path) -> None:
    from mlflow import MlflowClient

    client = MlflowClient(f"sqlite:///{finished / '.mlflow' / 'mlflow.db'}")
    for experiment in KINDS:
        champion = client.get_model_version_by_alias(experiment, "champion")
        assert str(champion.version) == "1"
        model = client.get_logged_model(champion.source.removeprefix("models:/"))
        delivered = json.loads((finished / "data" / "models" / experiment / "delivered.json").read_text())
        kept = {name: model.params[name] for name in ("candidate", "seed", "mode")}
        assert kept == {name: str(delivered[name]) for name in kept}
        measured = {each.key.partition("/")[0] for each in model.metrics}
        assert "test" in measured
        lock = (finished / "dvc.lock").read_text(encoding="utf-8")
        assert all(f"md5: {each.dataset_digest}.dir" in lock for each in model.metrics)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of what MLflow uses of SQLAlchemy
def test_the_runs_of_an_experiment_are_nested_below_one_that_has_the_verdict(finished: Path) -> None:
    from mlflow import MlflowClient

    client = MlflowClient(f"sqlite:///{finished / '.mlflow' / 'mlflow.db'}")
    runs = client.search_runs([client.get_experiment_by_name("mountaincar").experiment_id])
    (above,) = (run for run in runs if run.data.tags["stage"] == "pipeline")
    below = [run for run in runs if run is not above]
    assert {run.data.tags["mlflow.parentRunId"] for run in below} == {above.info.run_id}
    assert {run.data.tags["stage"] for run in below} == {
        "train_ensemble", "train_addressing", "train_baselines", "evaluate", "train_policy", "report",
    }  # fmt: skip
    verdict = (finished / "data" / "reports" / "mountaincar" / "verdict.txt").read_text(encoding="utf-8").strip()
    assert above.data.tags["mlflow.note.content"].startswith(verdict)
    assert any(line.startswith(f"mountaincar: {verdict}") for line in verdict_lines(finished / "params.yaml"))


@pytest.mark.slow
def test_a_second_repro_runs_nothing(clone: Path) -> None:
    assert stages_run(dvc(clone, "repro")) == []


@pytest.mark.slow
def test_a_clone_on_which_nothing_was_compiled_sees_no_stage_as_changed(clone: Path) -> None:
    for folder in [*clone.rglob("__pycache__")]:
        shutil.rmtree(folder)
    assert "up to date" in dvc(clone, "status")


@pytest.mark.slow
def test_the_motion_ends_in_an_evaluation_of_every_model(finished: Path) -> None:
    folder = finished / "data" / "evaluation" / "pfnn"
    evaluation = json.loads((folder / "evaluation.json").read_text(encoding="utf-8"))
    groups = {each["group"] for each in evaluation["candidates"].values()}
    modes = {f"ensemble/{mode}" for mode in ("argmax", "sample", "mixture", "blend")}
    assert groups == modes | {"phase_functioned", "mean", "persistence", "ridge"}
    assert f"ensemble/{evaluation['delivered']['mode']}" in modes
    with np.load(folder / "arrays.npz") as arrays:
        assert arrays["loop.phase_functioned/seed-0.joint_position"].shape == (3600, 31, 3)


@pytest.mark.slow
def test_the_tiny_pipeline_of_motion_comes_to_what_it_came_to_before(finished: Path) -> None:
    """Its data are made up by a program, alike on every processor; a change of the record needs a reason."""
    golden = json.loads((ROOT / "tests" / "golden" / "tiny_motion.json").read_text(encoding="utf-8"))
    figures = finished / "data" / "figures" / "pfnn"
    data = json.loads((figures / "convert" / "data.json").read_text(encoding="utf-8"))
    trained = json.loads((figures / "ensemble" / "ensemble.json").read_text(encoding="utf-8"))
    evaluation = json.loads((finished / "data" / "evaluation" / "pfnn" / "evaluation.json").read_text(encoding="utf-8"))
    assert data["splits"] == golden["splits"]
    # Other processors round otherwise.
    assert trained["seed-0"]["loss/validation"] == pytest.approx(golden["validation_loss"], rel=0.01)
    errors = {name: each["one_step"]["test"]["raw"] for name, each in evaluation["candidates"].items()}
    assert errors == pytest.approx(golden["held_out_mae"], rel=0.01)


@pytest.mark.slow
def test_a_recording_stopped_by_ctrl_c_fails_and_commits_nothing(tmp_path: Path) -> None:
    clone = new_clone(tmp_path)
    edit_params(clone, "transitions: 800", "transitions: 10_000_000")
    partial = clone / "data" / "raw" / ".mountaincar.partial"
    with subprocess.Popen(
        [sys.executable, "-m", "dvc", "repro", "record@mountaincar"],
        cwd=clone,
        env=environment(clone),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
        # A shell's background jobs ignore Ctrl-C, and so would what they start.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as running:
        while running.poll() is None and not any(partial.glob("*.mcap")):  # the first shard is full
            time.sleep(0.05)
        os.killpg(running.pid, signal.SIGINT)  # as a terminal does: DVC and the stage both
        output, _ = running.communicate()
    assert running.returncode != 0
    assert "interrupted; what was recorded stays in" in output
    assert "Traceback" not in output
    assert not (clone / "dvc.lock").exists()


@pytest.mark.slow
def test_an_imported_experiment_is_converted_like_a_recorded_one_and_follows_its_files(tmp_path: Path) -> None:
    clone = new_clone(tmp_path)
    rows = [f"{episode},{step / 10},{step % 2}" for episode in range(6) for step in range(20)]
    (clone / "logs").mkdir()
    (clone / "logs" / "arm.csv").write_text("\n".join(["episode,angle,push", *rows]))
    yaml = YAML()
    document = yaml.load((clone / "params.yaml").read_text(encoding="utf-8"))
    arm = {key: value for key, value in document["mountaincar"].items() if key != "record"}
    arm["source"] = {
        "kind": "csv",
        "files": ["logs/*.csv"],
        "observation": {"angle": {"field": "angle", "unit": "rad"}},
        "action": {"discrete": {"field": "push", "names": ["left", "right"]}},
        "reward": None,
        "rate_hz": 10.0,
        "episode": {"by": "column", "column": "episode"},
        "min_length": 2,
    }
    document |= {"arm": arm, "imported": {"arm": "logs"}}
    document["experiments"]["arm"] = {"kind": "transitions", "raw": "data/raw/arm"}
    yaml.dump(document, clone / "params.yaml")
    assert stages_run(dvc(clone, "repro", "convert@arm")) == ["import@arm", "convert@arm"]
    report = json.loads((clone / "data" / "figures" / "arm" / "convert" / "data.json").read_text(encoding="utf-8"))
    assert report["import"]["totals"]["transitions"] == 6 * 19
    assert stages_run(dvc(clone, "repro", "convert@arm")) == []
    (clone / "logs" / "more.csv").write_text("\n".join(["episode,angle,push", *rows]))
    assert stages_run(dvc(clone, "repro", "convert@arm")) == ["import@arm", "convert@arm"]
