from dataclasses import replace

import numpy as np
import pytest
from builders import CAR, WINDY
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import space_specs

from addressed_dynamics.base.errors import SpaceError
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, DiscreteAction, SpaceSpec
from addressed_dynamics.logs.layout import message_layout
from addressed_dynamics.logs.schema import (
    EPISODE_SCHEMA,
    MOST_DIMENSIONS,
    TRANSITION_SCHEMA,
    episode_file,
    schema_data,
    transition_file,
)


def message_class(file, name):
    files = descriptor_pb2.FileDescriptorSet.FromString(schema_data(file)).file
    pool = descriptor_pool.DescriptorPool()
    for each in files:
        pool.Add(each)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def spec_of(observations: int, actions: int = 1) -> SpaceSpec:
    return SpaceSpec(
        observation=tuple(Dimension(f"observation_{i}", "", -1.0, 1.0) for i in range(observations)),
        action=ContinuousAction(tuple(Dimension(f"action_{i}", "", -1.0, 1.0) for i in range(actions))),
        step_seconds=1.0,
    )


def filled(layout, generator):
    """One message with a number in every value, none of them zero."""
    row = layout.blank()
    for name in ("episode", "step"):
        row[name] = generator.integers(1, 2**31)
    row["reward"] = generator.standard_normal()
    row["terminated"] = row["truncated"] = 1
    for field in layout.parts.keys() & {"observation", "next_observation", "action", "exogenous"}:
        if layout.parts[field] == (field,):
            row[field] = generator.integers(1, 2**62)
        else:
            for part in layout.vector_parts(row, field):
                part[...] = generator.standard_normal(part.shape)
    return row


def assert_protobuf_agrees(spec: SpaceSpec, generator) -> None:
    file = transition_file(spec)
    layout = message_layout(file.message_type[0])
    row = filled(layout, generator)
    message = message_class(file, TRANSITION_SCHEMA).FromString(row.tobytes())
    assert message.episode == row["episode"][0]
    assert message.step == row["step"][0]
    assert message.reward == row["reward"][0]
    assert message.terminated is True
    assert message.truncated is True
    names = [dimension.name for dimension in spec.observation]
    for field in ("observation", "next_observation"):
        decoded = [getattr(getattr(message, field), name) for name in names]
        np.testing.assert_array_equal(np.float32(decoded), layout.vector(row, field)[0])
    if isinstance(spec.action, DiscreteAction):
        assert message.action == row["action"][0]
    else:
        decoded = [getattr(message.action, dimension.name) for dimension in spec.action.dimensions]
        np.testing.assert_array_equal(np.float32(decoded), layout.vector(row, "action")[0])
    decoded = [getattr(message.exogenous, dimension.name) for dimension in spec.exogenous] if spec.exogenous else []
    vector = layout.vector(row, "exogenous")[0] if spec.exogenous else np.empty(0)
    np.testing.assert_array_equal(np.float32(decoded), vector)
    # With no zeros to leave out, protobuf's own encoding is the same to the byte.
    assert message.SerializeToString() == row.tobytes()


@given(spec=space_specs(max_size=40), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_a_message_in_the_layout_is_what_protobuf_itself_writes(spec, seed):
    assert_protobuf_agrees(spec, np.random.default_rng(seed))


@pytest.mark.parametrize("count", [15, 16, 17, 20, 21, 127, 128, 2047, 2048, 2700, MOST_DIMENSIONS])
def test_tags_and_lengths_of_any_width_are_right(count):
    assert_protobuf_agrees(spec_of(count, actions=max(count // 3, 1)), np.random.default_rng(count))


def test_zeros_are_written_and_decoded():
    file = transition_file(spec_of(3))
    blank = message_layout(file.message_type[0]).blank()
    message = message_class(file, TRANSITION_SCHEMA).FromString(blank.tobytes())
    assert (message.episode, message.observation.observation_2, message.truncated) == (0, 0.0, False)
    assert len(message.SerializeToString()) < len(blank.tobytes())


def test_a_changed_tag_or_length_is_noticed_and_a_changed_value_is_not():
    layout = message_layout(transition_file(spec_of(20)).message_type[0])
    generator = np.random.default_rng(0)
    message = np.frombuffer(filled(layout, generator).tobytes(), np.uint8)
    changed = np.repeat(message[np.newaxis], len(message), axis=0)
    changed[np.arange(len(message)), np.arange(len(message))] ^= 1
    np.testing.assert_array_equal(layout.broken(changed), layout.constant == 255)


def test_an_episode_record_is_what_protobuf_itself_writes():
    layout = message_layout(episode_file().message_type[0])
    row = layout.blank()
    row["episode"], row["seed"], row["return"], row["length"], row["ended"] = 5, -1, -200.5, 200, 2
    message = message_class(episode_file(), EPISODE_SCHEMA).FromString(row.tobytes())
    assert (message.episode, message.seed, getattr(message, "return"), message.length) == (5, -1, -200.5, 200)
    assert message.DESCRIPTOR.fields_by_name["ended"].enum_type.values_by_number[message.ended].name == "TRUNCATED"
    assert message.SerializeToString() == row.tobytes()


def test_names_that_differ_only_in_their_json_form_can_stand_together():
    names = ("x1", "x_1")
    spec = SpaceSpec(tuple(Dimension(name, "", 0.0, 1.0) for name in names), DiscreteAction(("go",)), 1.0)
    message = message_class(transition_file(spec), TRANSITION_SCHEMA)()
    assert set(message.observation.DESCRIPTOR.fields_by_name) == set(names)


@pytest.mark.parametrize(
    ("names", "problem"),
    [
        (("position", "position"), "two dimensions have the same name"),
        (("angle (rad)",), "a dimension is called 'angle \\(rad\\)'"),
        (("1st",), "a dimension is called '1st'"),
        ((), "the observation has 0 dimensions"),
        (tuple(f"pixel_{i}" for i in range(MOST_DIMENSIONS + 1)), "the observation has 10001 dimensions"),
    ],
)
def test_names_that_protobuf_cannot_hold_are_refused(names, problem):
    spec = SpaceSpec(tuple(Dimension(name, "", 0.0, 1.0) for name in names), DiscreteAction(("go",)), 1.0)
    with pytest.raises(SpaceError, match=problem):
        transition_file(spec)


def comments(spec: SpaceSpec) -> dict[str, str]:
    """The comment of every dimension of a sub-message, by the sub-message's name and its own."""
    file = transition_file(spec)
    found = {}
    for location in file.source_code_info.location:
        _, message, _, nested, _, field = location.path
        vector = file.message_type[message].nested_type[nested]
        found[f"{vector.name}.{vector.field[field].name}"] = location.leading_comments.strip()
    return found


@pytest.mark.parametrize("action", [CAR.action, ContinuousAction((Dimension("force", "N", -1.0, 1.0),))])
def test_exogenous_inputs_are_the_last_field_with_their_units_and_only_where_there_are_any(action):
    without, windy = replace(CAR, action=action), replace(WINDY, action=action)
    message = transition_file(windy).message_type[0]
    assert [field.name for field in message.field][-2:] == ["truncated", "exogenous"]
    assert comments(windy) == comments(without) | {"Exogenous.wind": "m/s, -20 to 20"}
    plain = transition_file(without).message_type[0]
    del message.field[-1], message.nested_type[-1]
    assert message == plain


def test_exogenous_inputs_need_names_that_protobuf_can_hold():
    with pytest.raises(SpaceError, match="a dimension is called 'wind speed'"):
        transition_file(replace(CAR, exogenous=(Dimension("wind speed", "m/s", 0.0, 1.0),)))
