import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from projects import begin_project, commit, errors_by_episode, evaluation, git, write_results

from addressed_dynamics.comparing.asking import compare_all
from addressed_dynamics.comparing.comparison import Comparison
from addressed_dynamics.comparing.page import page, write_page
from addressed_dynamics.comparing.versions import ComparisonError


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    root = begin_project(tmp_path / "project", monkeypatch)
    git(root, "tag", "first")
    return root


def only(first: str, second: str) -> Comparison:
    (found,) = compare_all(first, second)
    return found


def test_only_params_that_differ_are_named_with_the_defaults_that_they_are_beside(project: Path) -> None:
    write_results(project, epochs=5)
    text = (project / "params.yaml").read_text()
    (project / "params.yaml").write_text(text.replace("epochs: 5", "epochs: 5, batch_size: 7"))
    commit(project, "Train longer")
    changed = {each.name: (each.first, each.second) for each in only("first", "main").params}
    assert changed["ensemble.epochs"] == (3, 5)
    assert changed["ensemble.batch_size"] == (64, 7)
    assert set(changed) == {"ensemble.epochs", "ensemble.batch_size"}


def test_a_lower_error_on_the_same_episodes_is_called_lower(project: Path) -> None:
    write_results(project, epochs=5, arrays=errors_by_episode(0.49, 0.1))
    commit(project, "Improve")
    found = only("first", "main")
    one_step = found.errors[0]
    assert one_step.measure == "one step [% of the range]"
    assert one_step.said == "lower"
    assert one_step.how == "paired over the same test episodes"
    assert one_step.ratio is not None
    assert one_step.ratio.value == pytest.approx(0.7, rel=0.05)
    kept = errors_by_episode()
    assert one_step.first == pytest.approx(
        100 * np.sqrt(kept["paired_one_step"][0].sum() / kept["paired_samples"].sum())
    )
    rollouts = next(each for each in found.errors if each.measure == "rollouts [% of the range]")
    squared = kept["paired_rollouts"][0] / np.array([2.0, 4.0]) ** 2
    assert rollouts.first == pytest.approx(100 * np.sqrt(np.median(squared.mean(axis=1))))
    assert "lower" in found.verdict


def test_nothing_is_called_better_where_other_episodes_could_turn_it_round(project: Path) -> None:
    write_results(project, arrays=errors_by_episode(0.65, 1.0))
    commit(project, "Try")
    found = only("first", "main")
    assert found.errors[0].said == "may be chance"
    assert "neither is called better" in found.verdict
    assert "lower" not in found.verdict


def test_the_same_twice_is_said_to_be_the_same_once(project: Path) -> None:
    assert project.is_dir()
    for name in ("HEAD", "workspace"):
        (found,) = compare_all(name, name)
        assert found.notes[0] == "A and B are the same, so nothing can differ"
        assert len(found.notes) == len(set(found.notes))
        assert (found.params, found.data, found.code) == ((), (), ())


def test_on_other_data_the_interval_is_unpaired_and_says_so(project: Path) -> None:
    write_results(project, tables="t2", arrays=errors_by_episode(0.49))
    commit(project, "Record more")
    found = only("first", "main")
    assert {each.how for each in found.errors} == {"unpaired: the test episodes differ"}
    assert [each.name for each in found.data] == ["data/raw/car", "data/tables/car"]


def test_without_errors_by_episode_no_interval_is_given(project: Path) -> None:
    write_results(project, arrays={"frames": np.zeros(3)})
    commit(project, "Keep less")
    found = only("first", "main")
    assert found.errors == ()
    assert any("no interval can be given" in note for note in found.notes)
    assert "neither is called better" in found.verdict


def test_what_is_not_in_the_cache_is_named_with_the_command_that_brings_it_back(project: Path) -> None:
    write_results(project, epochs=5)
    commit(project, "Train longer")
    shutil.rmtree(project / ".dvc" / "cache")
    (note,) = (note for note in only("first", "workspace").notes if "DVC's cache" in note and note.startswith("first:"))
    assert note == (
        "first: data/evaluation/car is not in DVC's cache: 'git checkout first', then 'dvc repro evaluate@car' "
        "brings it back"
    )
    with (project / ".dvc" / "config").open("a") as config:
        config.write("['remote \"store\"']\n    url = s3://a-bucket/cars\n")
    (note,) = (note for note in only("first", "workspace").notes if "DVC's cache" in note and note.startswith("first:"))
    assert "'dvc pull evaluate@car' or 'dvc repro evaluate@car'" in note


def test_the_summary_and_the_code_are_compared_without_the_cache(project: Path) -> None:
    write_results(project, epochs=5, code="c2")
    commit(project, "Train longer")
    shutil.rmtree(project / ".dvc" / "cache")
    found = only("first", "main")
    assert [(each.name, each.first, each.second) for each in found.figures] == [("one_step_rmse_percent", 3.0, 5.0)]
    assert [each.name for each in found.code] == ["src/base"]


def test_a_dvc_experiment_is_found_by_its_name(project: Path) -> None:
    write_results(project, epochs=9)
    experiment = commit(project, "dvc: commit experiment")
    git(project, "update-ref", f"refs/exps/77/0f6a/{'pale-hare'}", experiment)
    git(project, "reset", "--quiet", "--hard", "first")
    found = only("first", "pale-hare")
    assert found.second.what.startswith("DVC experiment pale-hare, ")
    assert [each.second for each in found.params] == [9]


def test_results_of_other_params_than_those_beside_them_are_named(project: Path) -> None:
    text = (project / "params.yaml").read_text()
    (project / "params.yaml").write_text(text.replace("epochs: 3", "epochs: 4"))
    (note,) = (note for note in only("first", "workspace").notes if "params changed" in note)
    assert note.startswith("workspace: params changed after its results were made (train_ensemble)")
    assert "dvc repro report@car" in note


def test_files_of_another_revision_in_the_workspace_are_named(project: Path) -> None:
    assert not any("dvc.lock" in note for note in only("first", "workspace").notes)
    (project / "data" / "evaluation" / "car" / "evaluation.json").write_text('{"candidates": {}}')
    assert any("is not what dvc.lock says" in note for note in only("first", "workspace").notes)


def test_an_evaluation_of_another_version_is_compared_as_far_as_it_goes(project: Path) -> None:
    report = evaluation()
    report.pop("trust")
    report.pop("recommendation")
    write_results(project, report=report, arrays={**errors_by_episode(0.5), "paired_scale": np.array([2.0, 4.0])})
    commit(project, "Go back")
    assert only("first", "main").errors[0].said == "lower"


def test_params_that_are_refused_today_are_compared_as_they_are_written(project: Path) -> None:
    text = (project / "params.yaml").read_text()
    (project / "params.yaml").write_text(text.replace("epochs: 3", "epochs: 3, gone: 1"))
    commit(project, "Keep an old key")
    found = only("first", "main")
    assert ("ensemble.gone", None, 1) in [(each.name, each.first, each.second) for each in found.params]
    assert any("of another version" in note and "car.ensemble.gone" in note for note in found.notes)


@pytest.mark.usefixtures("project")
@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        ("nothing", "main", "nothing: there is no commit"),
        ("main", "--upload-pack=x", "--upload-pack=x: there is no commit"),
    ],
)
def test_what_is_not_there_is_an_error(first: str, second: str, message: str) -> None:
    with pytest.raises(ComparisonError, match=message):
        compare_all(first, second)


def test_revisions_without_a_common_experiment_are_an_error(project: Path) -> None:
    text = (project / "params.yaml").read_text()
    (project / "params.yaml").write_text(text.replace("car:", "cart:"))
    commit(project, "Rename")
    with pytest.raises(ComparisonError, match="no experiment that both have: first has car; main has cart"):
        compare_all("first", "main")
    with pytest.raises(ComparisonError, match="main: there is no experiment 'car' in it"):
        compare_all("first", "main", ["car"])


def test_a_folder_without_git_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    with pytest.raises(ComparisonError, match="not a Git repository"):
        compare_all("HEAD", "workspace")


def test_the_page_has_every_figure_and_loads_nothing(project: Path, tmp_path: Path) -> None:
    write_results(project, epochs=5, tables="t2", arrays=errors_by_episode(0.49))
    commit(project, "Improve")
    found = compare_all("first", "main")
    assert [section.title for section in page(found).sections] == [
        "In short", "Params", "Data", "Code", "Figures", "All models",
    ]  # fmt: skip
    write_page(found, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    for shown in ("ensemble.epochs", "data/tables/car", "one_step_rmse_percent", "unpaired", "the ensemble", "lower"):
        assert shown in text
    assert not re.findall(r"""(?:src|href)=(?!["']?(?:#|data:))[^>]*|@import|url\(""", text)
