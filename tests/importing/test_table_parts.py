"""Parts of columns: structures, nested arrays, and the spaces of Minari."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from foreign_tables import imported, refusal

PARQUET: dict[str, Any] = {"kind": "parquet", "files": ["a.parquet"]}


@pytest.fixture(autouse=True)
def _in_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def nested() -> None:
    polars.DataFrame(
        {
            "a": [{"x": float(i), "y": [[1.0 * i, i + 0.5], [10.0 * i, 0.0]], "z.w": {"v": -i}} for i in range(4)],
            "m": [[[i, 2 * i], [3 * i, 4 * i]] for i in range(4)],
            "s": [[{"k": i}] for i in range(4)],
            "a.x": [7.0] * 4,
            "u": [[i] for i in range(4)],
            "image": [b"png"] * 4,
        }
    ).write_parquet("a.parquet")


@pytest.mark.parametrize(
    ("field", "expected"),
    [
        ("a.y[0][1]", [0.5, 1.5, 2.5]),
        ("a.y[1][0]", [0, 10, 20]),
        ("a.z.w.v", [0, -1, -2]),
        ("m[1][1]", [0, 4, 8]),
        ("s[0].k", [0, 1, 2]),
        ("s.k", None),
        ("a.x", [7, 7, 7]),
        ("u", [0, 1, 2]),
    ],
)
def test_parts_are_named_as_in_messages_and_a_column_with_dots_wins(field: str, expected: list[float] | None) -> None:
    nested()
    if expected is None:
        assert "name one of their elements: s[0].k" in refusal(**PARQUET, observation={"q": {"field": field}})
    else:
        assert imported(**PARQUET, observation={"q": {"field": field}}).observation[:, 0].tolist() == expected


def test_a_slice_may_stand_between_other_steps() -> None:
    nested()
    transitions = imported(**PARQUET, observation={"q": {"field": "m[0:2][1]"}})
    assert transitions.observation.tolist() == [[2 * i, 4 * i] for i in range(3)]


@pytest.mark.parametrize(
    ("field", "what"),
    [
        ("a", "column 'a' has parts of its own, so 'a' cannot be used; name one of them: a.x, a.y[0][0:2], a.z.w.v"),
        ("a.n", "name one of them: a.x, a.y[0][0:2], a.z.w.v"),
        ("m[0]", "column 'm[0]' has arrays of 2, so 'm[0]' cannot be used; name one of their elements: m[0][0:2]"),
        ("m[0][5]", "column 'm[0]' has arrays of 2, so there is no [5]"),
        ("n.x", "there is no column 'n.x'; its columns are: a, m, s, a.x, u, image"),
        ("image", "b'png' is not a number"),
    ],
)
def test_a_part_that_is_not_there_is_refused_with_those_that_are(field: str, what: str) -> None:
    nested()
    assert what in refusal(**PARQUET, observation={"q": {"field": field}})


def test_an_array_without_elements_is_a_missing_value() -> None:
    polars.DataFrame({"q": [[1.0, 2.0], [], [3.0, 4.0], [5.0, 6.0]], "u": [0, 1, 2, 3]}).write_parquet("a.parquet")
    transitions = imported(**PARQUET, observation={"q": {"field": "q[0:2]"}})
    assert transitions.observation.tolist() == [[3.0, 4.0]]


MINARI: dict[str, Any] = {"kind": "minari", "files": ..., "dataset": "arm-v0", "episode": ...}


def _spaces(kind: str) -> tuple[Any, Any, Callable[[int], Any], Callable[[int], Any]]:
    from gymnasium import spaces

    box = spaces.Box(-99, 99, (2,), dtype=np.float32)
    one = spaces.Box(-99, 99, (1,), dtype=np.float32)

    def vector(i: int) -> np.ndarray:
        return np.array([i, -i], dtype=np.float32)

    if kind == "dict":
        space = spaces.Dict({"observation": box, "desired_goal": spaces.Dict({"kettle": one}), "word": spaces.Text(9)})
        return (
            space,
            spaces.Dict({"a": one, "b": spaces.Discrete(2)}),
            lambda i: {"observation": vector(i), "desired_goal": {"kettle": vector(i)[:1] * 3}, "word": "go"},
            lambda i: {"a": vector(i)[:1], "b": i % 2},
        )
    return (
        spaces.Tuple((box, spaces.Discrete(5))),
        spaces.Discrete(2),
        lambda i: (vector(i), i % 5),
        lambda i: i % 2,
    )


def _columns(values: list[Any]) -> Any:
    """Turn samples into arrays as Minari wants them."""
    match values[0]:
        case dict():
            return {name: _columns([value[name] for value in values]) for name in values[0]}
        case tuple():
            return tuple(_columns(list(part)) for part in zip(*values, strict=True))
        case str():
            return values
        case _:
            return np.array(values)


@pytest.fixture(params=["arrow", "hdf5"])
def make(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Make a dataset of two episodes of ten steps."""
    if request.param == "hdf5":
        pytest.importorskip("h5py", reason="Minari keeps datasets as HDF5 only with h5py")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    import minari
    from minari.data_collector.episode_buffer import EpisodeBuffer

    def make(kind: str) -> None:
        observation_space, action_space, observation, action = _spaces(kind)
        buffers = [
            EpisodeBuffer(
                id=number,
                observations=_columns([observation(i) for i in range(11)]),
                actions=_columns([action(i) for i in range(10)]),
                rewards=[1.0] * 10,
                terminations=[False] * 9 + [True],
                truncations=[False] * 10,
                infos={},
            )
            for number in range(2)
        ]
        minari.create_dataset_from_buffers(
            "arm-v0",
            buffers,
            action_space=action_space,
            observation_space=observation_space,
            data_format=request.param,
        )

    return make


@pytest.mark.filterwarnings("ignore::UserWarning:minari")  # it misses an author and a link
@pytest.mark.parametrize(
    ("kind", "field", "action", "expected"),
    [
        (
            "dict",
            "observations.desired_goal.kettle",
            {"continuous": {"u": {"field": "actions.a"}}},
            [[3.0 * i] for i in range(10)],
        ),
        (
            "dict",
            "observations.observation[0:2]",
            {"discrete": {"field": "actions.b", "names": ["x", "y"]}},
            [[i, -i] for i in range(10)],
        ),
        (
            "tuple",
            "observations[1]",
            {"discrete": {"field": "actions", "names": ["x", "y"]}},
            [[i % 5] for i in range(10)],
        ),
        (
            "tuple",
            "observations[0][0:2]",
            {"discrete": {"field": "actions", "names": ["x", "y"]}},
            [[i, -i] for i in range(10)],
        ),
    ],
)
def test_parts_of_nested_spaces_are_columns(
    make: Callable[[str], None], kind: str, field: str, action: Any, expected: list[list[float]]
) -> None:
    make(kind)
    transitions = imported(**MINARI, observation={"q": {"field": field}}, action=action)
    assert transitions.observation.tolist() == expected * 2
    if "continuous" in action:
        assert transitions.action[:, 0].tolist() == [*range(10)] * 2
    else:
        assert transitions.action.tolist() == [i % 2 for i in range(10)] * 2
    assert transitions.terminated.tolist() == ([False] * 9 + [True]) * 2


@pytest.mark.filterwarnings("ignore::UserWarning:minari")
def test_a_part_that_a_dataset_lacks_is_refused_with_those_it_has(make: Callable[[str], None]) -> None:
    make("dict")
    for field in ("observations", "observations.desired_goal", "observations.nothing"):
        message = refusal(**MINARI, observation={"q": {"field": field}})
        assert "its columns are: " in message
        for part in ("observations.observation", "observations.desired_goal.kettle", "actions.a", "rewards"):
            assert part in message
