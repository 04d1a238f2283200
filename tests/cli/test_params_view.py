"""`addressed-dynamics params`: every key of an experiment, with its meaning."""

from pathlib import Path

import pytest
from stage_dependencies import ROOT
from typer.testing import CliRunner

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.cli.main import app
from addressed_dynamics.cli.params_view import params_lines


@pytest.mark.parametrize("file", ["params.yaml", "params/paper.yaml"])
@pytest.mark.parametrize(
    ("experiment", "kind"),
    [("mountaincar", "transitions"), ("acrobot", "transitions"), ("pfnn", "motion"), ("pendulum", "transitions")],
)
def test_what_is_printed_is_a_params_file_of_the_same_experiment(
    tmp_path: Path, file: str, experiment: str, kind: str
) -> None:
    written = tmp_path / "params.yaml"
    written.write_text("\n".join(params_lines(ROOT / file, experiment, None)), encoding="utf-8")
    assert load_experiment(written, experiment, kind) == load_experiment(ROOT / file, experiment, kind)


def test_defaults_are_printed_with_their_meaning_also_where_a_kind_has_its_own() -> None:
    text = "\n".join(params_lines(ROOT / "params.yaml", "pfnn", None))
    assert "about as good as the best on\n    # validation samples, after a brief training.\n    members: 4\n" in text


def test_a_file_that_names_no_kind_is_asked_for_it(tmp_path: Path) -> None:
    file = tmp_path / "some.yaml"
    file.write_text("walk: {title: Walk}\n")
    with pytest.raises(ParamsError, match="does not say of which kind 'walk' is; say it with --kind"):
        list(params_lines(file, "walk", None))
    with pytest.raises(ParamsError, match=r"there is no experiment 'foo' in it \(experiments there: walk\)"):
        list(params_lines(file, "foo", None))
    done = CliRunner().invoke(app, ["params", "walk", "--params", str(file), "--kind", "motion"])
    assert done.exit_code == 0
    assert done.stdout.startswith('walk:\n  title: "Walk"\n')
