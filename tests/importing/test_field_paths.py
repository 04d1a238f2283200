"""Field paths: how they are written, what they lead to, and what is said of one that leads nowhere."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.importing.paths import (
    FieldPath,
    Label,
    MissingField,
    Step,
    expand_slice,
    listed_fields,
    look_up,
    parse_path,
)

TOPICS = st.text(st.characters(codec="utf-8", exclude_characters='"', exclude_categories=("C",)), min_size=1)
NAMES = st.from_regex(r"[A-Za-z_][A-Za-z0-9_ /.\[-]*", fullmatch=True)
STEPS = NAMES | st.integers(0, 10**6) | (NAMES | st.from_regex(r"[0-9]+", fullmatch=True)).map(Label)
PATHS = st.builds(FieldPath, TOPICS, st.lists(STEPS, min_size=1, max_size=5).map(tuple))


@given(path=PATHS)
def test_a_path_is_read_as_it_is_written(path: FieldPath) -> None:
    assert parse_path(str(path)) == path


@pytest.mark.parametrize(
    ("text", "topic", "steps"),
    [
        ("/cmd_vel.linear.x", "/cmd_vel", ("linear", "x")),
        ("/robot/joint_states.position[2]", "/robot/joint_states", ("position", 2)),
        ('"/robot.v2/joint[0]".position[2]', "/robot.v2/joint[0]", ("position", 2)),
        ("/poses[1].x", "/poses", (1, "x")),
        ("state.a", "state", ("a",)),
        ('/state."pos.x"[0]', "/state", ("pos.x", 0)),
        ("/joint_states.position[elbow]", "/joint_states", ("position", Label("elbow"))),
        ('/joint_states.position["2"]', "/joint_states", ("position", Label("2"))),
    ],
)
def test_a_topic_ends_at_the_first_dot_unless_it_is_quoted(text: str, topic: str, steps: tuple[Step, ...]) -> None:
    assert parse_path(text) == FieldPath(topic, steps)


@pytest.mark.parametrize("text", ["", "/topic", "/topic.", ".field", "/t.a[", "/t.a[-1]", '/t.a["x]', '"/t.a', "/t..a"])
def test_what_is_no_path_is_refused_with_the_place(text: str) -> None:
    with pytest.raises(ParamsError, match=r"is not the path of a field \(see character \d+\)"):
        parse_path(text)


@given(first=st.integers(0, 50), count=st.integers(1, 20))
def test_a_slice_is_each_of_its_places(first: int, count: int) -> None:
    expanded = expand_slice(f"/t.a[{first}:{first + count}].x")
    assert expanded == [(place, f"/t.a[{place}].x") for place in range(first, first + count)]


@pytest.mark.parametrize("text", ["/t.a[3:3]", "/t.a[0:2][0:2]"])
def test_an_empty_slice_or_two_of_them_are_refused(text: str) -> None:
    with pytest.raises(ParamsError, match="should have one slice"):
        expand_slice(text)


def at_its_place(_steps: Any, _containers: Any, _array: Any, step: int | Label) -> int:
    assert isinstance(step, int)
    return step


def test_every_array_on_the_way_is_asked_for_its_element() -> None:
    seen = []

    def second(steps: Any, containers: Any, array: Any, step: int | Label) -> int:
        seen.append((steps, len(containers), len(array), step))
        return len(array) - 1

    assert look_up({"a": [{"b": [1, 2]}]}, ("a", 0, "b", Label("x")), second) == 2
    assert seen == [(("a",), 2, 1, 0), (("a", 0, "b"), 4, 2, Label("x"))]


@pytest.mark.parametrize("steps", [("b",), ("a", "b"), ("a", 2), ("a", 0, "c"), ("s", 0)])
def test_a_way_to_nowhere_is_told_from_an_unset_value(steps: tuple[str | int, ...]) -> None:
    message = {"a": [1, 2], "s": "text", "unset": None}
    with pytest.raises(MissingField):
        look_up(message, steps, at_its_place)
    assert look_up(message, ("unset", "x", 3), at_its_place) is None


def test_fields_are_listed_with_arrays_as_slices_and_not_without_end() -> None:
    assert listed_fields({"a": [1, 2], "b": {"c": 1}, "d": [{"e": 1}]}) == "a[0:2], b.c, d[0].e"
    assert listed_fields({"pos.x": 1}) == '"pos.x"'
    assert listed_fields({f"f{i}": 0 for i in range(100)}).endswith("f39 and 60 more")
