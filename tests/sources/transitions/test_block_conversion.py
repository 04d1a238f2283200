"""`split: blocks`: one long recording, from a table with a row per step to tables with three splits."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from builders import car_transitions, write_log
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.base.params.source import SourceParams
from addressed_dynamics.episodes.index import Episode, read_episodes
from addressed_dynamics.episodes.parquet import load_transitions
from addressed_dynamics.importing import import_logs
from addressed_dynamics.logs import read_log
from addressed_dynamics.sources.transitions import conversion
from addressed_dynamics.sources.transitions.conversion import convert_recording
from addressed_dynamics.sources.transitions.params import ConvertParams
from addressed_dynamics.sources.transitions.pieces import plan_pieces

BLOCKS = ConvertParams(split="blocks")
SPLITS = ("train", "validation", "test")


@pytest.fixture
def in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def drive(name: str, rows: int, seed: int = 0) -> None:
    """Write a table of a slow walk, as a logger without episodes would."""
    generator = np.random.default_rng(seed)
    push = generator.uniform(-1, 1, rows)
    place = np.cumsum(push)
    Path(f"{name}.csv").write_text(polars.DataFrame({"place": place, "push": push, "score": place / 8}).write_csv())


def import_drives(folder: str = "raw") -> None:
    section = {
        "kind": "csv",
        "files": ("*.csv",),
        "observation": {"place": {"field": "place", "unit": "m"}},
        "action": {"continuous": {"push": {"field": "push"}}},
        "reward": "score",
        "rate_hz": 10.0,
        "episode": {"by": "file"},
        "min_length": 2,
    }
    import_logs(TypeAdapter(SourceParams).validate_python(section), Path(folder), name="drive", progress=lambda _: None)


def convert(params: ConvertParams = BLOCKS, raw: str = "raw", out: str = "out") -> dict[str, Any]:
    """Convert, and return the report on the data."""
    convert_recording(Path(raw), Path(out), Path(f"{out}-reports"), params, cores=1, progress=lambda _: None)
    report: dict[str, Any] = json.loads(Path(f"{out}-reports", "data.json").read_text())
    return report


def splits_of(out: str = "out") -> dict[str, str | None]:
    return {each.name: each.split for each in read_episodes(Path(out, "episodes.parquet"))}


@pytest.mark.usefixtures("in_a_folder")
def test_a_long_table_becomes_blocks_of_every_split() -> None:
    drive("monday", 3_000)
    import_drives()
    report = convert()
    whole = read_log(Path("raw/0000-monday.mcap")).transitions
    parts = {split: load_transitions(Path("out"), split) for split in SPLITS}
    steps = {split: part.step.tolist() for split, part in parts.items()}
    for split, part in parts.items():
        rows = np.searchsorted(whole.step, part.step)
        np.testing.assert_array_equal(part.observation, whole.observation[rows], err_msg=split)
        np.testing.assert_array_equal(part.time_ns, whole.time_ns[rows], err_msg=split)
    for held_out in ("validation", "test"):
        apart = np.abs(np.subtract.outer(steps[held_out], steps["train"]))
        assert apart.min() == BLOCKS.gap_steps + 1
    kept = sorted(step for each in steps.values() for step in each)
    assert len(set(kept)) == len(kept)
    assert len(kept) + report["blocks"]["dropped"] == 2_999 == report["transitions"]
    assert len(steps["test"]) == pytest.approx(0.15 * 2_999, abs=2)
    assert {split: each["episodes"] for split, each in report["splits"].items()} == dict(
        zip(SPLITS, (15, 2, 3), strict=True)
    )
    assert {split: each["transitions"] for split, each in report["splits"].items()} == {
        split: len(part) for split, part in parts.items()
    }


@pytest.mark.usefixtures("in_a_folder")
def test_the_list_of_episodes_and_the_report_say_what_each_block_is() -> None:
    drive("monday", 3_000)
    import_drives()
    report = convert()
    table = load_transitions(Path("out"))
    episodes = read_episodes(Path("out/episodes.parquet"))
    assert [each.name for each in episodes] == [f"monday#0.{number}" for number in range(20)]
    assert [each.ended for each in episodes] == ["cut"] * 19 + ["truncated"]
    for each in episodes:
        rows = table.episode == each.episode
        assert each.length == rows.sum()
        assert each.total_reward == pytest.approx(table.reward[rows].sum(dtype=np.float64))
        assert each.end_time_ns == table.time_ns[rows][-1] + 10**8 - 1
    figures = report["blocks"]
    assert (figures["episodes"], figures["blocks"], figures["gap_steps"]) == (1, 20, 20)
    assert (figures["steps"]["min"], figures["steps"]["max"]) == (149, 150)
    assert figures["dropped"] == 20 * figures["gaps"] > 0
    # What was recorded is still one episode.
    assert report["episodes"]["count"] == 1
    assert report["episodes"]["length"]["max"] == 2_999
    statistics = json.loads(Path("out/statistics.json").read_text())
    assert statistics["splits"] == report["splits"]


@pytest.mark.usefixtures("in_a_folder")
def test_one_more_file_moves_no_block_of_the_others() -> None:
    for number in range(3):
        drive(f"drive-{number}", 700 + 90 * number, seed=number)
    import_drives()
    convert()
    before = splits_of()
    drive("a-new-drive", 1_100, seed=9)  # comes first, so that the numbers of all others change
    import_drives("more")
    convert(raw="more", out="after")
    after = splits_of("after")
    assert {after[name] for name in set(after) - set(before)} == set(SPLITS)
    assert {name: after[name] for name in before} == before
    for number in range(3):
        assert {split for name, split in before.items() if name.startswith(f"drive-{number}#")} == set(SPLITS)


def test_a_log_that_is_read_in_parts_gives_the_same_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_log(Path("raw/a-000.mcap"), car_transitions([300, 7, 12, 400, 5, 3]))
    at_once = convert()
    monkeypatch.setattr(conversion, "BLOCK_ROWS", 10)
    in_parts = convert(out="parts")
    assert at_once == in_parts
    # Episodes that are too short to be cut are split whole, beside the blocks of the others.
    whole = {"a-000#1", "a-000#2", "a-000#4", "a-000#5"}
    assert {name for name in splits_of() if "." not in name} == whole
    assert read_episodes(Path("parts/episodes.parquet")) == read_episodes(Path("out/episodes.parquet"))
    one, other = (load_transitions(Path(out)) for out in ("out", "parts"))
    np.testing.assert_array_equal(one.observation, other.observation)
    np.testing.assert_array_equal(one.episode, other.episode)


@pytest.mark.usefixtures("in_a_folder")
@pytest.mark.parametrize(
    ("rows", "params", "what"),
    [
        (
            100,
            ConvertParams(),
            "its only episode leaves nothing for validation and test; record more episodes, or set ",
        ),
        (
            100,
            BLOCKS,
            "to be cut, an episode needs 240 steps with gap_steps 20, but the longest has 99; lower gap_steps",
        ),
    ],
)
def test_a_recording_that_would_leave_a_split_empty_is_refused_in_one_line(
    rows: int, params: ConvertParams, what: str
) -> None:
    drive("monday", rows)
    import_drives()
    with pytest.raises(TableError) as caught:
        convert(params)
    assert str(caught.value).startswith("raw: its only episode leaves nothing for ")
    assert what in str(caught.value)
    assert ("'split: blocks' under 'convert'" in str(caught.value)) == (params.split == "episodes")
    assert "\n" not in str(caught.value)
    assert not Path("out").exists()


@pytest.mark.usefixtures("in_a_folder")
def test_splits_without_a_share_may_be_empty() -> None:
    drive("monday", 100)
    import_drives()
    report = convert(ConvertParams(validation_share=0.0, test_share=0.0))
    assert report["splits"]["train"] == {"episodes": 1, "transitions": 99}
    assert "blocks" not in report


def recorded(lengths: Sequence[int]) -> list[Episode]:
    return [
        Episode(
            episode=10**6 + number,
            name=f"a#{number}",
            segment=f"part-{number % 2}",
            split=None,
            seed=None,
            length=length,
            total_reward=0.0,
            ended="cut",
            end_time_ns=0,
        )
        for number, length in enumerate(lengths)
    ]


@given(st.lists(st.integers(1, 2_000), min_size=6, max_size=12), st.integers(0, 40))
def test_pieces_have_numbers_of_their_own_and_the_names_of_their_episodes(lengths: list[int], gap: int) -> None:
    planned = plan_pieces(Path("raw"), recorded(lengths), ConvertParams(split="blocks", gap_steps=gap))
    assert sorted(each.whole.name for each in planned) == sorted(f"a#{number}" for number in range(len(lengths)))
    pieces = [piece for each in planned for piece in each.pieces]
    numbers = [piece.episode.episode for piece in pieces]
    assert len(set(numbers)) == len(numbers)
    if any(each.cut for each in planned):
        assert sorted(numbers) == list(range(len(numbers)))
    for each in planned:
        for piece in each.pieces:
            assert piece.episode.name.partition(".")[0] == each.whole.name
            assert piece.episode.length == piece.stop - piece.first > 0


def test_without_blocks_numbers_and_splits_are_those_of_the_logs() -> None:
    planned = plan_pieces(Path("raw"), recorded([5_000] * 8), ConvertParams())
    assert [piece.episode for each in planned for piece in each.pieces] == [each.whole for each in planned]
    assert not any(each.cut for each in planned)
