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

import pytest
from pipeline_clones import (
    EXPERIMENTS,
    MOTION_EXPERIMENTS,
    MOTION_STAGES,
    STAGES,
    dvc,
    edit_params,
    environment,
    new_clone,
    stages_run,
)
from ruamel.yaml import YAML
from stage_dependencies import ROOT, first_party, is_data

from addressed_dynamics.base.params.experiments import load_motion_params, load_motion_recipes, load_params


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clone in which the pipeline has run once for all environments (tests/test_motion_pipeline.py has motion)."""
    clone = new_clone(tmp_path_factory.mktemp("clone"))
    edit_params(clone, "motions: {pfnn: data/raw/pfnn}", "motions: {}")
    edit_params(clone, "made_up: [pfnn]", "made_up: []")
    expected = [f"{stage}@{experiment}" for stage in STAGES for experiment in EXPERIMENTS]
    assert sorted(stages_run(dvc(clone, "repro"))) == sorted(expected)
    return clone


@pytest.fixture
def clone(finished: Path, tmp_path: Path) -> Path:
    """A copy of the finished clone, to change."""
    return Path(shutil.copytree(finished, tmp_path / "clone", symlinks=True))


def test_the_tiny_params_are_params() -> None:
    assert load_params(ROOT / "tests" / "tiny_params.yaml", "mountaincar").ensemble.epochs == 2
    assert load_motion_params(ROOT / "tests" / "tiny_params.yaml", "pfnn").ensemble.epochs == 2


@pytest.mark.parametrize("file", ["params.yaml", "params/paper.yaml"])
def test_the_scales_are_params_and_name_themselves(file: str) -> None:
    for experiment in EXPERIMENTS:
        load_params(ROOT / file, experiment)
    for experiment in MOTION_EXPERIMENTS:
        default, paper = load_motion_recipes(ROOT / file, experiment)
        assert default.recipe == "default"
        assert paper.features.target == "absolute"
        # So that every experiment that `made_up` names in params.yaml can be made up at either scale.
        assert default.walker is not None
    document = YAML(typ="safe", pure=True).load((ROOT / "params.yaml").read_text(encoding="utf-8"))
    assert document["params_file"] == "params.yaml"


def pinned(lock: str) -> set[str]:
    """The packages in a lock, each at one version."""
    lines = (ROOT / lock).read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    assert all(re.fullmatch(r"[a-z0-9-]+==[0-9][0-9a-z.]*", pin) for pin in pins), "no build of one machine"
    return {pin.partition("==")[0] for pin in pins}


def names(requirements: list[str]) -> set[str]:
    return {re.split(r"[^A-Za-z0-9._-]", each)[0].lower().replace("_", "-").replace(".", "-") for each in requirements}


def test_the_locks_pin_every_declared_dependency_once() -> None:
    runs, checks = pinned("requirements.lock"), pinned("requirements-dev.lock")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    optional = project["optional-dependencies"]
    assert names(project["dependencies"] + optional["pipeline"]) <= runs
    assert names(optional["dev"]) <= runs | checks
    assert not runs & checks


@pytest.mark.parametrize("stage", [*STAGES, "import_logs", *MOTION_STAGES])
def test_a_stage_depends_on_exactly_the_modules_that_it_imports(stage: str) -> None:
    document = YAML(typ="safe", pure=True).load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))
    definition = document["stages"][stage]
    named = {dep for dep in definition.get("do", definition)["deps"] if not is_data(dep)}
    assert f"pipeline/{stage}.py" in named
    assert named == first_party(ROOT, stage), "'make deps' writes them"


def test_lazy_imports_count_but_not_those_of_a_package_that_is_passed(tmp_path: Path) -> None:
    sources = {
        "pipeline/__init__.py": "",
        "pipeline/stage.py": "def main():\n    from addressed_dynamics.models.net import Net\n",
        "src/addressed_dynamics/__init__.py": "def __getattr__(name):\n    from addressed_dynamics import front\n",
        "src/addressed_dynamics/front.py": "",
        "src/addressed_dynamics/types.py": "",
        "src/addressed_dynamics/base/errors.py": "",
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
    assert first_party(tmp_path, "stage") == set(sources) - not_run


@pytest.mark.slow
def test_the_pipeline_ends_in_a_report_metrics_and_tracked_runs(finished: Path) -> None:
    report = (finished / "data" / "reports" / "mountaincar" / "report.html").read_text(encoding="utf-8")
    assert "Table 1" in report
    assert (finished / ".mlflow" / "mlflow.db").exists()
    assert "evaluation.json" in dvc(finished, "metrics", "show")


@pytest.mark.slow
def test_a_second_repro_runs_nothing(clone: Path) -> None:
    assert stages_run(dvc(clone, "repro")) == []


@pytest.mark.slow
def test_a_change_of_the_addressing_runs_addressing_evaluation_and_report_again(clone: Path) -> None:
    edit_params(clone, "variants: [plain, cost_sensitive]", "variants: [cost_sensitive]")
    ran = stages_run(dvc(clone, "repro"))
    assert ran == ["train_addressing@mountaincar", "evaluate@mountaincar", "report@mountaincar"]


@pytest.mark.slow
def test_an_edit_of_one_module_concerns_exactly_the_stages_that_import_it(clone: Path) -> None:
    edited = "src/addressed_dynamics/tracking.py"
    (clone / edited).write_text((clone / edited).read_text(encoding="utf-8") + "# edited\n", encoding="utf-8")
    changed = {line.removesuffix(":") for line in dvc(clone, "status").splitlines() if line.endswith("@mountaincar:")}
    assert changed == {f"{stage}@mountaincar" for stage in STAGES if edited in first_party(ROOT, stage)}


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
    document |= {"arm": arm, "experiments": ["mountaincar", "arm"], "imported": {"arm": "logs"}}
    yaml.dump(document, clone / "params.yaml")
    assert stages_run(dvc(clone, "repro", "convert@arm")) == ["import_logs@arm", "convert@arm"]
    report = json.loads((clone / "data" / "reports" / "arm" / "data.json").read_text(encoding="utf-8"))
    assert report["import"]["totals"]["transitions"] == 6 * 19
    assert stages_run(dvc(clone, "repro", "convert@arm")) == []
    (clone / "logs" / "more.csv").write_text("\n".join(["episode,angle,push", *rows]))
    assert stages_run(dvc(clone, "repro", "convert@arm")) == ["import_logs@arm", "convert@arm"]
