"""README.md and docs/results.md: every figure in them is from a file that a command makes."""

import json
import re
import shutil
import subprocess
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stage_dependencies import ROOT
from trusted_models import write_mountaincar

from addressed_dynamics.base.errors import ReportError
from publishing import documents, figures

COMMAND = "run 'make results', or 'python -m publishing' where only a template has changed"
KIB = 1024
FIGURE = re.compile(r"\d\.\d|\d ?%|\d ?× ?10|\de-?\d")
"""In a template: a decimal, a percentage or a power of ten."""
MEASURED = re.compile(r"\d\.\d+ ?(%|×|[mc]?m\b|m?s\b|rad|Hz|times)|\d ?× ?10|\de-\d")
"""In a page, which explains and may say for instance what an interval of 90 % is: a decimal with a unit."""


@pytest.mark.parametrize("path", documents.DOCUMENTS.values(), ids=str)
def test_a_document_is_what_its_template_and_the_figures_make(path: Path) -> None:
    assert (ROOT / path).read_text(encoding="utf-8") == documents.rendered()[path], COMMAND


MADE = ("source-keys.md", "results.md", "paper-map.md")
"""Pages that are made of something else, or say what the paper says."""
HAND_WRITTEN = {
    **{path.name: (path, FIGURE) for path in sorted((ROOT / documents.TEMPLATES).glob("*.j2"))},
    **{path.name: (path, MEASURED) for path in sorted((ROOT / "docs").glob("*.md")) if path.name not in MADE},
}


@pytest.mark.parametrize("name", HAND_WRITTEN)
def test_no_figure_is_typed_by_hand(name: str) -> None:
    path, figure = HAND_WRITTEN[name]
    text = path.read_text(encoding="utf-8")
    for other in (r"\{%.*?%\}", r"\{\{.*?\}\}", r"```.*?```", r"`[^`\n]*`", r"\]\([^)]*\)", r"<!--.*?-->"):
        text = re.sub(other, " ", text, flags=re.DOTALL)
    assert [line for line in text.splitlines() if figure.search(line.replace("Python 3.11", "Python"))] == []


def test_the_readme_is_short_and_has_python_on_its_first_screen() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 120
    assert len(text.split()) <= 900
    assert text.partition("```python")[0].count("\n") < 35


def test_files_of_figures_are_small_and_say_when_they_were_measured() -> None:
    files = sorted((ROOT / documents.FIGURES).rglob("*.json"))
    assert len(files) > 5
    for path in files:
        assert path.stat().st_size < 30 * KIB, path
        measured = json.loads(path.read_text(encoding="utf-8"))[figures.MEASURED]
        assert re.fullmatch(r"[0-9a-f]{7,}", measured["commit"]), path
        assert re.fullmatch(r"\d{4}-\d\d-\d\d", measured["date"]), path
    assert (ROOT / "docs" / "images" / "film.gif").stat().st_size < KIB**2


@pytest.mark.parametrize("name", ["mountaincar", "acrobot", "pfnn"])
def test_the_figures_are_those_of_the_summary_in_git(name: str) -> None:
    path = f"data/reports/{name}/summary.json"
    git = partial(subprocess.run, cwd=ROOT, capture_output=True, text=True)
    if git(["git", "rev-parse", "--verify", "HEAD"], check=False).returncode:
        pytest.skip("this is no clone, so nobody knows what was committed")
    # As committed: 'make run' changes the file.
    shown = git(["git", "show", f"HEAD:{path}"], check=True)
    kept = json.loads((ROOT / documents.FIGURES / "quick" / f"{name}.json").read_text(encoding="utf-8"))
    assert kept[figures.SUMMARY] == json.loads(shown.stdout), COMMAND


def programs() -> list[str]:
    """The Python in the README."""
    return re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL)


def test_the_python_in_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_mountaincar(tmp_path)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for program in programs():
        quick = program.replace("steps < 200", "steps < 2").replace("samples=100", "samples=10")
        exec(quick.replace(', candidate="recommended"', ""), names)
    assert names["steps"] == 2
    assert np.all(names["low"] <= names["high"])


def test_figures_keep_their_date_as_long_as_they_are_the_same(tmp_path: Path) -> None:
    path = tmp_path / "quick" / "car.json"
    figures.keep(path, {"error": 0.123456, "number": 123456}, {"commit": "aaaaaaa", "date": "2026-01-01"})
    first = path.read_text(encoding="utf-8")
    assert json.loads(first)["error"] == 0.1235
    assert json.loads(first)["number"] == 123456
    figures.keep(path, {"error": 0.123456, "number": 123456}, {"commit": "bbbbbbb", "date": "2026-02-02"})
    assert path.read_text(encoding="utf-8") == first
    figures.keep(path, {"error": 0.2, "number": 123456}, {"commit": "bbbbbbb", "date": "2026-02-02"})
    assert json.loads(path.read_text(encoding="utf-8"))[figures.MEASURED]["commit"] == "bbbbbbb"


def test_a_folder_without_a_run_is_an_error_that_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "params.yaml").write_text("params_file: params.yaml\n", encoding="utf-8")
    with pytest.raises(ReportError, match="nothing has been evaluated there; run 'make run' first"):
        figures.collect(tmp_path, tmp_path / "figures")
    (tmp_path / "params.yaml").write_text("params_file: params/mine.yaml\n", encoding="utf-8")
    with pytest.raises(ReportError, match=r"params_file should be one of params.yaml, .*, but is params/mine.yaml"):
        figures.collect(tmp_path, tmp_path / "figures")


@pytest.mark.parametrize(
    ("value", "other", "words"), [(1.0, 2.2, "2.2 × less"), (3.0, 1.0, "3.0 × more"), (1.0, 1.01, "as much")]
)
def test_a_figure_beside_the_paper_says_how_many_times_less_or_more_it_is(
    value: float, other: float, words: str
) -> None:
    assert documents.beside(value, other) == words


@pytest.mark.parametrize("path", ["README.md", *sorted(p.relative_to(ROOT).as_posix() for p in ROOT.glob("docs/*.md"))])
def test_links_lead_to_files(path: str) -> None:
    text = (ROOT / path).read_text(encoding="utf-8")
    targets = [each.partition("#")[0] for each in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in each]
    assert [each for each in targets if each and not (ROOT / path).parent.joinpath(each).exists()] == []


def test_a_figure_that_no_file_has_is_one_line_that_says_what_is_missing(tmp_path: Path) -> None:
    shutil.copytree(ROOT / documents.TEMPLATES, tmp_path / documents.TEMPLATES)
    shutil.copytree(ROOT / documents.FIGURES, tmp_path / documents.FIGURES)
    (tmp_path / documents.FIGURES / "clips.json").unlink()
    with pytest.raises(ReportError, match=r"results.md.j2: a figure is missing, .* \('clips' is undefined\)") as found:
        documents.rendered(tmp_path)
    assert "\n" not in str(found.value)
