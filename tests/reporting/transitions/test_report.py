import dataclasses
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from acrobot_recordings import acrobot_spaces
from builders import CAR
from report_examples import DATA, FILES, origin, transitions_report, write_results

from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, SpaceSpec
from addressed_dynamics.reporting.common.blocks import Block, Fold, Report, Table, Text
from addressed_dynamics.reporting.common.render import render_html, render_markdown, write_report
from addressed_dynamics.reporting.common.runs import run_blocks
from addressed_dynamics.reporting.transitions.document import headline
from addressed_dynamics.reporting.transitions.paper import PAPER
from addressed_dynamics.reporting.transitions.quality import quality_blocks
from addressed_dynamics.reporting.transitions.recorded import DataResult
from addressed_dynamics.reporting.transitions.results import load_results
from addressed_dynamics.reporting.transitions.tables import segment_table

CAR_PAPER = PAPER["mountaincar"]
PENDULUM = SpaceSpec(
    observation=tuple(Dimension(f"angle_{i}", "rad/s" if i else "", -np.inf, np.inf) for i in range(3)),
    action=ContinuousAction((Dimension("torque", "Nm", -1, 1), Dimension("wind", "", -1, 1))),
    step_seconds=0.02,
)


class Page(HTMLParser):
    """What a browser would see of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in {"meta", "img", "source"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"</{tag}> closes another element"


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    return example(tmp_path_factory.mktemp("results"))


def example(folder: Path, **changes: Any) -> Report:
    spaces = changes.get("spaces", CAR)
    return transitions_report(load_results(*write_results(folder, **changes)), origin(spaces), CAR_PAPER)


def tables(report: Report) -> list[Table]:
    return [block for block in report.blocks if isinstance(block, Table)]


def test_the_page_is_whole_and_loads_nothing_from_elsewhere(report: Report) -> None:
    text = render_html(report)
    page = Page(text)
    assert page.open == []
    assert not {"link", "iframe", "object"} & {tag for tag, _ in page.tags}
    assert not [attributes for tag, attributes in page.tags if tag == "script" and "src" in attributes]
    pictures: list[Any] = [attributes for tag, attributes in page.tags if tag == "img"]
    assert len(pictures) == len(report.panels) > 5
    starts = {"png": "data:image/png;base64,iVBOR", "gif": "data:image/gif;base64,R0lGOD"}
    for attributes, panel in zip(pictures, report.panels, strict=True):
        assert attributes["src"].startswith(starts[panel.format])
        assert attributes["alt"] == panel.alternative
    for loads in ("url(", "@import", "fetch(", "XMLHttpRequest", "https:"):
        assert loads not in text
    assert set(re.findall(r"http://[^\"']*", text)) == {"http://www.w3.org/2000/svg"}, "a name, which nothing loads"


def test_pictures_move_only_for_readers_who_do_not_mind(report: Report) -> None:
    sources: list[Any] = [attributes for tag, attributes in Page(render_html(report)).tags if tag == "source"]
    films = [panel for panel in report.panels if panel.format == "gif"]
    assert len(sources) == len(films) == 2
    assert all("prefers-reduced-motion: reduce" in each["media"] for each in sources)
    assert all(each["srcset"].startswith("data:image/png;base64,iVBOR") for each in sources)


def test_the_links_of_the_page_lead_to_its_sections_and_to_the_files_beside_it(report: Report) -> None:
    page = Page(render_html(report))
    anchors = {f"#{attributes['id']}" for _, attributes in page.tags if "id" in attributes}
    targets = {attributes["href"] for tag, attributes in page.tags if tag == "a"}
    beside = {target for target in targets if target and target.startswith("../../")}
    assert beside == {
        "../../raw/mountaincar", "../../tables/mountaincar", "../../models/mountaincar", "../../figures/mountaincar",
        "../../evaluation/mountaincar/evaluation.json",
    }  # fmt: skip
    assert targets - beside
    assert targets - beside <= anchors


def test_the_report_says_how_to_find_the_runs_and_names_none_of_them(report: Report) -> None:
    (fold,) = (block for block in report.sections[-1].blocks if isinstance(block, Fold) and "Runs" in block.title)
    assert fold.blocks == run_blocks("mountaincar", {"ensemble/seed-0": "0123456789abcdef"})
    markdown = render_markdown(report)
    assert "'addressed-dynamics ui' shows the runs of the experiment 'mountaincar'" in markdown
    assert "- ensemble/seed-0: tags.output LIKE '%0123456789abcdef%'" in markdown


def test_markdown_and_page_hold_the_same_cells(report: Report) -> None:
    page, markdown = render_html(report), render_markdown(report)
    cells = [cell for table in tables(report) for row in table.rows for cell in row.cells]
    assert len(cells) > 100
    for cell in cells:
        assert cell in markdown
        assert cell.replace("'", "&#39;").replace(">", "&gt;").replace("<", "&lt;") in page


def test_every_table_of_the_markdown_has_as_many_cells_in_all_its_rows(report: Report) -> None:
    lines = render_markdown(report).splitlines()
    blocks = re.findall(r"(?:^\|.*\|\n)+", "\n".join(lines) + "\n", flags=re.MULTILINE)
    assert len(blocks) == len(tables(report)) + len(report.charts)
    for block in blocks:
        assert len({row.count("|") for row in block.splitlines()}) == 1, block


def test_the_files_are_written_with_the_pictures_that_the_markdown_names(report: Report, tmp_path: Path) -> None:
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "of_an_older_report.png").touch()
    write_report(report, tmp_path)
    named = set(re.findall(r"\]\(figures/([^)]+)\)", (tmp_path / "report.md").read_text()))
    assert named == {path.name for path in (tmp_path / "figures").iterdir()}
    assert "Table 1" in (tmp_path / "report.html").read_text()


def test_the_same_results_make_the_same_bytes(report: Report, tmp_path: Path) -> None:
    again = example(tmp_path)
    assert render_html(again) == render_html(report)
    assert b"matplotlib" not in b"".join(panel.content for panel in again.panels).lower()


def test_the_paper_stands_beside_the_measured_table(report: Report) -> None:
    (section,) = (section for section in report.sections if section.title == "The paper's figures")
    assert (section.folded, section.opened) == (True, True)
    _, table = section.blocks
    assert isinstance(table, Table)
    assert [row.cells for row in table.rows] == [
        ("the paper, network 1", "0.2", "262.6", "27", "0.4", "3.5", "65.2"),
        ("the paper, network 2", "1.2", "1,861.3", "1", "7.8", "7.8", "7.8"),
        ("here, network 1", "0.10", "50.0", "3.00", "0.10", "1.0", "1,000"),
        ("here, network 2", "0.10", "50.0", "3.00", "0.10", "1.0", "1,000"),
    ]


def test_eight_members_of_which_one_is_never_selected_and_other_spaces_have_a_report(tmp_path: Path) -> None:
    report = example(tmp_path, spaces=PENDULUM, members=8, unused=True, wall_free=0, samples=7)
    markdown = render_markdown(report)
    assert "| here, network 8 | – | 50.0 | 0 | – | – | – |" in markdown
    assert "nan" not in markdown.lower()
    assert "map-selected-0" in {panel.name for panel in report.panels}


@pytest.mark.parametrize("width", [1, 6])
def test_imported_logs_have_a_report_without_walls_the_paper_s_claims_or_a_learner(tmp_path: Path, width: int) -> None:
    unbounded = tuple(Dimension(f"joint_{i}", "rad", -np.inf, np.inf) for i in range(width))
    spaces = SpaceSpec(unbounded, PENDULUM.action, 0.05)
    figures, arrays = write_results(tmp_path, spaces=spaces, wall_free=None)
    (tmp_path / FILES["learner.csv"]).write_text("index,segment,end_step,return,length,terminated\n")
    segments = {
        "pendulum": {"behaviour": "imported", "count": 6, "transitions": 1000, "terminated_share_last_100": 0.0}
    }
    coverage = {"cells_per_dimension": 50, "per_dimension": {"joint_0": 1.0}, "plane": None}
    (tmp_path / FILES["data.json"]).write_text(json.dumps(DATA | {"segments": segments, "coverage": coverage}))
    results = load_results(figures, arrays)
    report = transitions_report(results, origin(spaces), None)
    text = render_markdown(report)
    for absent in ("wall", "leave the bounds", "leaves the bounds", "Table 1", "goal", "nan"):
        assert absent not in text, absent
    for claim in ("the paper, ", "held against the paper", "claim"):
        assert claim not in text, claim
    assert "50 stretches of 30 steps from held-out episodes" in text
    assert "the params file asks for 50, but no held-out episode is longer" in text
    (rollouts,) = (chart for chart in report.charts if chart.name == "rollout")
    assert {view.choice[1] for view in rollouts.views} == {f"joint_{i}" for i in range(width)}
    assert ("map-selected-0" in {panel.name for panel in report.panels}) == (width > 1)
    assert headline(results, None)["rollout_mse/joint_0"] == 1e-6


@pytest.mark.slow
def test_rollouts_of_acrobot_have_their_angles_and_energy_in_the_report(tmp_path: Path) -> None:
    changes: dict[str, Any] = {"wall_free": None, "segments": {"learning": 3, "zero_torque": 2}}
    spaces = acrobot_spaces()
    report = transitions_report(load_results(*write_results(tmp_path, spaces=spaces, **changes)), origin(spaces), None)
    shown = [*(panel.name for panel in report.panels), *(chart.name for chart in report.charts)]
    assert len(shown) == len(set(shown))
    (physics,) = (chart for chart in report.charts if chart.name == "physics")
    assert {view.choice[0] for view in physics.views} == {"learning", "zero torque"}
    assert {view.choice[1] for view in physics.views} == {
        "first angle", "second angle", "energy", "energy since the start",
    }  # fmt: skip
    assert all(sum(line.shown for line in view.lines) <= 3 for view in physics.views)
    text = render_markdown(report)
    assert "Time until the angle error passes 0.5 rad" in text
    assert "wall contact" not in text
    assert "nan" not in text.lower()


FINDINGS = [
    {
        "kind": "gap",
        "dimension": "",
        "count": 3,
        "of": 1500,
        "first": {"log": "arm-1.mcap", "episode": 2, "step": 7, "value": 0.4},
        "blocking": False,
        "meaning": "gaps in time inside an episode",
    },
    {
        "kind": "non_finite",
        "dimension": "",
        "count": 1200,
        "of": None,
        "first": {"log": "arm-2.mcap", "episode": None, "step": None, "value": None},
        "blocking": False,
        "meaning": "values that are not finite",
    },
    {
        "kind": "stuck",
        "dimension": "observation.velocity",
        "count": 2000,
        "of": 2000,
        "first": None,
        "blocking": True,
        "meaning": "constant over the whole recording",
    },
]


def section(data: dict[str, Any]) -> tuple[Block, ...]:
    return quality_blocks(DataResult.model_validate(DATA | data))


def test_data_without_fault_is_said_to_be_so() -> None:
    (text,) = section({})
    assert isinstance(text, Text)
    assert text.paragraphs[0].startswith("Nothing was found wrong with the 2,000 transitions")


def test_each_finding_has_its_place_and_says_whether_training_goes_on() -> None:
    (table,) = section({"quality": FINDINGS})
    assert isinstance(table, Table)
    assert [row.cells for row in table.rows] == [
        ("gaps in time inside an episode", "–", "3", "0.2\u202f%", "arm-1.mcap", "2", "7", "0.400", "goes on"),
        ("values that are not finite", "–", "1,200", "–", "arm-2.mcap", "–", "–", "–", "goes on"),
        ("constant over the whole recording", "velocity", "2,000", "100.0\u202f%", "–", "–", "–", "–", "stops"),
    ]


@pytest.mark.parametrize(("files", "headers"), [(1, ["arm-0.mcap"]), (2, ["all files", "arm-0.mcap", "arm-1.mcap"])])
def test_an_import_has_its_counts_by_file(files: int, headers: list[str]) -> None:
    counts = {f"logs/arm-{index}.mcap": {"messages": 1000, "odd_ones": index} for index in range(files)}
    details = {name: {"encodings": {"/state": "cdr"}} for name in counts}
    *_, table = section({"import": {"files": counts, "totals": {"messages": 1000 * files}, "details": details}})
    assert isinstance(table, Table)
    assert [column.header for column in table.columns] == ["Count", "what it is", *headers]
    messages, odd = (row.cells for row in table.rows)
    assert messages[:3] == ("messages", "messages of the topics that are used", f"{1000 * files:,}")
    assert odd[:4] == (("odd ones", "–", "–", "0") if files > 1 else ("odd ones", "–", "–"))


def test_an_import_of_many_files_has_its_totals_alone() -> None:
    counts = {f"logs/arm-{index}.mcap": {"messages": 1000} for index in range(40)}
    *_, table = section({"import": {"files": counts, "totals": {"messages": 40_000}}})
    assert isinstance(table, Table)
    assert [row.cells[2:] for row in table.rows] == [("40,000",)]
    assert "40 files" in table.caption


def clock_words(**imported: Any) -> str:
    counts = {"messages": 1000} | imported.pop("counts", {})
    _, text, _ = section({"import": {"files": {"a": counts}, "totals": counts, "rate_hz": 20.0} | imported})
    assert isinstance(text, Text)
    return text.paragraphs[0]


def test_an_import_that_looked_at_the_times_says_what_they_are() -> None:
    topics = [
        {"/state": {"measured_hz": 99.8}, "/goal": {"measured_hz": None}, "/command": {"measured_hz": 40.02}},
        {"/state": {"measured_hz": 100.4}, "/goal": {"measured_hz": None}, "/command": {"measured_hz": 40.01}},
    ]
    details = {f"{number}.mcap": {"topics": each} for number, each in enumerate(topics)}
    text = clock_words(kind="mcap", counts={"ticks": 900}, details=details)
    assert text.startswith("The clock of the transitions was made by the import from rate_hz (20 Hz)")
    assert "The logs' own times were looked at" in text
    assert text.endswith("Messages a second: 99.8 to 100 on /state, 40 on /command.")
    text = clock_words(kind="csv", counts={"gaps": 0}, details={"a.csv": {"measured_hz": 19.99}})
    assert "The clock of the tables was looked at" in text
    assert text.endswith("Rows a second: 20.")


def test_what_an_import_took_off_the_values_is_said() -> None:
    counts = {"files": {"a": {"rows": 9}}, "totals": {"rows": 9}}
    _, text, _ = section({"import": counts | {"offsets": {"observation.north": 5301234.5}}})
    assert isinstance(text, Text)
    assert text.paragraphs[1].startswith("The import took 5301234.5 off observation.north; all values here")
    _, text, _ = section({"import": counts})
    assert isinstance(text, Text)
    assert len(text.paragraphs) == 1


@pytest.mark.parametrize(
    ("kind", "why"),
    [
        ("csv", "the table has no time column that the source names"),
        ("parquet", "the table has no time column that the source names"),
        ("minari", "the source has none"),
    ],
)
def test_an_import_that_did_not_look_at_the_times_says_that_nobody_did(kind: str, why: str) -> None:
    assert f"Nobody looked at the times: {why}." in clock_words(kind=kind)


def test_the_clock_of_an_import_is_never_praised() -> None:
    imported = {"files": {"a.csv": {"rows": 10}}, "totals": {"rows": 10}}
    whole, *_ = section({"import": imported})
    faulty, *_ = section({"import": imported, "quality": FINDINGS[1:]})
    assert isinstance(whole, Text)
    assert isinstance(faulty, Table)
    for text in (whole.paragraphs[0], faulty.caption):
        assert "uneven" not in text
        assert "clock" not in text
    (recorded,), (table,) = section({}), section({"quality": FINDINGS[1:]})
    assert isinstance(recorded, Text)
    assert isinstance(table, Table)
    assert "the clock ticks evenly" in recorded.paragraphs[0]
    assert "uneven time steps and gaps" in table.caption


@pytest.mark.parametrize(
    ("warnings", "first", "last"),
    [
        (1, "The import ended with a warning.", "a.mcap: slow 0."),
        (7, "The import ended with 7 warnings.", "2 more are in the import's account, import.json."),
    ],
)
def test_warnings_of_the_import_are_in_the_section_on_the_data(
    tmp_path: Path, warnings: int, first: str, last: str
) -> None:
    details = {"a.mcap": {"warnings": [f"slow {number}" for number in range(warnings)]}, "b.mcap": {"warnings": []}}
    record = {"files": {"a.mcap": {"messages": 9}, "b.mcap": {"messages": 9}}, "totals": {"messages": 18}}
    text = data_section(tmp_path, {"import": record | {"details": details}})
    paragraphs = text.split("\n\n")
    place = paragraphs.index(first)
    assert paragraphs[place + 1] == "a.mcap: slow 0."
    assert paragraphs[place + min(warnings, 6)] == last


def test_the_quality_of_the_data_is_a_section_of_the_report(report: Report) -> None:
    data = report.sections[0]
    assert data.title == "The data"
    assert any("Nothing was found wrong" in block.paragraphs[0] for block in data.blocks if isinstance(block, Text))
    assert "Nothing was found wrong" in render_html(report)
    assert "Nothing was found wrong" in render_markdown(report)


def test_a_title_with_markup_is_text_in_the_page(report: Report) -> None:
    page = render_html(dataclasses.replace(report, title="<b>&"))
    assert "<h1>&lt;b&gt;&amp;</h1>" in page


def test_one_member_without_addressing_and_a_paper_have_a_report_of_the_rest(tmp_path: Path) -> None:
    results = load_results(*write_results(tmp_path, members=1, wall_free=0, samples=2))
    report = transitions_report(results, origin(runs={}, commit=""), None)
    assert "the paper, network" not in render_markdown(report)
    assert "figures taken from the paper" not in report.verdict
    assert not {"Addressing", "The paper's figures"} & {section.title for section in report.sections}
    assert "Runs in MLflow" not in render_html(report)
    assert "targets/reached" not in headline(results, None)


def test_the_headline_counts_the_targets_reached(tmp_path: Path) -> None:
    results = load_results(*write_results(tmp_path))
    figures = headline(results, CAR_PAPER)
    assert figures["targets/reached"] == 4.0
    assert figures["rollout_mse/velocity"] == 1e-6
    assert figures["agreement"] == 0.97


def test_exogenous_inputs_are_listed_with_their_ranges_and_their_role(tmp_path: Path) -> None:
    spaces = dataclasses.replace(CAR, exogenous=(Dimension("wind", "m/s", -20.0, np.inf), Dimension("slope", "", 0, 1)))
    figures, arrays = write_results(tmp_path, wall_free=None)
    ranges = {
        "wind": {"min": -3.25, "max": 12.0, "low": -20.0, "high": None, "unit": "m/s"},
        "slope": {"min": 0.0, "max": 0.5, "low": 0.0, "high": 1.0, "unit": ""},
    }
    (tmp_path / FILES["data.json"]).write_text(json.dumps(DATA | {"exogenous": ranges}))
    document = json.loads((tmp_path / FILES["evaluation.json"]).read_text())
    document["rollouts"]["exogenous"] = ["wind", "slope"]
    (tmp_path / FILES["evaluation.json"]).write_text(json.dumps(document))
    report = transitions_report(load_results(figures, arrays), origin(spaces), None)
    (table,) = (each for each in tables(report) if each.columns[0].header == "Input")
    role = "exogenous: known, not predicted"
    assert [row.cells for row in table.rows] == [
        ("wind", "m/s", "-3.25", "12", "-20 to none", role),
        ("slope", "–", "0", "0.5", "0 to 1", role),
    ]
    text = render_markdown(report)
    assert "wind and slope: known, not predicted; every frame holds them beside the action" in text
    assert "of them repeat an earlier state, action and exogenous inputs." in text
    assert "under the actions and the exogenous inputs (wind and slope) recorded there" in text


def test_a_report_without_exogenous_inputs_does_not_speak_of_them(report: Report) -> None:
    assert "exogenous" not in render_markdown(report).lower()


BLOCKS = {
    "episodes": 1,
    "blocks": 20,
    "steps": {"mean": 99.9, "median": 100.0, "min": 99.0, "max": 100.0},
    "gap_steps": 20,
    "gaps": 9,
    "dropped": 180,
}


def data_section(folder: Path, changes: dict[str, Any]) -> str:
    figures, arrays = write_results(folder)
    (folder / FILES["data.json"]).write_text(json.dumps(DATA | changes))
    text = render_markdown(transitions_report(load_results(figures, arrays), origin(CAR), CAR_PAPER))
    return text.partition("## The data")[2].partition("## Rollouts")[0]


def test_a_recording_that_was_cut_in_blocks_says_how_long_they_are_and_what_was_dropped(tmp_path: Path) -> None:
    text = data_section(tmp_path, {"blocks": BLOCKS})
    assert "One long episode was cut in 20 blocks in time of 99 to 100 steps" in text
    assert "180 steps (9.0\u202f%) were dropped in gaps of 20 steps at the 9 borders" in text
    assert "Blocks and the episodes without any are kept whole" in text


def test_where_no_episode_was_long_enough_for_blocks_the_report_says_so(tmp_path: Path) -> None:
    none = BLOCKS | {"episodes": 0, "blocks": 0, "steps": None, "gaps": 0, "dropped": 0}
    text = data_section(tmp_path, {"blocks": none})
    assert "No episode was long enough to be cut in blocks in time." in text
    assert "What was recorded. Episodes are kept whole" in text


def test_test_transitions_without_all_frames_are_counted() -> None:
    data = DataResult.model_validate(DATA)
    recorded = data.splits["test"].transitions
    words = f"({recorded:,} transitions) for test, {recorded - 90:,} of them with the 6 frames that a model is given."
    assert words in segment_table(data, recorded - 90, 6).caption
    assert "frames" not in segment_table(data, recorded, 1).caption
