"""Experiments are added to a params file and taken out again, and all other lines stay as they are."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML
from stage_dependencies import ROOT

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.params.editing import MARK, add_experiment, remove_experiment

LISTS = ("experiments", "imported")
ENTRIES = {"experiments": "{kind: transitions, raw: data/raw/arm}", "imported": "logs"}
SECTION = "  title: Arm # of somebody\n  convert: {}\n"


def add(path: Path, name: str = "arm") -> None:
    add_experiment(path, name, ENTRIES, SECTION)


def test_an_experiment_is_added_at_the_end_and_named_at_the_top(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    before = (ROOT / "params.yaml").read_text()
    path.write_text(before)
    add(path)
    text, document = path.read_text(), YAML(typ="safe").load(path.read_text())
    assert document["arm"] == {"title": "Arm", "convert": {}}
    assert document["imported"] == {"arm": "logs"}
    assert document["experiments"]["arm"] == {"kind": "transitions", "raw": "data/raw/arm"}
    assert text.endswith(f"\n\narm: {MARK}\n{SECTION}")
    gone = set(before.splitlines()) - set(text.splitlines())
    assert len(gone) == 1
    assert gone.pop().startswith("imported: {} #")


@settings(max_examples=60)
@given(
    experiments=st.sampled_from(
        ["experiments: {}", "experiments: # c\n  a: {kind: motion, raw: x}", "experiments: {a: 1} # c"]
    ),
    imported=st.sampled_from(["imported: {}  # none", "imported:\n  b: y", "imported: {b: y}"]),
    rest=st.sampled_from(["", "\na: # c\n  x: 1\n\n  y: 2\n", "\n# about a\na: {}\n\n# about b\nb:\n  z:\n  - 1\n"]),
    names=st.permutations(["arm", "b2", "x-1"]),
)
def test_what_was_added_can_be_removed_again_in_any_order(
    tmp_path_factory: pytest.TempPathFactory, experiments: str, imported: str, rest: str, names: list[str]
) -> None:
    path = tmp_path_factory.mktemp("edit") / "params.yaml"
    before = f"# top\n{experiments}\n{imported}\n{rest}"
    path.write_text(before)
    for name in sorted(names):
        add(path, name)
    for name in names:
        remove_experiment(path, name, LISTS)
    squeezed = [line.replace("  #", " #") for line in path.read_text().rstrip("\n").split("\n")]
    assert squeezed == [line.replace("  #", " #") for line in before.rstrip("\n").split("\n")]


def test_what_somebody_wrote_is_removed_on_request_alone(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    path.write_text((ROOT / "params.yaml").read_text())
    with pytest.raises(ParamsError, match="was not made by 'addressed-dynamics new'"):
        remove_experiment(path, "acrobot", LISTS)
    remove_experiment(path, "acrobot", (*LISTS, "recorded"), of_anybody=True)
    before, after = (YAML(typ="safe").load(each.read_text()) for each in (ROOT / "params.yaml", path))
    for mapping in (*LISTS, "recorded"):
        before[mapping].pop("acrobot", None)
    del before["acrobot"]
    assert after == before


@pytest.mark.parametrize(
    ("text", "name", "what"),
    [
        ("experiments: {}\nimported: {}\n", "2 x", "cannot be the name"),
        ("experiments: {}\nimported: {}\narm: {}\n", "arm", "there is a 'arm' in it already"),
        ("experiments: {}\nimported: {arm: x}\n", "arm", "there is a 'arm' in it already"),
        ("experiments: {}\n", "arm", "'imported' in it is not a mapping with a line for each entry"),
        ("experiments: &x\n  a: 1\nimported: {}\n", "arm", "'experiments' in it is not a mapping"),
        ("- 1\n", "arm", "is a mapping of sections, but this one is none"),
        ("a: [\n", "arm", "not a YAML file"),
    ],
)
def test_what_cannot_be_added_leaves_the_file_as_it_was(tmp_path: Path, text: str, name: str, what: str) -> None:
    path = tmp_path / "params.yaml"
    path.write_text(text)
    with pytest.raises(ParamsError, match=what):
        add(path, name)
    assert path.read_text() == text
    assert list(tmp_path.iterdir()) == [path]


def test_an_experiment_that_is_not_there_cannot_be_removed(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    path.write_text("experiments: {}\n")
    with pytest.raises(ParamsError, match="there is no experiment 'arm' in it"):
        remove_experiment(path, "arm", LISTS)
