"""Numbers that params leave to validation, through all stages that come after."""

import json
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from example_params import EXAMPLE, write_params
from learning import sail

from addressed_dynamics import AddressedDynamics, tracking, write_log
from addressed_dynamics.base.errors import ModelError
from pipeline import choosing, convert, evaluate, report, train_addressing, train_baselines, train_ensemble
from pipeline.stage import Call
from pipeline.trainings import trained_members

STAGES = (convert, train_ensemble, train_addressing, train_baselines, evaluate, report)


class NoRun:
    """A run that nobody looks at."""

    def log(self, *_: object, **__: object) -> None:
        """Leave out what is logged."""

    log_dataset = log_output = log_artifact = log_arrays = register = conclude = log


def section() -> dict[str, Any]:
    """The section of an experiment that leaves to validation what can be left to it, and is over in seconds."""
    tiny = {key: value for key, value in EXAMPLE.items() if key not in ("record", "paper")}
    optimiser = EXAMPLE["ensemble"]["optimiser"] | {"learning_rate": 0.01}
    ensemble = {"seeds": [0, 1], "members": "auto", "epochs": 4, "cluster_epochs": 1, "optimiser": optimiser}
    return tiny | {
        "title": "A boat of which nobody logs the speed",
        "features": {"target": "change", "history": "auto"},
        "ensemble": tiny["ensemble"] | ensemble,
        "baselines": tiny["baselines"] | {"train": ["total_parameters", "other_recipe"], "single_networks": {}},
        "evaluation": {"rollouts": {"kind": "recorded", "episodes": 4, "steps": 10, "seed": 0}},
    }


@pytest.fixture(scope="module", params=[1, 4])
def members(request: pytest.FixtureRequest) -> int:
    """The number that is chosen."""
    number: int = request.param
    return number


@pytest.fixture(scope="module")
def finished(members: int, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """A folder in which all stages have run, and what they said."""
    folder = tmp_path_factory.mktemp("boat")
    boat = sail((60,) * 12, seed=4)
    spec = replace(boat.spec, observation=boat.spec.observation[:1], exogenous=())
    hidden = replace(
        boat, spec=spec, observation=boat.observation[:, :1], next_observation=boat.next_observation[:, :1],
        exogenous=boat.exogenous[:, :0],
    )  # fmt: skip
    threads = torch.get_num_threads()
    with pytest.MonkeyPatch.context() as patch:

        def run(**_: object) -> AbstractContextManager[NoRun]:
            return nullcontext(NoRun())

        patch.chdir(folder)
        patch.setattr(tracking, "run", run)
        patch.setenv("ADDRESSED_DYNAMICS_PROCESSES", "1")
        patch.setattr(choosing, "best_number", lambda losses: members if len(losses) == 4 else 0)
        raw = Path("data/raw/boat")
        raw.mkdir(parents=True)
        write_log(raw / "boat.mcap", hidden)
        params = write_params(Path("params.yaml"), boat=section())
        try:
            said = [str(stage.main(Call("boat", params, "transitions", raw))) for stage in STAGES]
        finally:
            torch.set_num_threads(threads)
            torch.set_flush_denormal(False)
    return folder, said


def test_the_first_seed_decides_for_all_and_the_figures_say_by_what(
    finished: tuple[Path, list[str]], members: int
) -> None:
    folder, said = finished
    index = json.loads((folder / "data/models/boat/ensemble/ensemble.json").read_text())
    assert index == {"format": 1, "seeds": [0, 1], "members": members}
    choices = json.loads((folder / "data/figures/boat/ensemble/ensemble.json").read_text())["choices"]
    assert choices["members"]["chosen"] == members
    assert list(choices["members"]["tried"]) == ["1", "2", "4", "8"]
    assert choices["members"]["tried"]["1"]["agreement"] == 1.0
    assert choices["history"]["chosen"] == 2
    assert f"members {members} (1: " in said[1]
    assert "history 2 (1: " in said[1]


def test_no_checkpoint_is_left_of_any_training(finished: tuple[Path, list[str]]) -> None:
    assert [each for each in (finished[0] / ".checkpoints").rglob("*") if each.is_file()] == []


def test_the_networks_say_what_was_chosen_and_not_that_it_was_left_open(
    finished: tuple[Path, list[str]], members: int
) -> None:
    models = finished[0] / "data/models/boat"
    for folder in (models / "ensemble/seed-0", models / "ensemble/seed-1"):
        notes = json.loads((folder / "config.json").read_text())["notes"]
        assert notes["params"]["ensemble"]["members"] == members
        assert notes["params"]["features"]["history"] == 2
    model = AddressedDynamics.load(models, candidate="ensemble")
    assert model.ensemble.members == members
    assert model.features.history == 2


def test_baselines_are_as_large_as_the_members_that_were_chosen(finished: tuple[Path, list[str]], members: int) -> None:
    models = finished[0] / "data/models/boat"
    model, one, other = (
        AddressedDynamics.load(models, candidate=each) for each in ("ensemble", "total_parameters", "paper_recipe")
    )
    assert model.addressing is not None
    whole = model.ensemble.parameters_total + model.addressing.parameters_total
    assert one.ensemble.parameters_total == pytest.approx(whole, rel=0.05)
    assert other.ensemble.members == members
    assert other.features.history == 2


def test_a_single_member_is_addressed_by_the_smallest_network(finished: tuple[Path, list[str]], members: int) -> None:
    addressing = AddressedDynamics.load(finished[0] / "data/models/boat", candidate="ensemble").addressing
    assert addressing is not None
    assert (len(addressing.widths) == 2) == (members == 1)


def test_all_candidates_are_evaluated_and_reported(finished: tuple[Path, list[str]]) -> None:
    found = json.loads((finished[0] / "data/evaluation/boat/evaluation.json").read_text())
    assert {"ensemble/argmax", "total_parameters/seed-0", "paper_recipe/seed-0"} <= set(found["candidates"])
    assert all(np.isfinite(each["one_step"]["scaled"]["mean"]) for each in found["candidates"].values())
    assert (finished[0] / "data/reports/boat/report.html").is_file()


def test_an_index_of_an_earlier_version_is_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folder = Path("data/models/boat/ensemble")
    folder.mkdir(parents=True)
    (folder / "ensemble.json").write_text('{"format": 1, "seeds": [0]}')
    with pytest.raises(ModelError, match="run train_ensemble again"):
        trained_members("boat")
