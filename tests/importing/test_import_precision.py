"""Values whose steps are too small for float32."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from foreign_logs import json_log, save, states_and_commands
from foreign_logs import source as mcap_source
from foreign_tables import account, imported, refusal
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.episodes.precision import swallowed
from addressed_dynamics.importing import import_logs


@pytest.fixture(autouse=True)
def _in_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def north(step: float = 0.01, start: float = 5301234.0) -> None:
    index = np.arange(400)
    polars.DataFrame({"q": start + step * index, "u": np.sin(index)}).write_csv("a.csv")


def test_a_dimension_of_which_most_steps_are_lost_is_refused_with_an_offset() -> None:
    north()
    message = refusal()
    assert "a.csv: float32 cannot hold 'observation.q' (field 'q'): 391 of the 399 steps" in message
    assert "give it an offset that is taken off, such as 5301236" in message


def test_an_offset_keeps_the_steps_and_is_written_down_and_taken_off_the_bounds() -> None:
    north()
    field = {"field": "q", "offset": 5301234, "low": 5301234.0, "high": 5301237.0}
    transitions = imported(observation={"q": field})
    np.testing.assert_allclose(transitions.observation[:, 0], 0.01 * np.arange(399), atol=1e-6)
    assert (transitions.spec.observation[0].low, transitions.spec.observation[0].high) == (0.0, 3.0)
    assert account()["offsets"] == {"observation.q": 5301234.0}
    assert "swallowed" not in account()["totals"]
    assert account()["totals"]["out_of_range"] == 99


def test_fewer_lost_steps_are_counted() -> None:
    index = np.arange(400)
    small = np.where(index % 4 == 0, 0.001, 1.0)
    polars.DataFrame({"q": 5301234.0 + np.cumsum(small), "u": index}).write_csv("a.csv")
    imported()
    assert account()["totals"]["swallowed"] == 99
    assert account()["details"]["a.csv"]["swallowed"] == {"observation.q": 99}


def test_small_values_and_rounding_lose_nothing() -> None:
    index = np.arange(400)
    for values in (0.01 * index, np.where(index % 2, 0.3, 0.1 + 0.2), 1e-30 * index):
        polars.DataFrame({"q": values, "u": index}).write_csv("a.csv")
        imported()
        assert "swallowed" not in account()["totals"]


def test_the_same_holds_for_logs_of_messages() -> None:
    messages = [
        (
            topic,
            time,
            {"position": [5e6 + message["position"][0] / 100, 0.0], "name": ""} if "position" in message else message,
        )
        for topic, time, message in states_and_commands()
    ]
    save(Path(), a=json_log(messages))
    field: dict[str, Any] = {"field": "/joint_states.position[0]"}
    with pytest.raises(TableError, match=r"float32 cannot hold 'observation\.q'"):
        import_logs(mcap_source(observation={"q": field}), Path("out"), name="arm", progress=lambda _: None)
    import_logs(
        mcap_source(observation={"q": field | {"offset": 5e6}}), Path("out"), name="arm", progress=lambda _: None
    )
    assert account()["offsets"] == {"observation.q": 5e6}


@given(st.lists(st.floats(-1e9, 1e9), min_size=2, max_size=20))
def test_what_is_lost_is_what_float32_makes_equal(values: list[float]) -> None:
    column = np.array(values)[:, None]
    found = swallowed(column, np.ones(len(values), dtype=np.bool_))
    single = column.astype(np.float32)
    steps = [(float(a[0]), float(b[0])) for a, b in pairwise(column)]
    far = [abs(a - b) > 16 * np.spacing(max(abs(a), abs(b))) for a, b in steps]
    equal = (single[:-1] == single[1:])[:, 0]
    assert found.lost[0] == sum(bool(x and y) for x, y in zip(far, equal, strict=True))
    assert found.changed[0] == sum(far)


def test_offsets_are_taken_off_their_own_columns_beside_a_discrete_action() -> None:
    index = np.arange(40)
    polars.DataFrame({"q": 7.0 + index, "u": index % 2, "w": 5e6 + index / 100}).write_csv("a.csv")
    changes: dict[str, Any] = {"action": {"discrete": {"field": "u", "names": ["left", "right"]}}}
    assert "float32 cannot hold 'exogenous.w' (field 'w')" in refusal(**changes, exogenous={"w": {"field": "w"}})
    transitions = imported(
        **changes,
        observation={"q": {"field": "q", "offset": 7.0}},
        exogenous={"w": {"field": "w", "offset": 5e6}},
    )
    np.testing.assert_allclose(transitions.exogenous[:, 0], index[:-1] / 100, atol=1e-6)
    assert transitions.observation[:, 0].tolist() == index[:-1].tolist()
    assert transitions.action.tolist() == (index[:-1] % 2).tolist()
    assert account()["offsets"] == {"observation.q": 7.0, "exogenous.w": 5e6}
