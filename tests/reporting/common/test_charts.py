"""Charts are drawn from the numbers that they were made from, in any browser, and can be read without one."""

import asyncio
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import answers
from chromium import browser, needs_browser
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.reporting.common.blocks import (
    Chart,
    Column,
    Front,
    Line,
    Report,
    Row,
    Section,
    Table,
    Text,
    View,
)
from addressed_dynamics.reporting.common.charts import (
    MOST_PLACES,
    chart_json,
    numbers,
    places_of,
    rounded,
    value_table,
)
from addressed_dynamics.reporting.common.figures.style import MEMBERS, MODELS, OTHER_MODELS, OWN
from addressed_dynamics.reporting.common.render import render_html, render_markdown

PLACES = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
ERRORS = tuple(10.0**-power for power in range(6))


def view(choice: str, factor: float = 1.0) -> View:
    lines = (
        Line("ours", "#0072b2", tuple(factor * each for each in ERRORS), (1e-6,) * 6, (2.0,) * 6),
        Line("</script>", "#4d4d4d", (None, *ERRORS[1:]), style="dashed"),
        Line("third", "#e6a000", ERRORS, shown=False),
    )
    return View((choice,), f"error of {choice}", PLACES, lines)


CHART = Chart("horizon", "Errors.", "Errors over time", "s", (view("x"), view("y", 7.0)), ("Dimension",))
RANGES = Chart(
    "ranges", "All.", "All models", "", (View((), "error", (), (Line("a", OWN, (2.0,), (1.0,), (3.0,)),)),),
    form="ranges",
)  # fmt: skip


def page(*charts: Chart) -> str:
    sections = (Section("Open", charts), Section("Folded", (CHART_IN_FOLD,), folded=True))
    return render_html(Report("Title", "sub", "It works.", None, sections))


CHART_IN_FOLD = Chart("folded", "Errors.", "Errors", "s", (view("z"),), ("Dimension",))


def documents(text: str) -> list[Any]:
    found = re.findall(r'<script type="application/json">(.*?)</script>', text, flags=re.DOTALL)
    return [json.loads(each) for each in found]


def test_the_page_has_the_numbers_that_a_chart_was_made_from() -> None:
    first, *_ = documents(page(CHART))
    assert first["places"] == [list(PLACES)]
    assert [each["choice"] for each in first["views"]] == [["x"], ["y"]]
    lines = first["views"][1]["lines"]
    assert [line["name"] for line in lines] == ["ours", "</script>", "third"]
    assert lines[0]["values"] == pytest.approx([7 * each for each in ERRORS], rel=5e-4)
    assert (lines[0]["low"], lines[0]["high"]) == ([1e-6] * 6, [2.0] * 6)
    assert lines[1]["values"][0] is None
    assert [line["shown"] for line in lines] == [True, True, False]


def test_no_name_ends_the_script_that_holds_a_chart() -> None:
    assert "</script" not in chart_json(CHART)


@given(st.floats(min_value=-1e300, max_value=1e300, allow_subnormal=False) | st.sampled_from([math.nan, math.inf]))
def test_a_number_keeps_four_digits_and_what_is_none_is_a_gap(value: float) -> None:
    kept = rounded(value)
    if math.isfinite(value):
        assert kept == pytest.approx(value, rel=5e-4)
    else:
        assert kept is None


@given(st.integers(1, 3000))
def test_a_chart_keeps_the_first_and_the_last_place_and_not_too_many(length: int) -> None:
    kept = places_of(np.arange(length))
    assert (kept[0], kept[-1]) == (0, length - 1)
    assert kept == sorted(set(kept))
    assert len(kept) <= MOST_PLACES
    assert kept[:4] == list(range(min(length, 4)))


def test_the_values_of_a_chart_stand_in_a_table_for_who_cannot_see_it() -> None:
    table = value_table(CHART)
    assert [column.header for column in table.columns] == ["s", "1", "2", "3", "5", "6"]
    assert table.rows[0].cells == ("ours", "1.0", "0.10", "1.0\u202f×\u202f10⁻²", "1.0\u202f×\u202f10⁻⁴",
                                   "1.0\u202f×\u202f10⁻⁵")  # fmt: skip
    assert [row.cells[0] for row in table.rows] == ["ours", "</script>"]
    assert table.rows[1].cells[1] == "–"
    assert value_table(RANGES).rows[0].cells == ("a", "1.0", "2.0", "3.0")
    markdown = render_markdown(Report("Title", "sub", "It works.", None, (Section("Open", (CHART,)),)))
    assert "| ours | 1.0 | 0.10 |" in markdown


def test_a_line_that_ends_early_has_values_in_the_table_and_one_without_any_no_row() -> None:
    places = tuple(0.5 * step for step in range(1, 101))
    lines = (
        Line("whole", OWN, places),
        Line("brief", OWN, (*places[:9], *[None] * 91)),
        Line("none", OWN, (None,) * 100),
    )
    table = value_table(Chart("c", "", "", "s", (View((), "error", places, lines),)))
    assert [column.header for column in table.columns[1:]] == ["0.500", "2.50", "4.50", "13.0", "25.5", "37.5", "50.0"]
    assert [row.cells[0] for row in table.rows] == ["whole", "brief"]
    assert table.rows[1].cells[1:] == ("0.50", "2.5", "4.5", "–", "–", "–", "–")
    small = View((), "loss", (2e-18, 1e-3), (Line("a", OWN, (1.0, 2.0)),))
    heads = [column.header for column in value_table(Chart("c", "", "", "s", (small,))).columns]
    assert heads == ["s", "2.0\u202f×\u202f10⁻¹⁸", "0.00100"]


def test_no_colour_means_both_a_model_and_a_network_of_the_ensemble() -> None:
    models = {colour for _, colour in MODELS.values()} | set(OTHER_MODELS)
    assert not models & set(MEMBERS)
    titles = {title for title, _ in MODELS.values() if "recipe" not in title}
    assert len({colour for title, colour in MODELS.values() if title in titles}) == len(titles)
    assert numbers([float("nan"), 1.0]) == (None, 1.0)


@needs_browser
def test_a_browser_draws_the_charts_and_reads_them_off(tmp_path: Path) -> None:
    script = """
        const [first, ranges, folded] = document.querySelectorAll('figure.drawn');
        const paths = () => [...first.querySelectorAll('svg path.line')].map((path) => path.getAttribute('d'));
        const before = paths();
        const select = first.querySelector('select');
        select.value = 'y';
        select.dispatchEvent(new Event('change'));
        const after = paths();
        const third = [...first.querySelectorAll('button')].find((each) => each.textContent === 'third');
        const asked = third.getAttribute('aria-pressed');
        third.click();
        const svg = first.querySelector('svg');
        for (const key of ['ArrowRight', 'ArrowRight']) {
            svg.dispatchEvent(new KeyboardEvent('keydown', { key, bubbles: true, cancelable: true }));
        }
        return {
            before: before.length, changed: before[0] !== after[0], asked, shown: paths().length,
            bands: first.querySelectorAll('path.band').length,
            label: svg.getAttribute('aria-label'), read: first.querySelector('.readout').textContent,
            ranges: ranges.querySelectorAll('circle').length,
            folded: folded.querySelectorAll('path.line').length,
            overflow: document.documentElement.scrollWidth > innerWidth,
        };
    """
    found = answers(page(CHART, RANGES), script, tmp_path)
    assert found == {
        "before": 2,
        "changed": True,
        "asked": "false",
        "shown": 3,
        "bands": 1,
        "label": "Errors over time",
        "read": "s: 2 — ours 0.7 (1.00 × 10⁻⁶ to 2); </script> 0.1; third 0.1",
        "ranges": 1,
        "folded": 2,
        "overflow": False,
    }


@needs_browser
def test_a_link_opens_what_it_leads_to_and_all_is_open_on_paper(tmp_path: Path) -> None:
    script = """
        const details = document.querySelector('#folded > details');
        const before = details.open;
        dispatchEvent(new Event('beforeprint'));
        const printed = details.open;
        dispatchEvent(new Event('afterprint'));
        const after = details.open;
        location.hash = '#folded';
        dispatchEvent(new HashChangeEvent('hashchange'));
        return [before, printed, after, details.open];
    """
    assert answers(page(CHART), script, tmp_path) == [False, True, False, True]


MANY = Table(
    "A table with many columns.",
    (Column("Model", numeric=False), *(Column(f"a rather long heading {number}", "a group") for number in range(16))),
    (Row(("ensemble, argmax addressing", *["1.2 × 10⁻³"] * 16)),),
)
MOMENTS = Table(
    "Errors.",
    (Column("Error", numeric=False), *(Column(each, f"after {at} steps, {at} s") for at in (1, 10) for each in "abc")),
    (Row(("all", *["0.00123 (12)"] * 6), "own"),),
)


@needs_browser
def test_wide_tables_fit_a_printed_page_and_the_first_screen_a_telephone(tmp_path: Path) -> None:
    front = Front(answers={}, load="", sentences=(), errors=MOMENTS, film=None, chart=None)
    folded = Section("More", (Text(("What is folded.",)),), folded=True)
    report = Report("Tables", "", "", front, (Section("All", (MANY,)), folded))
    (tmp_path / "page.html").write_text(render_html(report), encoding="utf-8")
    right = (
        "Math.max(...[...document.querySelectorAll('{0} table, {0} td > span')]"
        ".map(each => each.getBoundingClientRect().right))"
    )

    async def look() -> tuple[float, int, float, str]:
        async with browser() as chromium, chromium.page() as page:
            await page.open((tmp_path / "page.html").as_uri(), width=400)
            await page.until("document.readyState == 'complete'")
            narrow = await page.value(right.format("#front"))
            seen = await page.value("document.querySelectorAll('#front td.first').length")
            await page.open((tmp_path / "page.html").as_uri(), width=741)
            await page.until("document.readyState == 'complete'")
            await page.call("Emulation.setEmulatedMedia", media="print")
            after = await page.value("getComputedStyle(document.querySelector('summary')).breakAfter")
            return narrow, seen, await page.value(right.format("#all")), after

    narrow, moments, printed, after = asyncio.run(look())
    assert after == "avoid", "no page ends with the heading of a fold"
    assert narrow <= 400
    assert moments == 2
    assert printed <= 741
