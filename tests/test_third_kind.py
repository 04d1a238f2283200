"""A kind of data that lives here alone goes through all stages to a report, without an edit anywhere else."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from pipeline_clones import dvc, new_clone, stages_run
from ruamel.yaml import YAML
from stage_dependencies import ROOT

LAYERS = ("sources", "features", "evaluation", "reporting")
STAGES = ("convert", "train_ensemble", "train_addressing", "train_baselines", "evaluate", "train_policy", "report")


@pytest.mark.slow
def test_a_made_up_kind_of_data_goes_through_all_stages_to_a_report(tmp_path: Path) -> None:
    clone = new_clone(tmp_path)
    package = clone / "src" / "addressed_dynamics"
    before = {path: path.read_bytes() for path in package.rglob("*.py")}
    for layer in LAYERS:
        shutil.copytree(ROOT / "tests" / "thermostat" / layer, package / layer / "thermostat")
    (clone / "rooms").mkdir()
    np.savetxt(clone / "rooms" / "room.txt", 20 + np.sin(np.arange(400) / 9))
    yaml = YAML()
    document = yaml.load((clone / "params.yaml").read_text(encoding="utf-8"))
    car = document["mountaincar"]
    room = {
        "title": "A room",
        "paper": None,
        "recipe": "default",
        "paper_recipe": {},
        "convert": {"test_share": 0.25},
        "features": {"scale": 20.0},
        "evaluation": {"worst": True},
        "policy": None,
        **{name: car[name] for name in ("ensemble", "addressing")},
        "baselines": {**car["baselines"], "train": ["total_parameters", "unequal_bins"]},
    }
    experiments = {"room": {"kind": "thermostat", "raw": "rooms"}}
    yaml.dump(document | {"room": room, "experiments": experiments, "recorded": {}}, clone / "params.yaml")

    assert sorted(stages_run(dvc(clone, "repro"))) == sorted(f"{stage}@room" for stage in STAGES)

    evaluation = json.loads((clone / "data" / "evaluation" / "room" / "evaluation.json").read_text(encoding="utf-8"))
    report = (clone / "data" / "reports" / "room" / "report.md").read_text(encoding="utf-8")
    assert f"The room is off by {evaluation['mean_error']:.3g} degrees." in report
    assert "worst_error" in report
    titles = [line.removeprefix("## ") for line in report.splitlines() if line.startswith("## ")]
    assert titles == ["Errors", "Training", "What was run"]
    assert "epochs, bins by Algorithm 1" in report
    assert "*validation loss, best network (validation)*" in report
    assert {path: path.read_bytes() for path in before} == before
