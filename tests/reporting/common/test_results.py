import json
from pathlib import Path

import numpy as np
import pytest
from report_examples import FILES, NEEDED, origin, transitions_report, write_results

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.reporting.common.missing import remedy_of
from addressed_dynamics.reporting.common.render import render_markdown
from addressed_dynamics.reporting.transitions.results import load_results


def refusal(folder: Path) -> str:
    with pytest.raises(ReportError) as caught:
        load_results(folder / "figures", folder / "evaluation")
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_what_was_written_is_read(tmp_path: Path) -> None:
    results = load_results(*write_results(tmp_path))
    assert results.evaluation.table.agreement == 0.97
    assert results.horizon["all"]["wide/seed-0"]["horizon"].tolist() == [10, 20]
    assert len(results.arrays.chosen) == 300


@pytest.mark.parametrize("name", NEEDED)
def test_a_missing_file_is_named(tmp_path: Path, name: str) -> None:
    write_results(tmp_path)
    (tmp_path / name).unlink()
    path = tmp_path / name
    assert refusal(tmp_path) == f"{path}: missing, so there is nothing to report; '{remedy_of(path)}' makes it"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("learner.csv", "The returns of the agent are missing in these results: 'dvc repro convert@mountaincar'"),
        ("ensemble.csv", "The curves of phase 1 are missing in these results: 'dvc repro train_ensemble@mountaincar'"),
        (
            "addressing.csv",
            "The curves of phase 2 are missing in these results: 'dvc repro train_addressing@mountaincar",
        ),
        ("horizon.csv", "The errors against the length of rollouts are missing in these results: 'dvc repro evaluate@"),
    ],
)
def test_a_missing_curve_is_named_in_its_place_with_the_command_that_makes_it(
    tmp_path: Path, name: str, said: str
) -> None:
    results = write_results(tmp_path)
    (tmp_path / FILES[name]).unlink()
    assert said in render_markdown(transitions_report(load_results(*results), origin(), None))


@pytest.mark.parametrize(
    ("path", "command"),
    [
        ("data/figures/arm/convert/data.json", "dvc repro convert@arm"),
        ("data/figures/arm/ensemble/ensemble.csv", "dvc repro train_ensemble@arm"),
        ("data/evaluation/arm/evaluation.json", "dvc repro evaluate@arm"),
    ],
)
def test_the_command_that_makes_a_file_follows_from_its_place(path: str, command: str) -> None:
    assert remedy_of(Path(path)) == command


@pytest.mark.parametrize("name", FILES.values())
def test_a_damaged_file_is_named(tmp_path: Path, name: str) -> None:
    write_results(tmp_path)
    (tmp_path / name).write_bytes(b"\xff\xfe not what it was")
    assert refusal(tmp_path).startswith(f"{tmp_path / name}: ")


def test_a_missing_key_is_named_with_its_path(tmp_path: Path) -> None:
    write_results(tmp_path)
    document = json.loads((tmp_path / FILES["evaluation.json"]).read_text())
    del document["candidates"]["ensemble/argmax"]["one_step"]["scaled"]["mean"]
    (tmp_path / FILES["evaluation.json"]).write_text(json.dumps(document))
    assert "candidates.ensemble/argmax.one_step.scaled.mean: Field required" in refusal(tmp_path)


def test_rollouts_without_a_group_of_all_are_refused(tmp_path: Path) -> None:
    write_results(tmp_path)
    document = json.loads((tmp_path / FILES["evaluation.json"]).read_text())
    groups = document["candidates"]["ensemble/argmax"]["rollouts"]["groups"]
    groups["everything"] = groups.pop("all")
    (tmp_path / FILES["evaluation.json"]).write_text(json.dumps(document))
    assert "candidates.ensemble/argmax.rollouts: Value error, there is no group 'all'" in refusal(tmp_path)


def test_a_delivered_model_that_was_not_measured_is_refused(tmp_path: Path) -> None:
    write_results(tmp_path, delivered={"seed": 5, "variant": "plain"})
    assert "seed 5 with plain addressing was not measured; run evaluate again" in refusal(tmp_path)


@pytest.mark.parametrize(
    ("header", "said"), [("training,epoch,other", "no column 'loss/train'"), ("x,y,z", "training")]
)
def test_a_curve_without_its_columns_is_refused(tmp_path: Path, header: str, said: str) -> None:
    write_results(tmp_path)
    (tmp_path / FILES["ensemble.csv"]).write_text(f"{header}\nseed-0,1,2\n")
    assert said in refusal(tmp_path)


def test_a_curve_with_words_for_numbers_is_refused(tmp_path: Path) -> None:
    write_results(tmp_path)
    (tmp_path / FILES["horizon.csv"]).write_text("model,group,horizon\nwide/seed-0,all,ten\n")
    assert "a cell is not a number" in refusal(tmp_path)


def test_arrays_of_something_else_are_refused(tmp_path: Path) -> None:
    _, arrays = write_results(tmp_path)
    np.savez(arrays / "arrays.npz", observation=np.zeros(3))
    assert "not the arrays that the evaluate stage writes" in refusal(tmp_path)
