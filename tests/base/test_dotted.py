"""Nested mappings by dotted keys."""

from addressed_dynamics.base.dotted import dotted


def test_keys_are_joined_by_dots_in_the_order_that_they_stand_in() -> None:
    tree = {"a": {"b": {"c": 1}, "d": [2, 3]}, "e": None}
    assert list(dotted(tree)) == [("a.b.c", 1), ("a.d", [2, 3]), ("e", None)]


def test_an_empty_mapping_is_a_value_but_for_the_outermost() -> None:
    assert dict(dotted({"a": {"b": {}}})) == {"a.b": {}}
    assert not list(dotted({}))
