"""The report on motion as a whole: its parts, and that it stands alone."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from motion_report_examples import (
    FRAMES,
    OWN,
    arrays,
    candidate,
    data_json,
    evaluation,
    example,
    origin,
    split_addressing,
    write_results,
)

from addressed_dynamics.evaluation.motion.records import MotionEvaluation
from addressed_dynamics.reporting.common.blocks import Fold, Report, Table, Text
from addressed_dynamics.reporting.common.candidates import Effort
from addressed_dynamics.reporting.common.document import build_report
from addressed_dynamics.reporting.common.render import render_html, render_markdown
from addressed_dynamics.reporting.common.runs import run_blocks
from addressed_dynamics.reporting.motion.document import (
    addressing_blocks,
    motion_account,
    motion_headline,
    subtitle,
)
from addressed_dynamics.reporting.motion.figures.closed_loop import told
from addressed_dynamics.reporting.motion.figures.films import write_motion_scene
from addressed_dynamics.reporting.motion.loop_tables import loop_table
from addressed_dynamics.reporting.motion.recorded import MotionData, data_blocks
from addressed_dynamics.reporting.motion.results import MotionResults, load_motion_results
from addressed_dynamics.reporting.motion.tables import one_step_table
from addressed_dynamics.reporting.motion.targets import judge_targets


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> MotionResults:
    return load_motion_results(*write_results(tmp_path_factory.mktemp("motion")))


@pytest.fixture(scope="module")
def report(results: MotionResults) -> Report:
    found = origin()
    return build_report(motion_account(results, found, paper=True), results, found)


def tables(report: Report) -> list[Table]:
    return [block for block in report.blocks if isinstance(block, Table)]


def data(prefix: str, *, made_up: bool = False, **changes: Any) -> MotionData:
    return MotionData.model_validate(data_json(prefix, made_up=made_up) | changes)


def test_the_report_has_its_sections_in_order(report: Report) -> None:
    assert {section.title: section.folded for section in report.sections} == {
        "The data": False,
        "Closed loop": False,
        "One step ahead": False,
        "Candidates": False,
        "The paper's figures": True,
        "In words": True,
        "Addressing": True,
        "Training": True,
        "What was run": False,
    }


def test_every_picture_has_a_name_of_its_own_and_people_move(report: Report) -> None:
    names = [panel.name for panel in report.panels]
    assert len(names) == len(set(names))
    assert "loop-paths" in names
    charts = [chart.name for chart in report.charts]
    assert len(charts) == len(set(charts))
    assert charts[0] == "loop-over-time", "the closed loop comes first"
    assert {"frames", "phase", "loop-scores"} < set(charts)
    assert [panel.name for panel in report.panels if panel.format == "gif"] == ["animation-start"]


def test_the_page_loads_nothing_from_elsewhere_and_has_no_gaps(report: Report) -> None:
    page = render_html(report)
    assert not re.findall(r'(?:src|srcset|href)="(?!data:|#|\.\./\.\./)', page)
    assert "url(" not in page
    text = render_markdown(report)
    assert not re.search(r"\bnan\b|\bNone\b(?! of)", text)


def test_the_report_says_how_to_find_the_runs_and_names_none_of_them(report: Report) -> None:
    (fold,) = (block for block in report.sections[-1].blocks if isinstance(block, Fold) and "Runs" in block.title)
    assert fold.blocks == run_blocks("pfnn", {"ensemble/seed-0": "0123456789abcdef"})
    assert "- ensemble/seed-0: tags.output LIKE '%0123456789abcdef%'" in render_markdown(report)


def test_every_row_has_a_cell_for_each_column(report: Report) -> None:
    for table in tables(report):
        assert {len(row.cells) for row in table.rows} == {len(table.columns)}, table.caption


def test_what_the_paper_states_stands_only_beside_near_copies(report: Report) -> None:
    (table,) = (each for each in tables(report) if any("the paper: PFNN" in row.cells for row in each.rows))
    (row,) = (row for row in table.rows if row.cells[0] == "the paper: PFNN")
    (place,) = (index for index, cell in enumerate(row.cells) if cell == "2.21")
    assert table.columns[place].group == "MAE, held-out frames (near copies)"


def test_synthetic_clips_are_named_at_the_top_and_with_the_data(report: Report) -> None:
    assert "SYNTHETIC" in report.subtitle
    assert report.verdict.startswith("On synthetic clips")
    assert "All of these clips are synthetic" in render_markdown(report)


def test_clips_that_are_not_the_walkers_are_not_called_synthetic() -> None:
    assert data("Walker", made_up=True).made_up
    assert data("LocomotionFlat01", made_up=True).made_up, "by what made them, not by their names"
    assert not data("Walker").made_up
    words = " ".join(p for block in data_blocks(data("Flat")) if isinstance(block, Text) for p in block.paragraphs)
    assert "synthetic" not in (words + subtitle(made_up=False)).lower()


def test_a_clip_and_its_mirror_are_one_row_and_many_clips_are_summed_up() -> None:
    table = next(block for block in data_blocks(data("Walker")) if isinstance(block, Table))
    assert [row.cells[:2] for row in table.rows] == [
        ("Walker jog", "2"),
        ("Walker run", "2"),
        ("Walker stroll", "2"),
        ("all", "6"),
    ]
    (clip, *_) = data_json()["clips"].values()
    many = {f"Clip_{index:03d}": clip | {"group": f"Clip_{index:03d}"} for index in range(50)}
    table = next(block for block in data_blocks(data("Clip", clips=many)) if isinstance(block, Table))
    assert [row.cells[0] for row in table.rows[-2:]] == ["10 more", "all"]


def test_copies_in_the_source_are_told() -> None:
    source = {"rows": 18_000, "exact_duplicates": 16_000, "other_patches": 200, "boundaries": "phase"}
    table = next(block for block in data_blocks(data("Flat", source=source)) if isinstance(block, Table))
    assert "Of 18,000 rows 16,000 were exact copies and 200 the same motion on other terrain" in table.caption


def test_medians_over_seeds_have_their_spread() -> None:
    found = evaluation(more_seeds=[candidate(OWN, 1, raw=0.4), candidate(OWN, 2, raw=0.3)])
    row = next(row for row in one_step_table(found, {}, paper=True).rows if row.kind == "own")
    assert row.cells[5] == "0.300 (0.200 – 0.400)"
    row = next(row for row in loop_table(found).rows if row.kind == "own")
    assert row.cells[2] == "3 of 3"


def test_candidates_have_their_costs_in_the_table_and_what_is_unknown_is_a_dash() -> None:
    document = example()
    document["candidates"]["ensemble/argmax/seed-0"]["multiply_adds"] = 5678
    found = MotionEvaluation.model_validate(document)
    table = one_step_table(found, {"ensemble": Effort(2601, 41600), "phase_functioned": Effort(2601, None)}, paper=True)
    assert [column.header for column in table.columns[1:5]] == [
        "parameters", "updates", "samples seen", "multiply-adds a step"
    ]  # fmt: skip
    rows = {row.cells[0]: row.cells[1:5] for row in table.rows}
    assert rows[found.own.label] == ("1,234", "2,601", "41,600", "5,678")
    assert rows["PFNN, trained here"] == ("1,234", "2,601", "–", "–")
    assert rows["ridge regression"] == ("1,234", "–", "–", "–")


def test_the_headline_holds_ours_and_pfnn(results: MotionResults) -> None:
    figures = motion_headline(results)
    assert figures["mae/test"] == 0.2
    assert figures["pfnn/mae/test"] == 0.3
    assert figures["targets/reached"] == 5.0
    assert all(np.isfinite(list(figures.values())))


def test_the_scene_has_the_whole_closed_loop_of_both(results: MotionResults, tmp_path: Path) -> None:
    write_motion_scene(tmp_path / "scene.mcap", results.evaluation, results.arrays)
    with (tmp_path / "scene.mcap").open("rb") as file:
        topics = [channel.topic for _, channel, _ in make_reader(file).iter_messages()]
    assert topics.count("/scene") == FRAMES


def test_commands_are_told_apart_only_under_the_standard_script(results: MotionResults, tmp_path: Path) -> None:
    assert told(results.arrays.loops[f"{OWN}/seed-0"]) is None
    reports, target = write_results(tmp_path)
    np.savez(target / "arrays.npz", **arrays(frames=3600))
    script = told(load_motion_results(reports, target).arrays.loops[f"{OWN}/seed-0"])
    assert script is not None
    assert script.segments[0].kind == "stand"


def test_one_network_has_a_report_without_addressing() -> None:
    alone = {split: split_addressing(50, ("walk",), 0.0, members=1) for split in ("train", "test")}
    found = evaluation(addressing=alone)
    assert judge_targets(found)[-1].met is None
    assert addressing_blocks(found) == ()
