"""Tables with a column that says when a row was recorded."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from foreign_tables import account, imported, lengths, refusal
from hypothesis import given, settings
from hypothesis import strategies as st

from addressed_dynamics.importing.finding import find_logs
from addressed_dynamics.importing.looking_at import look_at
from addressed_dynamics.sources.transitions.conversion import convert_recording
from addressed_dynamics.sources.transitions.params import ConvertParams

TIME = {"column": "t"}


@pytest.fixture(autouse=True)
def _in_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def timed(*times: float, name: str = "a.csv", **columns: Any) -> None:
    """Write a row at each time."""
    count = len(times)
    frame = polars.DataFrame({"t": times, "q": np.arange(count) / 4, "u": np.arange(count) % 5, **columns})
    frame.write_csv(name) if name.endswith("csv") else frame.write_parquet(name)


def with_pause() -> list[float]:
    return [0.05 * i + (5.0 if i >= 10 else 0.0) for i in range(20)]


def test_a_pause_begins_another_episode_and_is_counted_and_without_the_key_it_is_bridged_as_before() -> None:
    timed(*with_pause())
    assert lengths(imported()) == [19]
    assert "gaps" not in account()["totals"]
    assert lengths(imported(clock=TIME)) == [9, 9]
    assert account()["totals"] | {"gaps": 1, "repeated": 0, "off_rate": 0} == account()["totals"]
    assert account()["details"]["a.csv"]["measured_hz"] == 20.0


@pytest.mark.parametrize(("unit", "scale"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_times_have_units(unit: str, scale: float) -> None:
    timed(*(round(1.7e9 * scale + each * scale) for each in with_pause()))
    assert lengths(imported(clock=TIME | {"unit": unit})) == [9, 9]


@pytest.mark.parametrize("name", ["a.csv", "a.parquet"])
def test_times_may_be_dates(name: str) -> None:
    dates = polars.Series([round(each * 1e9) for each in with_pause()]).cast(polars.Datetime("ns"))
    timed(*with_pause(), name=name, date=dates)
    assert lengths(imported(kind=name[2:], files=[name], clock={"column": "date"})) == [9, 9]


def test_missing_frames_begin_other_episodes() -> None:
    kept = [(episode, frame) for episode in range(4) for frame in range(10) if frame not in (4, 5)]
    polars.DataFrame(
        {
            "episode_index": [episode for episode, _ in kept],
            "frame_index": [frame for _, frame in kept],
            "q": [float(frame) for _, frame in kept],
            "u": [0.0] * len(kept),
        }
    ).write_parquet("a.parquet")
    changes = {"kind": "parquet", "files": ["a.parquet"], "episode": {"by": "column", "column": "episode_index"}}
    transitions = imported(clock={"frame": "frame_index"}, **changes)
    assert lengths(transitions) == [3] * 8
    assert account()["totals"]["gaps"] == 4
    np.testing.assert_array_equal(transitions.next_observation - transitions.observation, 1.0)


def test_the_tolerance_says_how_uneven_steps_may_be() -> None:
    timed(0.0, 0.05, 0.085, 0.15, 0.2)
    assert lengths(imported(clock=TIME)) == [4]
    assert lengths(imported(clock=TIME | {"tolerance": 0.2})) == [1, 1]
    assert account()["totals"]["gaps"] == 2


def test_time_that_falls_inside_an_episode_is_refused_with_its_line_and_a_label_or_an_end_allows_it() -> None:
    timed(0.0, 0.05, 0.1, 0.0, 0.05, e=[1, 1, 1, 2, 2], done=[0, 0, 1, 0, 0])
    message = refusal(clock=TIME)
    assert "a.csv: line 5: column 't' falls from 0.1 to 0 inside an episode, after line 4" in message
    assert lengths(imported(clock=TIME, episode={"by": "column", "column": "e"})) == [2, 1]
    assert lengths(imported(clock=TIME, terminated="done", episode={"by": "end"})) == [2, 1]


def test_rows_that_stand_twice_are_dropped_and_counted_and_other_values_at_one_time_refused() -> None:
    polars.DataFrame({"t": [0.0, 0.05, 0.05, 0.1], "q": [0, 1, 1, 2], "u": [0, 1, 1, 2]}).write_csv("a.csv")
    assert imported(clock=TIME).observation[:, 0].tolist() == [0.0, 1.0]
    assert account()["totals"]["repeated"] == 1
    polars.DataFrame({"t": [0.0, 0.05, 0.05, 0.1], "q": [0, 1, 7, 2], "u": [0, 1, 1, 2]}).write_csv("a.csv")
    assert "a.csv: line 4: column 't' stays at 0.05 inside an episode, after line 3" in refusal(clock=TIME)


def test_a_row_without_a_time_is_dropped_and_cuts_but_is_no_gap() -> None:
    Path("a.csv").write_text("t,q,u\n0,0,0\n0.05,1,1\n,2,2\n0.15,3,3\n0.2,4,4\n")
    assert lengths(imported(clock=TIME)) == [1, 1]
    assert (account()["totals"]["not_finite"], account()["totals"]["gaps"]) == (1, 0)


def test_a_rate_that_is_not_the_measured_one_is_counted_and_said() -> None:
    timed(*(i / 18 for i in range(20)))
    imported(clock=TIME)
    assert account()["totals"]["off_rate"] == 1
    assert account()["details"]["a.csv"]["measured_hz"] == pytest.approx(18.0)
    timed(*(i / 5 for i in range(20)))
    assert "the rows come at 5 Hz, but rate_hz is 20" in refusal(clock=TIME)


def test_files_are_in_the_order_of_their_times_else_of_the_numbers_in_their_names() -> None:
    for name, start in (("run_2.csv", 10.0), ("run_10.csv", 20.0), ("run_1.csv", 30.0)):
        timed(start, start + 0.05, start + 0.1, name=name)
    imported()
    assert list(account()["files"]) == ["run_1.csv", "run_2.csv", "run_10.csv"]
    imported(clock=TIME)
    assert list(account()["files"]) == ["run_2.csv", "run_10.csv", "run_1.csv"]


@settings(max_examples=25)
@given(kept=st.lists(st.booleans(), min_size=30, max_size=30).filter(any))
def test_no_step_spans_a_row_that_is_lost(tmp_path_factory: pytest.TempPathFactory, kept: list[bool]) -> None:
    places = np.flatnonzero(kept)
    folder = tmp_path_factory.mktemp("lossy")
    frame = polars.DataFrame({"t": places * 0.05, "q": places * 1.0, "u": places * 1.0})
    for name, part in (("a", frame), ("whole", polars.DataFrame({"t": [0.0, 0.05], "q": [0.0, 1.0], "u": [0.0, 1.0]}))):
        part.write_csv(folder / f"{name}.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        transitions = imported(clock=TIME)
        np.testing.assert_array_equal(transitions.next_observation - transitions.observation, 1.0)
        assert account()["files"]["a.csv"]["gaps"] == (np.diff(places) > 1).sum()
        assert len(transitions) == 1 + (np.diff(places) == 1).sum()


def test_the_data_report_says_the_measured_rate() -> None:
    timed(*(i / 18 for i in range(60)), name="run.csv", e=np.arange(60) // 12)
    imported(clock=TIME, episode={"by": "column", "column": "e"})
    params = ConvertParams(validation_share=0.2, test_share=0.2, split_seed=1)
    convert_recording(Path("out"), Path("tables"), Path("reports"), params, cores=1, progress=lambda _: None)
    report = json.loads(Path("reports/data.json").read_text())
    (finding,) = [each for each in report["quality"] if each["kind"] == "off_rate"]
    assert finding["first"]["value"] == pytest.approx(18.0)
    assert "another rate" in finding["meaning"]


@pytest.mark.parametrize("rate_hz", [60.0, 300.0, 144.0])
def test_times_that_were_rounded_have_the_rate_that_they_were_recorded_at(rate_hz: float) -> None:
    timed(*(round(i / rate_hz, 3) for i in range(2_000)))
    imported(clock=TIME, rate_hz=rate_hz)
    details = account()["details"]["a.csv"]
    assert details["measured_hz"] == pytest.approx(rate_hz, rel=2e-3)
    assert "warnings" not in details
    assert look_at(find_logs([Path("a.csv")])).fields[0].rate_hz == pytest.approx(rate_hz, rel=2e-3)
