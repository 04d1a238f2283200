"""Import of CSV, Parquet and Minari."""

import json
import sys
from functools import partial
from pathlib import Path
from typing import Any

import foreign_tables
import numpy as np
import polars
import pytest

from addressed_dynamics.base.errors import TableError

TABLE = {
    "kind": "csv",
    "files": ["*.csv"],
    "observation": {"angle": {"field": "angle", "unit": "rad"}, "speed": {"field": "speed"}},
    "action": {"discrete": {"field": "push", "names": ["left", "right"]}},
    "reward": "reward",
    "tolerance_s": ...,
    "episode": {"by": "column", "column": "episode"},
}


@pytest.fixture(autouse=True)
def _in_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def rows(count: int = 12, episodes: int = 3) -> polars.DataFrame:
    index = np.arange(count)
    return polars.DataFrame(
        {
            "episode": [f"e{i * episodes // count}" for i in range(count)],
            "angle": index / 8,
            "speed": -index / 4,
            "push": ["left" if i % 2 else "right" for i in range(count)],
            "reward": index % 3,
        }
    )


imported, refusal = partial(foreign_tables.imported, TABLE), partial(foreign_tables.refusal, TABLE)


def totals() -> dict[str, int]:
    counts: dict[str, int] = json.loads(Path("out/import.json").read_text())["totals"]
    return counts


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_rows_are_samples_and_the_last_of_an_episode_is_only_a_next_observation(kind: str) -> None:
    table = rows()
    table.write_csv("a.csv")
    table.write_parquet("a.parquet")
    transitions = imported(kind=kind, files=[f"*.{kind}"])
    before = [i for i in range(12) if i % 4 != 3]
    assert transitions.observation[:, 0].tolist() == [i / 8 for i in before]
    assert transitions.next_observation[:, 1].tolist() == [-(i + 1) / 4 for i in before]
    assert transitions.action.tolist() == [i % 2 == 0 for i in before]
    assert transitions.reward.tolist() == [i % 3 for i in before]
    assert transitions.truncated.tolist() == [i % 4 == 2 for i in before]
    assert transitions.time_ns.tolist() == [i * 100_000_000 for i in range(9)]


WIND = {"gust": {"field": "wind[0:2]", "unit": "m/s", "low": -1.0, "high": 5.0}}


@pytest.mark.parametrize("action", ["discrete", "continuous"])
def test_exogenous_inputs_of_a_step_are_those_beside_its_action(action: str) -> None:
    table = rows().with_columns(wind=polars.Series([[i / 2, -i / 2] for i in range(12)]), thrust=np.arange(12) / 4)
    table.write_parquet("a.parquet")
    continuous = {"action": {"continuous": {"thrust": {"field": "thrust"}}}}
    transitions = imported(
        kind="parquet", files=["a.parquet"], exogenous=WIND, **(continuous if action == "continuous" else {})
    )
    before = [i for i in range(12) if i % 4 != 3]
    assert [(each.name, each.unit, each.low) for each in transitions.spec.exogenous] == [
        ("gust_0", "m/s", -1.0), ("gust_1", "m/s", -1.0),
    ]  # fmt: skip
    assert transitions.exogenous.tolist() == [[i / 2, -i / 2] for i in before]
    assert transitions.reward.tolist() == [i % 3 for i in before]
    outside = json.loads(Path("out/import.json").read_text())["details"]["a.parquet"]["out_of_range"]
    assert outside == {"exogenous.gust_0": 1, "exogenous.gust_1": 9}


def test_a_row_without_its_exogenous_input_is_dropped_and_cuts_the_episode() -> None:
    wind = [None if i == 5 else float(i) for i in range(12)]
    rows().with_columns(wind=polars.Series(wind)).write_csv("a.csv")
    transitions = imported(exogenous={"wind": {"field": "wind"}})
    assert transitions.exogenous[:, 0].tolist() == [0, 1, 2, 6, 8, 9, 10]
    assert (totals()["not_finite"], totals()["dropped"]) == (1, 1)
    assert "there is no column 'gust'" in refusal(exogenous={"wind": {"field": "gust"}})


def test_arrays_in_columns_are_taken_apart_by_a_slice() -> None:
    columns = {"observation.state": [[i, 2 * i, 3 * i] for i in range(5)], "action": [[i / 2] for i in range(5)]}
    polars.DataFrame(columns).write_parquet("a.parquet")
    changes = {
        "kind": "parquet",
        "files": ["a.parquet"],
        "observation": {"joint": {"field": "observation.state[1:3]"}},
        "action": {"continuous": {"torque": {"field": "action[0]"}}},
        "reward": None,
        "episode": {"by": "file"},
    }
    transitions = imported(**changes)
    assert transitions.observation.tolist() == [[2 * i, 3 * i] for i in range(4)]
    polars.DataFrame({**columns, "action": [[1.0], [1.0, 2.0], [1.0], [1.0], [1.0]]}).write_parquet("a.parquet")
    assert "the length of the arrays in column 'action' is 2, but 1 in" in refusal(**changes)


def test_rows_that_cannot_be_used_are_dropped_and_cut_the_episode() -> None:
    table = rows().with_columns(
        angle=polars.Series([None if i == 1 else i / 8 for i in range(12)]),
        speed=polars.Series([float("inf") if i == 9 else 0.0 for i in range(12)]),
    )
    table.write_csv("a.csv")
    transitions = imported()
    assert np.unique(transitions.episode, return_counts=True)[1].tolist() == [1, 3, 1]
    assert (totals()["rows"], totals()["not_finite"], totals()["short"], totals()["dropped"]) == (12, 2, 2, 2)


def test_episodes_of_several_files_never_share_a_number() -> None:
    rows().write_csv("a.csv")
    rows().write_csv("b.csv")
    assert len(np.unique(imported().episode)) == 6


@pytest.mark.parametrize(
    ("changes", "what"),
    [
        ({"reward": "gain"}, "a.csv: there is no column 'gain'; its columns are: episode, angle, speed, push, reward"),
        ({"reward": "push"}, "a.csv: line 2, column 'push': 'right' is not a number"),
        ({"reward": "angle[0]"}, "no arrays or parts, so 'angle[0]' cannot be used; leave out the '[0]'"),
        ({"action": {"discrete": {"field": "push", "names": ["left", "up"]}}}, "'right' is none of the actions 0..1"),
        ({"min_length": 5}, "expected episodes of at least 5 samples, but there is none (12 rows"),
        ({"kind": "parquet"}, "a.csv: the file cannot be read as parquet"),
        ({"files": ["b.csv"]}, "no file matches 'b.csv'"),
    ],
)
def test_what_is_wrong_with_a_table_or_its_source_is_said_in_one_line(changes: dict[str, Any], what: str) -> None:
    rows().write_csv("a.csv")
    assert what in refusal(**changes)


def test_an_episode_that_comes_back_is_refused_with_its_lines_and_without_the_advice_to_sort() -> None:
    rows().sort("reward").write_csv("a.csv")
    message = refusal()
    assert "a.csv: line 6: a value of column 'episode' comes back after another one" in message
    assert "(line 2)" in message
    assert "sort" not in message


@pytest.mark.parametrize("data", [b"", b"\xff\xfe\x00", b"angle\n1\n2,3,4\n", b"PAR1garbagePAR1"])
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_damaged_table_is_refused(kind: str, data: bytes) -> None:
    Path(f"a.{kind}").write_bytes(data)
    assert f"a.{kind}" in refusal(kind=kind, files=[f"a.{kind}"])


MINARI = {
    "kind": "minari",
    "files": ...,
    "observation": {"state": {"field": "observations[0:2]"}},
    "action": {"discrete": {"field": "actions", "names": ["left", "none", "right"]}},
    "reward": "rewards",
    "tolerance_s": ...,
    "episode": ...,
}


@pytest.fixture
def dataset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A Minari dataset of two episodes of three steps; the first ends inside the task."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    import minari
    from gymnasium import spaces
    from minari.data_collector.episode_buffer import EpisodeBuffer

    buffers = [
        EpisodeBuffer(
            id=number,
            observations=[np.array([i, number], dtype=np.float32) for i in range(4)],
            actions=[0, 1, 2],
            rewards=[1.0, 2.0, 3.0],
            terminations=[False, False, number == 0],
            truncations=[False, False, number == 1],
            infos={},
        )
        for number in range(2)
    ]
    minari.create_dataset_from_buffers(
        "arm-v0",
        buffers,
        action_space=spaces.Discrete(3),
        observation_space=spaces.Box(-10, 10, (2,)),
        data_format="arrow",
    )
    return tmp_path / "arm-v0"


@pytest.mark.filterwarnings("ignore::UserWarning:minari")  # it misses an author and a link
def test_a_minari_dataset_is_imported_by_name_or_folder(dataset: Path) -> None:
    for name in ("arm-v0", str(dataset)):
        transitions = imported(**MINARI, dataset=name)
        assert transitions.observation.tolist() == [[i, number] for number in range(2) for i in range(3)]
        assert transitions.action.tolist() == [0, 1, 2] * 2
        assert transitions.reward.tolist() == [1, 2, 3] * 2
        assert transitions.terminated.tolist() == [False, False, True, False, False, False]
        assert transitions.truncated.tolist() == [False, False, False, False, False, True]


def test_a_dataset_that_is_not_there_or_minari_that_is_not_installed_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    assert "nobody-v0: the dataset cannot be read" in refusal(**MINARI, dataset="nobody-v0")
    monkeypatch.setitem(sys.modules, "minari", None)
    with pytest.raises(TableError, match=r"pip install 'addressed-dynamics\[minari\]'"):
        imported(**MINARI, dataset="nobody-v0")
