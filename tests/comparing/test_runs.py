import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from projects import begin_project, errors_by_episode, evaluation

from addressed_dynamics import tracking
from addressed_dynamics.base.errors import TrackingError
from addressed_dynamics.comparing.asking import compare_all
from addressed_dynamics.comparing.versions import ComparisonError
from addressed_dynamics.tracking.kept import find_run


def track(root: Path, name: str, epochs: int, factor: float, experiment: str = "car") -> str:
    """Keep an evaluation as the pipeline does; return the identifier of its run."""
    report = root / "evaluation.json"
    report.write_text(json.dumps(evaluation()))
    with tracking.run(
        stage="evaluate", experiment=experiment, name=name, params={"epochs": epochs}, tags={"data_md5": "t1"}
    ) as run:
        run.log({"loss/test": factor}, step=0)
        run.log_artifact(report)
        run.log_arrays("episodes", errors_by_episode(factor, 0.1))
    assert run.id is not None
    return run.id


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with pytest.MonkeyPatch.context() as patch:
        root = begin_project(tmp_path_factory.mktemp("tracked") / "project", patch)
        track(root, "first", 3, 1.0)
        track(root, "second", 5, 0.49)
        track(root, "other", 5, 0.49, "cart")
        yield root


@pytest.mark.usefixtures("store")
def test_two_runs_are_compared_in_params_metrics_and_errors_by_episode() -> None:
    (found,) = compare_all("first", "second")
    assert [(each.name, each.first, each.second) for each in found.params] == [("epochs", "3", "5")]
    assert ("loss/test", 1.0, 0.49) in [(each.name, each.first, each.second) for each in found.figures]
    assert found.errors[0].said == "lower"
    assert found.errors[0].how == "paired over the same test episodes"


@pytest.mark.usefixtures("store")
def test_runs_of_different_experiments_are_an_error() -> None:
    with pytest.raises(ComparisonError, match="first is of the experiment 'car', other of 'cart'"):
        compare_all("first", "other")


@pytest.mark.usefixtures("store")
def test_a_run_is_found_by_its_name_whatever_quotes_are_in_it() -> None:
    for name in ('with "two"', "with 'one'", "with \"two\" and 'one'"):
        assert find_run(name) is None
        with tracking.run(stage="train_ensemble", experiment="quotes", name=name, params={"rate": 1}):
            pass
        found = find_run(name)
        assert found is not None
        assert found.name == name


@pytest.mark.usefixtures("store")
def test_without_mlflow_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mlflow", None)
    with pytest.raises(
        TrackingError, match=r"^first: no revision .* needs 'mlflow': pip install 'addr.*\[pipeline\]'$"
    ):
        compare_all("first", "second")


@pytest.mark.usefixtures("store")
def test_a_revision_and_a_run_are_an_error() -> None:
    with pytest.raises(ComparisonError, match="HEAD is a revision, first a run in MLflow"):
        compare_all("first", "HEAD")


def test_a_name_that_several_runs_have_is_an_error_with_their_identifiers(store: Path) -> None:
    runs = [track(store, "twice", 3, factor) for factor in (1.0, 0.49)]
    with pytest.raises(TrackingError, match="several runs") as caught:
        compare_all("first", "twice")
    assert all(run in str(caught.value) for run in runs)
    (found,) = compare_all(*runs)
    assert found.errors[0].said == "lower"


@pytest.mark.usefixtures("store")
def test_a_run_of_a_training_has_no_interval() -> None:
    for name, rate in (("slow", 1e-4), ("fast", 1e-3)):
        with tracking.run(stage="train_ensemble", experiment="car", name=name, params={"rate": rate}) as run:
            run.log({"loss/validation": rate}, step=0)
    (found,) = compare_all("slow", "fast")
    assert found.errors == ()
    assert "neither is called better" in found.verdict
    assert [each.name for each in found.figures] == ["loss/validation"]
