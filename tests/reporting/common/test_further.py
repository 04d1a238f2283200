"""Measures without a section of their own are shown by the report all the same."""

from pathlib import Path

import pytest

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.evaluation.common.measures import MEASURES, Row, write_rows_of_measures
from addressed_dynamics.reporting.common.blocks import Column, Report, Section, Table
from addressed_dynamics.reporting.common.further import with_further_measures

SECTIONS = tuple(Section(title, ()) for title in ("Rollouts", "Training", "Source"))
REPORT = Report("Title", "subtitle", "verdict", (), Table("Targets", (), ()), SECTIONS)


def test_they_stand_before_the_training_each_in_a_table_with_what_its_author_says(tmp_path: Path) -> None:
    rows = [
        Row("one_step", "wide", "speed", "mean", 0.1),
        Row("depth_of_it", "wide", "left", "mean", 0.25, "m", "How deep."),
        Row("depth_of_it", "own", "left", "mean", 1234.0, "m", "How deep."),
        Row("depth_of_it", "own", "right", "mean", 2.0, "m", "How deep."),
        Row("width", "own", "", "share", 3.0, "", "How wide."),
    ]
    write_rows_of_measures(tmp_path / MEASURES, rows)
    report = with_further_measures(REPORT, tmp_path)
    assert [section.title for section in report.sections] == ["Rollouts", "Further measures", "Training", "Source"]
    depth, width = report.sections[1].blocks
    assert isinstance(depth, Table)
    assert depth.caption == "depth of it: How deep."
    assert depth.columns == (Column("Model", numeric=False), Column("left", "mean, m"), Column("right", "mean, m"))
    assert [row.cells for row in depth.rows] == [("wide", "0.250", "–"), ("own", "1,234", "2.00")]
    assert isinstance(width, Table)
    assert width.columns[1:] == (Column("share"),)


def test_without_any_there_is_no_section(tmp_path: Path) -> None:
    write_rows_of_measures(tmp_path / MEASURES, [Row("one_step", "wide", "speed", "mean", 0.1)])
    assert with_further_measures(REPORT, tmp_path) is REPORT


def test_at_the_end_of_a_report_without_trainings(tmp_path: Path) -> None:
    write_rows_of_measures(tmp_path / MEASURES, [Row("width", "own", "", "share", 3.0, "", "How wide.")])
    short = Report("Title", "subtitle", "verdict", (), Table("Targets", (), ()), SECTIONS[:1])
    assert [section.title for section in with_further_measures(short, tmp_path).sections] == [
        "Rollouts", "Further measures"
    ]  # fmt: skip


def test_a_missing_table_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match=r"measures\.parquet: missing"):
        with_further_measures(REPORT, tmp_path)
