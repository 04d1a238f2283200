"""What is measured as one long table, and measures that are modules of their own."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.evaluation.common.measures import (
    Row,
    further_rows,
    read_rows_of_measures,
    rows_of,
    write_rows_of_measures,
)

WORDS = st.text("abc_", min_size=1, max_size=4)
RESULTS = st.recursive(
    st.floats(allow_nan=False, allow_infinity=False) | st.text("xyz", max_size=3) | st.none(),
    lambda inner: st.dictionaries(WORDS, inner, max_size=3) | st.lists(inner, max_size=3),
    max_leaves=12,
)


def numbers(found: Any) -> Iterator[float]:
    if isinstance(found, float):
        yield found
    for each in found.values() if isinstance(found, dict) else found if isinstance(found, list) else ():
        yield from numbers(each)


@given(st.dictionaries(WORDS, st.dictionaries(WORDS, RESULTS, max_size=3), max_size=3))
def test_every_number_is_a_row_of_its_own(candidates: dict[str, dict[str, Any]]) -> None:
    rows = list(rows_of(candidates))
    assert [row.value for row in rows] == list(numbers(candidates))
    assert len({(row.candidate, row.measure, row.quantity, row.statistic) for row in rows}) == len(rows)


def test_a_row_says_what_it_is() -> None:
    dimension = {"name": "speed", "unit": "m/s", "squared": {"mean": 0.25, "finite": True}}
    found = list(rows_of({"wide": {"parameters": 7, "one_step": {"scaled": {"mean": 0.5}, "dimensions": [dimension]}}}))
    assert found == [
        Row("parameters", "wide", "", "value", 7.0),
        Row("one_step", "wide", "scaled", "mean", 0.5),
        Row("one_step", "wide", "dimensions.speed.squared", "mean", 0.25, "m/s"),
    ]


def test_the_table_is_written_and_read_again_and_a_damaged_one_is_one_line(tmp_path: Path) -> None:
    rows = [Row("one_step", "wide", "speed", "mean", 0.1, "m/s"), Row("own", "wide", "", "share", 2.0, "%", "A share.")]
    write_rows_of_measures(tmp_path / "first.parquet", rows)
    write_rows_of_measures(tmp_path / "second.parquet", rows)
    assert read_rows_of_measures(tmp_path / "first.parquet") == rows
    assert (tmp_path / "first.parquet").read_bytes() == (tmp_path / "second.parquet").read_bytes()
    (tmp_path / "second.parquet").write_bytes(b"no table")
    for name, what in {"second.parquet": "not the table of measures", "third.parquet": "missing"}.items():
        with pytest.raises(EvaluationError, match=f"{name}: {what}") as caught:
            read_rows_of_measures(tmp_path / name)
        assert "\n" not in str(caught.value)


@dataclass(frozen=True)
class Model:
    name: str


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of a package `own_measures` without modules."""
    folder = tmp_path / "own_measures"
    folder.mkdir()
    (folder / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    for name in [name for name in sys.modules if name.startswith("own_measures")]:
        del sys.modules[name]


MODULE = """{docstring}
from addressed_dynamics.evaluation.common.measures import Row


def measure(candidate, held_out):
    yield Row("{name}", candidate.name, "", "value", float(held_out))
"""


def test_a_module_is_a_measure_of_every_candidate(package: Path) -> None:
    (package / "depth.py").write_text(MODULE.format(docstring='"""How\ndeep.\n\nMore.\n"""', name="depth"))
    assert further_rows("own_measures", [Model("a"), Model("b")], 3) == [
        Row("depth", name, "", "value", 3.0, "", "How deep.") for name in ("a", "b")
    ]


@pytest.mark.parametrize(
    ("docstring", "name", "what"),
    [("", "depth", "depth: a measure needs a docstring"), ('"""How deep."""', "width", "it measured 'width' of 'a'")],
)
def test_a_measure_that_does_not_say_what_it_is_is_refused(package: Path, docstring: str, name: str, what: str) -> None:
    (package / "depth.py").write_text(MODULE.format(docstring=docstring, name=name))
    with pytest.raises(EvaluationError, match=what):
        further_rows("own_measures", [Model("a")], 3)
