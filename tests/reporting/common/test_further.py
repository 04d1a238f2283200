"""Measures without a section of their own are shown by the report all the same."""

from pathlib import Path

import pytest

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.evaluation.common.measures import MEASURES, Row, write_rows_of_measures
from addressed_dynamics.reporting.common.blocks import Column, Table
from addressed_dynamics.reporting.common.further import further_measures


def test_each_is_a_table_under_what_its_author_says(tmp_path: Path) -> None:
    rows = [
        Row("one_step", "wide", "speed", "mean", 0.1),
        Row("depth_of_it", "wide", "left", "mean", 0.25, "m", "How deep."),
        Row("depth_of_it", "own", "left", "mean", 1234.0, "m", "How deep."),
        Row("depth_of_it", "own", "right", "mean", 2.0, "m", "How deep."),
        Row("width", "own", "", "share", 3.0, "", "How wide."),
        Row("width", "wide", "", "share", -4.71e-9, "", "How wide."),
        Row("explained", "own", "left", "share", -4.71e-9, "%", "How much."),
    ]
    write_rows_of_measures(tmp_path / MEASURES, rows)
    depth, width, explained = further_measures(tmp_path, {"own": "the ensemble"})
    assert isinstance(depth, Table)
    assert depth.caption == "Depth of it: How deep."
    assert depth.columns == (Column("Model", numeric=False), Column("left", "mean, m"), Column("right", "mean, m"))
    assert [row.cells for row in depth.rows] == [("wide", "0.250", "–"), ("the ensemble", "1,234", "2.00")]
    assert isinstance(width, Table)
    assert width.columns[1:] == (Column("share"),)
    assert [row.cells for row in width.rows] == [("the ensemble", "3.00"), ("wide", "-4.71\u202f×\u202f10⁻⁹")]
    assert isinstance(explained, Table)
    assert [row.cells for row in explained.rows] == [("the ensemble", "0")]


def test_what_has_a_section_of_its_own_is_not_shown_again(tmp_path: Path) -> None:
    write_rows_of_measures(tmp_path / MEASURES, [Row("one_step", "wide", "speed", "mean", 0.1)])
    assert further_measures(tmp_path) == ()


def test_a_missing_table_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match=r"measures\.parquet: missing"):
        further_measures(tmp_path)
