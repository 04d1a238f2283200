"""Episodes of tables: where they end, and what goes on in the next file."""

from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from foreign_logs import json_log, save, source, states_and_commands
from foreign_tables import account, imported, lengths, refusal
from hypothesis import given, settings
from hypothesis import strategies as st

from addressed_dynamics.importing import import_logs
from addressed_dynamics.sources.transitions.reading import read_transitions

BY_COLUMN: dict[str, Any] = {
    "kind": "parquet",
    "files": ["*.parquet"],
    "episode": {"by": "column", "column": "e"},
}


@pytest.fixture(autouse=True)
def _in_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def recording(episodes: int = 4, steps: int = 10) -> polars.DataFrame:
    """Every row one period after the one before it; `done` in the last row of each episode."""
    index = np.arange(episodes * steps)
    return polars.DataFrame(
        {
            "e": index // steps,
            "i": index % steps,
            "t": index / 20.0,
            "q": index / 4,
            "u": index % 3,
            "done": index % steps == steps - 1,
        }
    )


def write(**parts: polars.DataFrame) -> None:
    for name, part in parts.items():
        part.write_parquet(f"{name}.parquet")


def test_an_episode_that_goes_on_in_the_next_file_is_one_and_the_account_says_so() -> None:
    table = recording()
    write(a=table[:25], b=table[25:])
    transitions = imported(**BY_COLUMN)
    assert lengths(transitions) == [9] * 4
    assert account()["totals"]["joined"] == 1
    assert account()["details"]["a.parquet"]["joined"] == {"b.parquet": 5}
    assert account()["totals"]["rows"] == 40


def test_an_episode_may_go_on_over_many_files() -> None:
    table = recording(3, 12)
    write(**{f"f{i}": table[3 * i : 3 * i + 3] for i in range(12)})
    assert lengths(imported(**BY_COLUMN, clock={"frame": "i"})) == [11] * 3
    assert account()["totals"]["joined"] == 9


def test_files_that_number_their_episodes_anew_are_not_joined() -> None:
    one, two = recording(1), recording(2)
    write(a=one, b=one)
    assert lengths(imported(**BY_COLUMN)) == [9, 9]
    assert account()["totals"]["unjoined"] == 1
    write(a=two, b=one, c=one)
    assert lengths(imported(**BY_COLUMN)) == [9] * 4
    assert "joined" not in account()["totals"]


def test_the_clock_decides_whether_an_episode_goes_on() -> None:
    one = recording(1)
    later = one.with_columns(t=polars.col("t") + 0.5, i=polars.col("i") + 10)
    much_later = one.with_columns(t=polars.col("t") + 9.0)
    write(a=one, b=later)
    for clock in ({"column": "t"}, {"frame": "i"}):
        assert lengths(imported(**BY_COLUMN, clock=clock)) == [19]
    write(a=one, b=much_later)
    assert lengths(imported(**BY_COLUMN, clock={"column": "t"})) == [9, 9]
    assert account()["totals"]["gaps"] == 1
    write(a=one, b=one)
    assert lengths(imported(**BY_COLUMN, clock={"column": "t"})) == [9, 9]
    assert account()["totals"]["gaps"] == 0


def test_files_are_episodes_if_the_source_says_so() -> None:
    table = recording(2)
    write(a=table[:5], b=table[5:])
    changes = BY_COLUMN | {"episode": {"by": "file"}}
    assert lengths(imported(**changes, clock={"column": "t"})) == [4, 14]


@pytest.mark.parametrize("key", ["terminated", "truncated"])
def test_an_episode_ends_where_a_column_says_so(key: str) -> None:
    write(a=recording())
    changes = BY_COLUMN | {"episode": {"by": "end"}, key: "done"}
    transitions = imported(**changes)
    assert lengths(transitions) == [9] * 4
    ends = [i % 9 == 8 for i in range(36)]
    assert getattr(transitions, key).tolist() == ends
    assert (transitions.terminated | transitions.truncated).tolist() == ends


def test_an_end_inside_a_labelled_episode_cuts_it() -> None:
    write(a=recording().with_columns(e=polars.lit(0)))
    transitions = imported(**BY_COLUMN, terminated="done")
    assert lengths(transitions) == [9] * 4
    assert transitions.terminated.sum() == 4


def test_an_episode_that_has_not_ended_goes_on_in_the_next_file_if_the_clock_does() -> None:
    table = recording()
    write(a=table[:25], b=table[25:])
    changes = BY_COLUMN | {"episode": {"by": "end"}, "terminated": "done"}
    assert lengths(imported(**changes, clock={"column": "t"})) == [9] * 4
    assert lengths(imported(**changes)) == [9, 9, 4, 4, 9]
    assert account()["totals"]["unjoined"] == 1
    assert account()["details"]["b.parquet"]["unjoined"] == "a.parquet"


def test_ends_need_a_column() -> None:
    write(a=recording())
    assert "give terminated or truncated" in str(_params_error(**(BY_COLUMN | {"episode": {"by": "end"}})))


def _params_error(**changes: Any) -> Exception:
    from pydantic import ValidationError

    with pytest.raises(ValidationError) as caught:
        imported(**changes)
    return caught.value


@pytest.mark.parametrize("column", ["done", "e"])
def test_a_value_that_comes_back_is_refused_with_safe_advice(column: str) -> None:
    run = recording(2)
    write(a=polars.concat([run, run]))
    message = refusal(**(BY_COLUMN | {"episode": {"by": "column", "column": column}}))
    assert f"a value of column '{column}' comes back after another one" in message
    assert "sort" not in message
    assert "name another column, or give each run a file" in message
    assert "by: end" in message


@settings(max_examples=25)
@given(cuts=st.sets(st.integers(1, 39), max_size=6))
def test_files_cut_anywhere_give_the_transitions_of_the_whole(
    tmp_path_factory: pytest.TempPathFactory, cuts: set[int]
) -> None:
    table, folder = recording(), tmp_path_factory.mktemp("cut")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        write(whole=table)
        changes = BY_COLUMN | {"min_length": 2, "clock": {"column": "t"}}
        whole = imported(**changes)
        Path("whole.parquet").unlink()
        ends = [*sorted(cuts), 40]
        write(**{f"part_{i}": table[start:end] for i, (start, end) in enumerate(zip([0, *ends], ends, strict=False))})
        cut = imported(**changes)
        np.testing.assert_array_equal(cut.observation, whole.observation)
        np.testing.assert_array_equal(cut.next_observation, whole.next_observation)
        assert lengths(cut) == lengths(whole) == [9] * 4


def test_a_field_of_a_message_may_say_where_an_episode_ends() -> None:
    messages = [
        (topic, time, message | {"done": time == 100_500_000_000} if topic == "/joint_states" else message)
        for topic, time, message in states_and_commands()
    ]
    save(Path(), a=json_log(messages))
    field = {"joint": {"field": "/joint_states.position[0:2]"}}
    asked = source(observation=field, terminated="/joint_states.done", rate_hz=20.0)
    import_logs(asked, Path("out"), name="arm", progress=lambda _: None)
    transitions = read_transitions(Path("out"))
    assert len(lengths(transitions)) == 2
    assert np.flatnonzero(transitions.terminated).tolist() == [lengths(transitions)[0] - 1]
    np.testing.assert_allclose(transitions.next_observation[transitions.terminated, 0], 0.5)
