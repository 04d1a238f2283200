import sys
from pathlib import Path

import pytest

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.cli import main as cli
from addressed_dynamics.cli.verdicts import verdict_lines


def write_report(folder: Path, verdict: str) -> None:
    folder.mkdir(parents=True)
    (folder / "report.html").write_text("<p>")
    (folder / "verdict.txt").write_text(verdict)


def test_each_experiment_has_a_line_with_its_verdict_and_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "params.yaml").write_text("experiments: {car: {kind: transitions}, walk: {kind: motion}}\n")
    write_report(tmp_path / "data" / "reports" / "car", "It is good.\nVery.\n")
    monkeypatch.setattr(sys, "argv", ["addressed-dynamics", "verdicts"])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert not caught.value.code
    assert capsys.readouterr().out == (
        "car: It is good. Very. data/reports/car/report.html\nwalk: no report yet; 'dvc repro report@walk' makes it\n"
    )


@pytest.mark.parametrize("text", [None, "experiments: {}\n", "experiments: [car]\n", "- a\n"])
def test_a_params_file_without_experiments_is_an_error(tmp_path: Path, text: str | None) -> None:
    file = tmp_path / "params.yaml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(ParamsError, match="params"):
        list(verdict_lines(file))


def test_one_experiment_alone_has_its_line_and_one_that_is_not_there_is_named(tmp_path: Path) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("experiments: {car: {kind: transitions}, walk: {kind: motion}}\n")
    assert list(verdict_lines(file, ["walk"])) == ["walk: no report yet; 'dvc repro report@walk' makes it"]
    with pytest.raises(ParamsError, match="there is no experiment 'cart' in it; there are car, walk"):
        list(verdict_lines(file, ["walk", "cart"]))
