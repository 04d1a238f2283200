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
        ("experiments: 3\nimported: {}\n", "arm", "'experiments' in it is not a mapping"),
        ("- 1\n", "arm", "is a mapping of sections, but this one holds list"),
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


def test_line_ends_of_windows_links_and_permissions_stay(tmp_path: Path) -> None:
    path, link = tmp_path / "real.yaml", tmp_path / "params.yaml"
    before = b"experiments: {}\r\nimported: {}\r\n"
    path.write_bytes(before)
    path.chmod(0o640)
    link.symlink_to(path)
    add(link)
    assert link.is_symlink()
    assert path.stat().st_mode & 0o777 == 0o640
    assert path.read_bytes().count(b"\r\n") == path.read_bytes().count(b"\n") > 2
    remove_experiment(link, "arm", LISTS)
    assert path.read_bytes() == before


def test_a_section_in_which_somebody_put_a_comment_at_the_margin_is_removed_whole(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    before = "experiments: {}\nimported: {}\n"
    path.write_text(before)
    add(path)
    path.write_text(path.read_text().replace("  convert", "# mine\n\n  convert") + "\n# about a\na: {}\n")
    remove_experiment(path, "arm", LISTS)
    assert path.read_text() == before + "\n# about a\na: {}\n"


def test_what_is_no_experiment_is_not_removed_and_nobody_is_told_to(tmp_path: Path) -> None:
    path = tmp_path / "params.yaml"
    path.write_text("experiments: {}\nimported: {}\n")
    with pytest.raises(ParamsError, match=r"a 'experiments' in it already; give another name$"):
        add(path, "experiments")
    with pytest.raises(ParamsError, match="there is no experiment 'imported' in it"):
        remove_experiment(path, "imported", LISTS, of_anybody=True)


def test_a_file_that_must_not_be_written_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "params.yaml"
    path.write_text("experiments: {}\nimported: {}\n")
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(ParamsError, match=r"cannot be written \(Permission denied\); nothing was changed"):
        add(path)
    assert path.read_text() == "experiments: {}\nimported: {}\n"
