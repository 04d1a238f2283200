"""The contract of transitions: what it accepts, what it refuses, and how it is taken apart and joined."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import TransitionsError
from addressed_dynamics.episodes.transitions import (
    COLUMNS,
    ContinuousAction,
    Dimension,
    DiscreteAction,
    SpaceSpec,
    Transitions,
)

POSITION = Dimension("position", "m", -1.2, 0.6)
VELOCITY = Dimension("velocity", "m/step", -np.inf, np.inf)
SPEC = SpaceSpec((POSITION, VELOCITY), DiscreteAction(("left", "right")), 0.1)


def episodes(*lengths: int, first: int = 0) -> Transitions:
    """Return transitions with episodes of the given lengths, numbered from `first`."""
    total = sum(lengths)
    step = np.concatenate([np.arange(length) for length in lengths] or [np.empty(0)]).astype(np.int32)
    episode = np.repeat(np.arange(len(lengths)) + first, lengths).astype(np.int64)
    observation = np.stack([episode, step], axis=1).astype(np.float32)
    last = np.append(step[1:] == 0, True)[:total]
    return Transitions(
        spec=SPEC,
        episode=episode,
        step=step,
        time_ns=np.arange(total, dtype=np.int64),
        observation=observation,
        action=np.zeros(total, dtype=np.int64),
        reward=np.ones(total, dtype=np.float32),
        next_observation=observation + np.float32([0, 1]),
        terminated=last,
        truncated=np.zeros(total, dtype=bool),
    )


def with_value(transitions: Transitions, column: str, row: Any, value: Any) -> dict[str, Any]:
    """Return `column` with `value` in `row`, as an argument for `replace`."""
    values = getattr(transitions, column).copy()
    values[row] = value
    return {column: values}


def assert_equal(left: Transitions, right: Transitions) -> None:
    assert left.spec == right.spec
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name))


lengths = st.lists(st.integers(1, 6), max_size=6)


@given(lengths)
def test_episode_slices_cover_every_row_once_and_in_order(lengths: list[int]) -> None:
    slices = list(episodes(*lengths).episode_slices())
    assert [each.stop - each.start for each in slices] == lengths
    assert [row for each in slices for row in range(each.start, each.stop)] == list(range(sum(lengths)))


@given(lengths, st.data())
def test_taking_whole_episodes_out_and_joining_the_rest_gives_the_same_rows(lengths: list[int], data: Any) -> None:
    whole = episodes(*lengths)
    cut = data.draw(st.integers(0, len(lengths)))
    parts = [whole.select(whole.episode < cut), whole.select(whole.episode >= cut)]
    assert_equal(Transitions.concatenate(parts), whole)


def test_a_selection_that_leaves_a_gap_in_an_episode_is_refused() -> None:
    with pytest.raises(TransitionsError, match=r"row 0 \(episode 0, step 0\) is not followed by the next step"):
        episodes(3).select(np.array([0, 2]))


def test_an_episode_may_be_cut_off_at_its_end_and_its_beginning() -> None:
    part = episodes(5).select(slice(1, 4))
    assert part.step.tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("column", "row", "value", "what"),
    [
        ("observation", (1, 0), np.nan, r"column 'observation' has a value that is not finite in row 1: \[nan, 1\.0\]"),
        ("next_observation", (4, 1), np.inf, "column 'next_observation' has a value that is not finite in row 4"),
        ("reward", 2, -np.inf, "column 'reward' has a value that is not finite in row 2"),
        ("action", 0, 2, r"actions should lie in 0\.\.1, but lie in 0\.\.2"),
        ("action", 0, -1, r"actions should lie in 0\.\.1, but lie in -1\.\.0"),
        ("step", 1, 2, r"row 0 \(episode 0, step 0\) is not followed by the next step of its episode"),
        ("next_observation", (3, 1), 7, r"row 3 \(episode 1, step 0\) has a next_observation that is not"),
        ("terminated", 0, True, r"row 0 \(episode 0, step 0\) ends its episode, but more steps"),
        ("truncated", 4, True, r"row 4 \(episode 1, step 1\) ends its episode, but more steps"),
    ],
)
def test_a_broken_row_is_refused_and_named(column: str, row: Any, value: Any, what: str) -> None:
    whole = episodes(3, 3)
    with pytest.raises(TransitionsError, match=what):
        replace(whole, **with_value(whole, column, row, value))


def test_an_episode_in_two_places_is_refused() -> None:
    with pytest.raises(TransitionsError, match="the rows of episode 1 are not contiguous"):
        Transitions.concatenate([episodes(2, 2), episodes(2, first=2), episodes(2, first=1)])


@pytest.mark.parametrize("column", COLUMNS)
def test_a_column_of_another_length_or_type_is_refused(column: str) -> None:
    whole = episodes(3)
    values = getattr(whole, column)
    # The length of the whole is that of `episode`.
    culprit = "step" if column == "episode" else column
    with pytest.raises(TransitionsError, match=rf"column '{culprit}' should be \w+ of shape \([23],"):
        replace(whole, **{column: values[:2]})
    with pytest.raises(TransitionsError, match=f"column '{column}' should be .* but is float16"):
        replace(whole, **{column: values.astype(np.float16)})


def test_continuous_actions_are_vectors_of_float32() -> None:
    whole = episodes(2)
    spec = SpaceSpec(SPEC.observation, ContinuousAction((Dimension("torque", "N m", -1, 1),)), 0.1)
    actions = np.zeros((2, 1), dtype=np.float32)
    assert replace(whole, spec=spec, action=actions).action.shape == (2, 1)
    with pytest.raises(TransitionsError, match=r"column 'action' should be float32 of shape \(2, 1\)"):
        replace(whole, spec=spec)


def test_transitions_of_different_spaces_do_not_join() -> None:
    other = replace(episodes(2, first=5), spec=replace(SPEC, step_seconds=0.2))
    with pytest.raises(TransitionsError, match="different spaces"):
        Transitions.concatenate([episodes(2), other])
    with pytest.raises(TransitionsError, match="list of parts is empty"):
        Transitions.concatenate([])


dimensions = st.builds(
    Dimension,
    name=st.text("abc_", min_size=1, max_size=5),
    unit=st.text(max_size=3),
    low=st.floats(allow_nan=False, max_value=0),
    high=st.floats(allow_nan=False, min_value=0),
)
specs = st.builds(
    SpaceSpec,
    observation=st.lists(dimensions, max_size=3).map(tuple),
    action=st.builds(DiscreteAction, st.lists(st.text(), max_size=3).map(tuple))
    | st.builds(ContinuousAction, st.lists(dimensions, max_size=3).map(tuple)),
    step_seconds=st.floats(1e-6, 1e3),
)


@given(specs)
def test_a_spec_survives_json(spec: SpaceSpec) -> None:
    assert SpaceSpec.from_json(json.loads(json.dumps(spec.to_json(), allow_nan=False))) == spec


def test_bounds_from_an_environments_float32_arrays_are_json_too() -> None:
    spec = replace(SPEC, observation=(Dimension("x", "", np.float32(-1.5), np.float32(np.inf)),))
    bounds = json.loads(json.dumps(spec.to_json()))["observation"][0]
    assert (bounds["low"], bounds["high"]) == (-1.5, None)


@pytest.mark.parametrize("value", [None, [], {}, {"observation": []}, {**SPEC.to_json(), "step_seconds": "fast"}])
def test_a_malformed_spec_is_refused(value: Any) -> None:
    with pytest.raises(TransitionsError, match="description of spaces is incomplete or malformed"):
        SpaceSpec.from_json(value)


WIND = Dimension("wind", "m/s", -20.0, 20.0)


def windy(*lengths: int) -> Transitions:
    """The same episodes with a wind that is the number of the row."""
    whole = episodes(*lengths)
    wind = np.arange(len(whole), dtype=np.float32)[:, None]
    return replace(whole, spec=replace(SPEC, exogenous=(WIND,)), exogenous=wind)


def test_without_exogenous_inputs_their_column_has_no_width_and_the_spec_says_nothing_of_them() -> None:
    assert episodes(2, 3).exogenous.shape == (5, 0)
    assert list(SPEC.to_json()) == ["observation", "action", "step_seconds"]


def test_exogenous_inputs_travel_with_their_steps_and_their_spec() -> None:
    whole = windy(2, 3)
    assert whole.select(whole.episode == 1).exogenous[:, 0].tolist() == [2, 3, 4]
    parts = [whole.select(whole.episode == number) for number in (0, 1)]
    assert_equal(Transitions.concatenate(parts), whole)
    assert SpaceSpec.from_json(json.loads(json.dumps(whole.spec.to_json()))) == whole.spec
    with pytest.raises(TransitionsError, match="different spaces"):
        Transitions.concatenate([episodes(2), windy(2)])


@pytest.mark.parametrize(
    ("exogenous", "problem"),
    [
        (None, r"column 'exogenous' should be float32 of shape \(3, 1\), but is float32 of shape \(0, 0\)"),
        (np.zeros((3, 2), np.float32), r"shape \(3, 1\), but is float32 of shape \(3, 2\)"),
        (np.zeros(3, np.float32), r"shape \(3, 1\), but is float32 of shape \(3,\)"),
        (np.array([[0], [np.nan], [0]], np.float32), "'exogenous' has a value that is not finite in row 1"),
    ],
)
def test_exogenous_inputs_that_do_not_fit_the_spaces_are_refused(exogenous: np.ndarray | None, problem: str) -> None:
    whole = windy(3)
    columns = {name: getattr(whole, name) for name in COLUMNS if name != "exogenous"}
    given = {} if exogenous is None else {"exogenous": exogenous}
    with pytest.raises(TransitionsError, match=problem):
        Transitions(spec=whole.spec, **columns, **given)
