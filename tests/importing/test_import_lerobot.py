"""LeRobot datasets."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from foreign_logs import source
from foreign_tables import account, imported, lengths, refusal
from lerobot_data import frames, write_v2, write_v3

from addressed_dynamics.importing.assessing import assess

LEROBOT: dict[str, Any] = {
    "kind": "lerobot",
    "files": ...,
    "folder": "set",
    "observation": {"pan": {"field": "observation.state[shoulder_pan.pos]"}, "grip": {"field": "observation.state[1]"}},
    "action": {"continuous": {"u": {"field": "action[gripper.pos]"}}},
    "rate_hz": ...,
    "episode": ...,
}


@pytest.fixture(autouse=True)
def _in_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("write", [write_v2, write_v3])
def test_names_rate_and_episodes_are_those_of_the_dataset(write: Callable[..., None]) -> None:
    write(Path("set"), frames())
    transitions = imported(**LEROBOT)
    assert lengths(transitions) == [9] * 4
    assert transitions.observation.tolist() == [[frame, episode] for episode in range(4) for frame in range(9)]
    assert transitions.action[:, 0].tolist() == [-frame for frame in range(9)] * 4
    assert transitions.spec.step_seconds == 0.05
    assert account()["rate_hz"] == 20.0
    assert account()["totals"] == account()["totals"] | {"rows": 40, "gaps": 0, "off_rate": 0, "transitions": 36}


def test_a_file_of_version_3_may_end_inside_an_episode() -> None:
    write_v3(Path("set"), frames(), 4, 25, 33)
    assert lengths(imported(**LEROBOT)) == [9] * 4
    assert account()["totals"]["joined"] == 3


def test_a_chunk_of_version_2_is_one_log() -> None:
    write_v2(Path("set"), frames())
    imported(**LEROBOT)
    assert list(account()["files"]) == ["set/data/chunk-000", "set/data/chunk-001"]


@pytest.mark.parametrize("write", [write_v2, write_v3])
def test_missing_frames_end_episodes_and_are_counted(write: Callable[..., None]) -> None:
    table = frames()
    write(Path("set"), table.filter(~polars.col("frame_index").is_in([4, 5])))
    assert lengths(imported(**LEROBOT)) == [3] * 8
    assert account()["totals"]["gaps"] == 4
    pause = polars.when(polars.col("frame_index") > 6).then(polars.col("timestamp") + 1).otherwise("timestamp")
    write(Path("set"), table.with_columns(timestamp=pause.cast(polars.Float32)))
    assert lengths(imported(**LEROBOT)) == [6, 2] * 4


def test_frames_that_the_list_has_and_the_data_lack_are_counted() -> None:
    write_v3(Path("set"), frames())
    file = Path("set/data/chunk-000/file-000.parquet")
    polars.read_parquet(file)[:-3].write_parquet(file)
    imported(**LEROBOT)
    assert account()["totals"]["missing_frames"] == 3
    assert next(iter(account()["details"].values()))["frames_beside_the_list"] == {"3": -3}


def test_the_flags_of_a_dataset_end_episodes() -> None:
    write_v3(Path("set"), frames())
    transitions = imported(**LEROBOT, terminated="next.done")
    np.testing.assert_array_equal(transitions.terminated, np.arange(36) % 9 == 8)


def test_the_rate_may_be_said_and_has_to_agree() -> None:
    write_v3(Path("set"), frames())
    assert len(imported(**LEROBOT | {"rate_hz": 20.0})) == 36
    assert "set/meta/info.json: the dataset has 20 frames in a second, but rate_hz is 30" in refusal(
        **LEROBOT | {"rate_hz": 30.0}
    )


@pytest.mark.parametrize(
    ("field", "what"),
    [
        (
            "observation.state[wrist.pos]",
            "no element of the name 'wrist.pos'; the names are: shoulder_pan",
        ),
        ("observation.state", "column 'observation.state' has arrays of 2"),
        ("observation.images.top", "'observation.images.top' is a video, but numbers are wanted"),
        ("observation.images.top[0]", "'observation.images.top' is a video, but numbers are wanted"),
        ("timestamp[x]", "the names are: none; write its place, from 0"),
        ("observation.velocity[0]", "there is no column 'observation.velocity[0]'"),
    ],
)
def test_a_name_or_column_that_is_not_there_is_refused(field: str, what: str) -> None:
    write_v3(Path("set"), frames())
    assert what in refusal(**LEROBOT | {"observation": {"q": {"field": field}}})


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"codebase_version": "v1.6"}, "codebase_version is 'v1.6', but versions 2 and 3 can be read"),
        ({"fps": None}, "fps should be the number of frames in a second, but is None"),
        ({"fps": 0}, "but is 0"),
        ({"features": None}, "the names are: none"),
    ],
)
def test_an_account_that_cannot_be_used_is_refused(changes: dict[str, Any], what: str) -> None:
    write_v3(Path("set"), frames(), **changes)
    assert what in refusal(**LEROBOT)


def test_a_folder_that_is_no_dataset_is_refused() -> None:
    assert "set/meta/info.json: the file cannot be read" in refusal(**LEROBOT)
    write_v3(Path("set"), frames())
    for file in Path("set/data/chunk-000").iterdir():
        file.unlink()
    assert "set: there is no data/chunk-*/*.parquet" in refusal(**LEROBOT)


def test_a_dataset_can_be_judged_before_it_is_imported() -> None:
    write_v3(Path("set"), frames())
    assessed = assess(source(**LEROBOT | {"tolerance_s": ...}))
    assert assessed.transitions == 36
    assert assessed.counts["rows"] == 40
