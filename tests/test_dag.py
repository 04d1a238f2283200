"""The picture of the stages in the documentation."""

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from ruamel.yaml import YAML
from stage_dependencies import ROOT

EXPERIMENT = "mountaincar"


@pytest.fixture(scope="module")
def dag() -> ModuleType:
    spec = importlib.util.spec_from_file_location("dag", ROOT / "docs" / "dag.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def named(each: str | dict[str, Any]) -> str:
    """The path of a dependency or output of a stage of the experiment."""
    path = each if isinstance(each, str) else next(iter(each))
    return path.replace("${key}", EXPERIMENT).replace("${item.raw}", f"data/raw/{EXPERIMENT}")


def as_dvc_prints_it() -> str:
    document = YAML(typ="safe", pure=True).load((ROOT / "dvc.yaml").read_text(encoding="utf-8"))
    stages = {name: stage["do"] for name, stage in document["stages"].items() if name != "import"}
    made = {named(out): name for name, stage in stages.items() for out in stage["outs"]}
    nodes = [f'"{name}@{EXPERIMENT}";' for name in stages]
    edges = {
        f'"{made[out]}@{EXPERIMENT}" -> "{name}@{EXPERIMENT}";'
        for name, stage in stages.items()
        for dep in stage["deps"]
        for out in made
        if Path(named(dep)).is_relative_to(out)
    }
    return "\n".join([*nodes, *edges])


def test_the_picture_is_that_of_the_pipeline(dag: ModuleType) -> None:
    picture = (ROOT / "docs" / "images" / "dag.svg").read_text(encoding="utf-8")
    drawn = dag.draw(*dag.read_dot(as_dvc_prints_it()))
    assert sorted(drawn.splitlines()) == sorted(picture.splitlines())


def test_an_arrow_that_follows_from_others_is_left_out(dag: ModuleType) -> None:
    edges = [("a", "b"), ("b", "c"), ("c", "d"), ("a", "c"), ("a", "d"), ("b", "d")]
    assert dag.reduced(edges) == [("a", "b"), ("b", "c"), ("c", "d")]
    assert dag.levels("abcd", edges) == [["a"], ["b"], ["c"], ["d"]]
