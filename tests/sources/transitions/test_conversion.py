"""From logs to tables: the same rows, the same bytes, splits by segment, and errors that name the log."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import CAR, RUN, append_rows, assert_same, car_transitions
from builders import write_log as write_transitions

from addressed_dynamics.base.errors import LogError, TableError
from addressed_dynamics.episodes import fingerprints
from addressed_dynamics.episodes.index import read_episodes
from addressed_dynamics.episodes.parquet import load_transitions, read_table
from addressed_dynamics.episodes.splits import SPLITS, episode_places
from addressed_dynamics.episodes.statistics import column_names, column_values
from addressed_dynamics.episodes.transitions import Dimension, SpaceSpec, Transitions
from addressed_dynamics.logs import TransitionLogWriter, read_log, write_log
from addressed_dynamics.sources.transitions import conversion
from addressed_dynamics.sources.transitions.conversion import convert_recording
from addressed_dynamics.sources.transitions.params import ConvertParams

PARAMS = ConvertParams(validation_share=0.2, test_share=0.2, split_seed=0, row_group_rows=64)


def write_part(
    folder: Path, name: str, lengths: Sequence[int], *, first: int, behaviour: str = "dqn", spec: SpaceSpec = CAR
) -> Transitions:
    """Write the log of a segment called like the file up to its first hyphen, with episodes numbered from `first`."""
    whole = car_transitions(lengths, seed=first)
    part = replace(whole, spec=spec, episode=whole.episode + first)
    run = replace(RUN, segment=name.split("-")[0], behaviour=behaviour)
    with TransitionLogWriter(folder / f"{name}.mcap", spec, run=run) as writer:
        for index, rows in enumerate(part.episode_slices()):
            append_rows(writer, part, rows)
            writer.end_episode(seed=first if index == 0 else None, cut=False)
    return part


def write_recording(folder: Path) -> Transitions:
    return Transitions.concatenate(
        [
            write_part(folder, "learner-env00-000", [3, 4, 2, 5], first=0),
            write_part(folder, "learner-env01-000", [6, 1], first=100),
            write_part(folder, "random-env00-000", [5, 5, 5], first=200, behaviour="random"),
        ]
    )


def convert(tmp_path: Path, name: str = "out", *, params: ConvertParams = PARAMS, cores: int = 1) -> Path:
    recording, tables, reports = tmp_path / "raw", tmp_path / name / "tables", tmp_path / name / "reports"
    convert_recording(recording, tables, reports, params, cores=cores, progress=lambda _: None)
    return tmp_path / name


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_tables_hold_the_transitions_of_the_logs_file_by_file(tmp_path: Path) -> None:
    whole = write_recording(tmp_path / "raw")
    tables = convert(tmp_path) / "tables"
    found = load_transitions(tables)
    np.testing.assert_array_equal(found.observation, whole.observation)
    np.testing.assert_array_equal(found.action, whole.action)
    np.testing.assert_array_equal(found.episode, whole.episode)
    for split in SPLITS:
        for path in (tables / "transitions" / split).iterdir():
            table = read_table(path)
            assert path.name.startswith(table.segment)
            assert set(table.split.tolist()) == {SPLITS.index(split)}
    assert sorted(path.name for path in (tables / "transitions").iterdir()) == sorted(SPLITS)


def test_a_split_is_read_from_its_own_files_alone_in_the_order_of_the_logs(tmp_path: Path) -> None:
    whole = write_recording(tmp_path / "raw")
    tables = convert(tmp_path) / "tables"
    train = {each.episode for each in read_episodes(tables / "episodes.parquet") if each.split == "train"}
    for split in ("validation", "test"):
        for path in (tables / "transitions" / split).iterdir():
            path.write_bytes(b"nobody who trains reads this")
    assert_same(load_transitions(tables, "train"), whole.select(np.isin(whole.episode, list(train))))
    with pytest.raises(TableError, match="expected a whole Parquet file"):
        load_transitions(tables)


def test_the_same_logs_give_the_same_bytes(tmp_path: Path) -> None:
    write_recording(tmp_path / "raw")
    assert contents(convert(tmp_path, "first")) == contents(convert(tmp_path, "second"))


@pytest.mark.slow
def test_several_processes_give_the_same_bytes_as_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_recording(tmp_path / "raw")
    one = contents(convert(tmp_path, "one"))
    monkeypatch.setattr(conversion, "WORKER_BYTES", 1)
    assert contents(convert(tmp_path, "two", cores=2)) == one


def test_a_log_that_is_read_in_blocks_gives_the_same_rows_and_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = write_recording(tmp_path / "raw")
    at_once = convert(tmp_path, "whole")
    monkeypatch.setattr(conversion, "BLOCK_ROWS", 10)
    in_blocks = convert(tmp_path, "blocks")
    np.testing.assert_array_equal(load_transitions(in_blocks / "tables").observation, whole.observation)
    assert (in_blocks / "reports" / "data.json").read_text() == (at_once / "reports" / "data.json").read_text()
    found, expected = (json.loads((each / "tables" / "statistics.json").read_text()) for each in (in_blocks, at_once))
    assert found["splits"] == expected["splits"]
    for name, column in expected["train"].items():
        assert found["train"][name] == pytest.approx(column, rel=1e-12)


def test_every_segment_has_episodes_in_every_split_and_tables_agree_with_the_list_of_episodes(tmp_path: Path) -> None:
    write_recording(tmp_path / "raw")
    tables = convert(tmp_path) / "tables"
    episodes = read_episodes(tables / "episodes.parquet")
    for segment in ("learner", "random"):
        assert {each.split for each in episodes if each.segment == segment} == {"train", "validation", "test"}
    for split in ("train", "validation", "test"):
        expected = {each.episode for each in episodes if each.split == split}
        assert set(load_transitions(tables, split).episode.tolist()) == expected
    assert [each.seed for each in episodes if each.episode in (0, 1, 100)] == [0, None, 100]


def import_files(folder: Path, origins: Sequence[str]) -> None:
    """Write what an import of these files leaves: logs and episodes are numbered in the order of all files."""
    for index, origin in enumerate(origins):
        write_part(folder, f"{index:04d}-{Path(origin).stem}", [3, 4], first=1000 * index)
    logs = {origin: {"log": f"{index:04d}-{Path(origin).stem}.mcap"} for index, origin in enumerate(origins)}
    record = {"files": {origin: {"read": 9} for origin in origins}, "totals": {"read": 9 * len(origins)}}
    (folder / "import.json").write_text(json.dumps({**record, "details": logs}))


def test_one_more_file_leaves_every_episode_of_the_others_in_its_split(tmp_path: Path) -> None:
    # The new file comes first, so that the logs and episodes of all others get other numbers.
    others = [f"logs/drive-{number:02d}.csv" for number in range(25)]
    found = []
    for name, origins in (("before", others), ("after", ["logs/a-new-drive.csv", *others])):
        import_files(tmp_path / name / "raw", origins)
        episodes = read_episodes(convert(tmp_path / name) / "tables" / "episodes.parquet")
        found.append({each.name: each.split for each in episodes})
    before, after = found
    assert set(before) == {f"drive-{number:02d}#{place}" for number in range(25) for place in (0, 1)}
    assert set(before.values()) == {"train", "validation", "test"}
    assert {name: after[name] for name in before} == before
    assert set(after) - set(before) == {"a-new-drive#0", "a-new-drive#1"}


def test_episodes_are_called_by_their_log_and_their_number_in_it(tmp_path: Path) -> None:
    write_recording(tmp_path / "raw")
    episodes = read_episodes(convert(tmp_path) / "tables" / "episodes.parquet")
    names = {each.episode: each.name for each in episodes}
    assert names[0] == "learner-env00-000#0"
    assert names[101] == "learner-env01-000#1"


def test_different_recordings_with_the_same_numbers_are_converted_with_names_and_splits_of_their_own(
    tmp_path: Path,
) -> None:
    parts = [write_part(tmp_path / "raw", name, [3, 4, 5, 6, 7], first=0) for name in ("a-0", "b-0", "c-0")]
    tables = convert(tmp_path) / "tables"
    episodes = read_episodes(tables / "episodes.parquet")
    assert [each.episode for each in episodes] == list(range(15))
    assert [each.name for each in episodes] == [f"{log}-0#{place}" for log in "abc" for place in range(5)]
    whole = load_transitions(tables)
    np.testing.assert_array_equal(whole.episode, np.repeat(np.arange(15), [3, 4, 5, 6, 7] * 3))
    np.testing.assert_array_equal(whole.observation, np.concatenate([part.observation for part in parts]))
    for split in SPLITS:
        numbers = [each.episode for each in episodes if each.split == split]
        assert set(load_transitions(tables, split).episode.tolist()) == set(numbers)
    # Without the first recording the numbers are others, and names and splits the same.
    (tmp_path / "raw" / "a-0.mcap").unlink()
    fewer = {
        each.name: each.split for each in read_episodes(convert(tmp_path, "fewer") / "tables" / "episodes.parquet")
    }
    assert fewer == {each.name: each.split for each in episodes[5:]}


def test_statistics_are_those_of_the_training_episodes_alone(tmp_path: Path) -> None:
    write_recording(tmp_path / "raw")
    tables = convert(tmp_path) / "tables"
    found = json.loads((tables / "statistics.json").read_text())
    train = load_transitions(tables, "train")
    assert found["splits"]["train"]["transitions"] == len(train)
    columns = column_values(train)
    assert list(found["train"]) == column_names(train)
    for name, column in zip(found["train"], columns.T, strict=True):
        expected = {"mean": column.mean(), "std": column.std(), "min": column.min(), "max": column.max()}
        assert found["train"][name] == pytest.approx(expected, rel=1e-9)


def test_the_data_report_counts_duplicates_across_logs_and_shows_the_learner(tmp_path: Path) -> None:
    whole = write_recording(tmp_path / "raw")
    # The same numbers once more, under other episodes.
    again = replace(whole.select(whole.episode < 100), episode=whole.episode[whole.episode < 100] + 300)
    run = replace(RUN, segment="again", behaviour="random")
    with TransitionLogWriter(tmp_path / "raw" / "again-env00-000.mcap", CAR, run=run) as writer:
        for rows in again.episode_slices():
            append_rows(writer, again, rows)
            writer.end_episode(seed=None, cut=False)
    reports = convert(tmp_path) / "reports"
    report = json.loads((reports / "data.json").read_text())
    assert report["duplicates"]["rows"] == len(again)
    assert report["segments"]["learner"]["behaviour"] == "dqn"
    assert report["segments"]["learner"]["count"] == 6
    assert len((reports / "learner.csv").read_text().splitlines()) == 1 + 6


@pytest.mark.parametrize("far", [1e7, float(np.finfo(np.float32).max)])
def test_bounds_far_beyond_the_data_do_not_squash_the_coverage(tmp_path: Path, far: float) -> None:
    states = np.random.default_rng(0).uniform(-1.0, 1.0, size=(125, 2)).astype(np.float32)
    coverage = []
    for name, bound in (("none", np.inf), ("far", far)):
        spec = replace(CAR, observation=tuple(replace(each, low=-bound, high=bound) for each in CAR.observation))
        columns = {"observation": states, "next_observation": np.roll(states, -1, axis=0)}
        world = replace(car_transitions([30, 20, 25, 30, 20]), spec=spec, **columns)
        (tmp_path / name / "raw").mkdir(parents=True)
        write_transitions(tmp_path / name / "raw" / "learner-env00-000.mcap", world)
        found = json.loads((convert(tmp_path / name) / "reports" / "data.json").read_text())["coverage"]
        coverage.append(found)
    assert coverage[0] == coverage[1]
    assert min(coverage[1]["per_dimension"].values()) > 0.5


def quality(folder: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((folder / "reports" / "data.json").read_text())["quality"]
    return found


def test_findings_name_the_log_and_the_episode(tmp_path: Path) -> None:
    write_recording(tmp_path / "raw")
    whole = read_log(tmp_path / "raw" / "random-env00-000.mcap").transitions
    first = whole.select(whole.episode == 200)
    write_transitions(tmp_path / "raw" / "twice-env00-000.mcap", replace(first, episode=first.episode + 100))
    found = {(each["kind"], each["dimension"]): each for each in quality(convert(tmp_path))}
    duplicate = found["duplicate", ""]
    assert (duplicate["count"], duplicate["of"], duplicate["blocking"]) == (5, 41, False)
    assert duplicate["first"] == {"log": "twice-env00-000.mcap", "episode": 300, "step": None, "value": None}
    # The numbers of these logs are random, of all sizes.
    bounds = found["out_of_bounds", "observation.position"]
    assert bounds["first"]["log"] == "learner-env00-000.mcap"
    assert not -1.2 <= bounds["first"]["value"] <= 0.6


def test_outliers_are_told_by_all_logs_together(tmp_path: Path) -> None:
    spec = replace(CAR, observation=tuple(replace(each, low=-np.inf, high=np.inf) for each in CAR.observation))
    for index, size in enumerate((1.0, 1.0, 1e6)):
        whole = car_transitions([8], seed=index)
        states = np.random.default_rng(index).normal(size=(9, 2)).astype(np.float32) * np.float32(size)
        part = replace(
            whole, spec=spec, episode=whole.episode + index, observation=states[:-1], next_observation=states[1:]
        )
        write_transitions(tmp_path / "raw" / f"part{index}-env00-000.mcap", part)
    params = PARAMS.model_copy(update={"validation_share": 0.0, "test_share": 0.0})
    found = [each for each in quality(convert(tmp_path, params=params)) if each["kind"] == "outlier"]
    assert [each["dimension"] for each in found] == ["observation.position", "observation.velocity"]
    assert all(each["first"]["log"] == "part2-env00-000.mcap" for each in found)


def test_data_from_which_nothing_can_be_learned_is_refused(tmp_path: Path) -> None:
    whole = car_transitions([30])
    still = np.full((30, 2), 0.01, dtype=np.float32)
    write_transitions(tmp_path / "raw" / "a.mcap", replace(whole, observation=still, next_observation=still))
    params = PARAMS.model_copy(update={"validation_share": 0.0, "test_share": 0.0})
    with pytest.raises(TableError, match=r"nothing can be learned .*observation\.position: constant over the whole"):
        convert(tmp_path, params=params)
    assert not (tmp_path / "out" / "tables").exists()


def test_what_the_import_counted_is_in_the_report(tmp_path: Path) -> None:
    write_recording(tmp_path / "raw")
    assert "import" not in json.loads((convert(tmp_path) / "reports" / "data.json").read_text())
    counts = {"read": 9, "not_finite": 2}
    record = {"files": {"x.mcap": counts}, "totals": counts, "rate_hz": 20.0}
    (tmp_path / "raw" / "import.json").write_text(json.dumps(record))
    report = json.loads((convert(tmp_path) / "reports" / "data.json").read_text())
    assert report["import"] == record
    assert report["quality"][-1]["kind"] == "non_finite"
    assert report["quality"][-1]["count"] == 2


def test_warnings_of_the_import_are_counted_in_the_report(tmp_path: Path) -> None:
    write_recording(tmp_path / "raw")
    details = {"x.mcap": {"warnings": ["slow", "late"]}, "y.mcap": {"warnings": []}, "z.mcap": {"warnings": ["far"]}}
    record = {"files": {"x.mcap": {"read": 9}}, "totals": {"read": 9}, "details": details}
    (tmp_path / "raw" / "import.json").write_text(json.dumps(record))
    report = json.loads((convert(tmp_path) / "reports" / "data.json").read_text())
    assert report["import"] == record | {"warnings": 3}


@pytest.mark.parametrize("text", ["", "[]", '{"files": {"x": 3}, "totals": {}}'])
def test_a_malformed_record_of_an_import_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    write_recording(tmp_path / "raw")
    (tmp_path / "raw" / "import.json").write_text(text)
    with pytest.raises(TableError, match=r"import\.json: expected the counts of an import") as caught:
        convert(tmp_path)
    assert "\n" not in str(caught.value)


def flip_byte(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(content)


@pytest.mark.parametrize("damage", [flip_byte, lambda path: path.write_bytes(path.read_bytes()[:-40])])
def test_a_damaged_log_is_named_and_no_table_is_left(tmp_path: Path, damage: Any) -> None:
    write_recording(tmp_path / "raw")
    damage(tmp_path / "raw" / "learner-env01-000.mcap")
    with pytest.raises(LogError, match=r"learner-env01-000\.mcap"):
        convert(tmp_path)
    assert not (tmp_path / "out" / "tables").exists()
    assert not list((tmp_path / "out").glob(".*"))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a file that is always full")
@pytest.mark.parametrize("full", ["buckets/0000", "1"])
def test_a_disk_that_is_full_while_equal_rows_are_looked_for_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, full: str
) -> None:
    """It is full for a worker's file, or for the files in which they are looked for."""
    write_recording(tmp_path / "raw")
    append = fingerprints._append
    monkeypatch.setattr(
        fingerprints,
        "_append",
        lambda path, values: append(
            Path("/dev/full") if f"/{full}" in path.as_posix().replace("/.", "/") else path, values
        ),
    )
    with pytest.raises(TableError, match="No space left on device"):
        convert(tmp_path)
    assert not list((tmp_path / "out").iterdir())


def test_no_logs_other_spaces_and_an_episode_in_two_logs_are_refused(tmp_path: Path) -> None:
    raw = tmp_path / "raw"
    with pytest.raises(LogError, match=r"raw: expected MCAP logs .* run the record stage first"):
        convert(tmp_path)
    write_part(raw, "a-env00-000", [3, 3, 3], first=0)
    write_part(raw, "a-env00-001", [3, 3, 3], first=2)
    with pytest.raises(LogError, match=r"a-env00-001\.mcap: episode 2 is also in a-env00-000\.mcap"):
        convert(tmp_path)
    shutil.copy(raw / "a-env00-000.mcap", raw / "a-env00-001.mcap")
    with pytest.raises(LogError, match=r"a-env00-001\.mcap: it is a copy of a-env00-000\.mcap"):
        convert(tmp_path)
    (raw / "a-env00-001.mcap").unlink()
    write_part(raw, "b-env00-000", [3], first=3, spec=replace(CAR, step_seconds=1.0))
    with pytest.raises(LogError, match=r"b-env00-000\.mcap: its spaces differ from those of a-env00-000\.mcap"):
        convert(tmp_path)


def test_nothing_to_train_on_is_an_error(tmp_path: Path) -> None:
    write_part(tmp_path / "raw", "a-env00-000", [3], first=0)
    seed = next(seed for seed in range(50) if episode_places(["a-env00-000#0"], seed)[0] < PARAMS.test_share)
    with pytest.raises(
        TableError, match="raw: its only episode leaves nothing for training and validation; record more"
    ):
        convert(tmp_path, params=PARAMS.model_copy(update={"split_seed": seed}))


def test_exogenous_inputs_are_converted_and_reported_with_their_ranges(tmp_path: Path) -> None:
    # Every episode twice: what repeats another's states and actions under another wind is no repetition.
    once = car_transitions([12] * 3)
    twice = Transitions.concatenate([once, replace(once, episode=once.episode + 3, time_ns=once.time_ns + 10**12)])
    wind = np.linspace(-3, 4, len(twice), dtype=np.float32)[:, None]
    wind[-1] = wind[len(once) - 1]
    spec = replace(CAR, exogenous=(Dimension("wind", "m/s", -20.0, np.inf),))
    write_log(tmp_path / "raw" / "a.mcap", replace(twice, spec=spec, exogenous=wind), run=RUN)
    out = convert(tmp_path)
    np.testing.assert_array_equal(load_transitions(out / "tables").exogenous, wind)
    report = json.loads((out / "reports" / "data.json").read_text(encoding="utf-8"))
    bounds = {"low": -20.0, "high": None, "unit": "m/s"}
    assert report["exogenous"] == {"wind": {"min": -3.0, "max": float(wind.max()), **bounds}}
    assert report["duplicates"]["rows"] == 1
