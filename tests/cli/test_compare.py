import io
import json
import sys
from pathlib import Path
from typing import Any

import pytest
from projects import begin_project, errors_by_episode, write_results

from addressed_dynamics.cli import main as cli
from addressed_dynamics.cli.compare_view import comparison_view
from addressed_dynamics.comparing.asking import compare_all


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    root = begin_project(tmp_path / "project", monkeypatch)
    write_results(root, epochs=5, arrays=errors_by_episode(0.49, 0.1))
    return root


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["addressed-dynamics", "compare", *arguments])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        out, err = capsys.readouterr()
        return int(caught.value.code or 0), out, err

    return run


@pytest.mark.usefixtures("project")
def test_the_workspace_is_what_a_revision_is_compared_with_if_nothing_else_is_named(run: Any) -> None:
    status, out, _ = run("HEAD")
    assert status == 0
    words = " ".join(out.split())
    assert "ensemble.epochs 3 5" in words
    assert "car: 1 param differs, the same data, the same code. One step: the recommended model of workspace" in words


@pytest.mark.usefixtures("project")
def test_the_same_for_programs(run: Any) -> None:
    (found,) = json.loads(run("HEAD", "workspace", "--json")[1])["comparisons"]
    assert found["params"] == [{"name": "ensemble.epochs", "a": 3, "b": 5}]
    assert found["errors"][0]["said"] == "lower"
    assert found["errors"][0]["ratio"]["low"] < found["errors"][0]["ratio"]["value"] < 1


@pytest.mark.usefixtures("project")
def test_a_page_is_written_beside_what_is_printed(run: Any, tmp_path: Path) -> None:
    status, out, _ = run("HEAD", "-o", str(tmp_path / "page.html"))
    assert status == 0
    assert out.endswith(f"all of it is in {tmp_path / 'page.html'}\n")
    assert "ensemble.epochs" in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("project")
@pytest.mark.parametrize("width", [40, 70, 120, 200])
def test_nothing_is_cut_in_a_terminal_of_any_width(width: int) -> None:
    from rich.console import Console

    (found,) = compare_all("HEAD", "workspace")
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(comparison_view(found, width), crop=False)
    lines = console.export_text().splitlines()
    assert max(map(len, lines)) <= max(width, 110)
    words = " ".join(" ".join(lines).split())
    for shown in ("ensemble.epochs", "the ensemble", "one step [% of the range]", "lower"):
        assert shown in words


@pytest.mark.usefixtures("project")
@pytest.mark.parametrize(
    "arguments",
    [
        ("nothing",),
        ("HEAD", "nothing"),
        ("HEAD", "--experiment", "plane"),
        ("HEAD", "-o", "data"),
        ("HEAD", "-o", "/proc/page.html"),
    ],
)
def test_what_is_not_there_is_one_line_and_a_status(run: Any, arguments: tuple[str, ...]) -> None:
    status, out, err = run(*arguments)
    assert (status, out) == (1, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert Path("data").is_dir()


def test_a_folder_without_git_is_one_line_and_a_status(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    status, _, err = run("HEAD")
    assert status == 1
    assert err.startswith("error: this folder: not a Git repository, so it has no revisions, and no run in MLflow is")
    assert err.count("\n") == 1
