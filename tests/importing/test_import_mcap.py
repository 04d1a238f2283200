"""Import of MCAP logs of other programs."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_logs import SECOND, Timed, json_log, protobuf_log, ros2_log, save, source, states_and_commands
from hypothesis import given, settings
from hypothesis import strategies as st

from addressed_dynamics.episodes.transitions import DiscreteAction, Transitions
from addressed_dynamics.importing import import_logs
from addressed_dynamics.sources.transitions.reading import read_transitions


@pytest.fixture(autouse=True)
def _in_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def imported(**changes: Any) -> Transitions:
    import_logs(source(**changes), Path("out"), name="arm", progress=lambda _: None)
    return read_transitions(Path("out"))


def account() -> dict[str, Any]:
    value: dict[str, Any] = json.loads(Path("out/import.json").read_text())
    return value


def on_ticks(messages: list[Timed], count: int, start: int) -> tuple[list[list[float]], list[float]]:
    """Newest position and torque at each of `count` ticks, by a loop."""
    positions, torques = [], []
    for tick in (start + i * SECOND // 10 for i in range(count)):
        before = [each for each in messages if each[1] <= tick]
        positions.append([each[2]["position"] for each in before if each[0] == "/joint_states"][-1])
        torques.append([each[2]["torque"] for each in before if each[0] == "/cmd"][-1])
    return positions, torques


@pytest.mark.parametrize("write", [json_log, protobuf_log, ros2_log])
def test_each_encoding_gives_the_newest_values_at_each_tick(
    tmp_path: Path, write: Callable[[list[Timed]], bytes]
) -> None:
    messages = states_and_commands()
    save(tmp_path, a=write(messages))
    transitions = imported()
    positions, torques = on_ticks(messages, 10, 100 * SECOND + SECOND // 50)
    np.testing.assert_array_equal(transitions.observation, np.array(positions[:-1], dtype=np.float32))
    np.testing.assert_array_equal(transitions.next_observation, np.array(positions[1:], dtype=np.float32))
    np.testing.assert_array_equal(transitions.action[:, 0], np.array(torques[:-1], dtype=np.float32))
    assert transitions.spec.observation_names == ("joint_0", "joint_1")
    assert transitions.spec.observation[0].unit == "rad"
    assert transitions.spec.step_seconds == 0.1
    assert not transitions.reward.any()
    assert transitions.truncated.tolist() == [False] * 8 + [True]


def test_files_of_several_encodings_are_one_recording_with_an_episode_each(tmp_path: Path) -> None:
    messages = states_and_commands()
    save(tmp_path, a=json_log(messages), b=protobuf_log(messages), c=ros2_log(messages))
    transitions = imported()
    assert np.unique(transitions.episode).tolist() == [0, 1_000_000, 2_000_000]
    assert account()["totals"]["transitions"] == len(transitions) == 27
    assert account()["details"]["logs/b.mcap"]["encodings"]["/cmd"] == "protobuf"


def test_the_same_files_make_the_same_bytes(tmp_path: Path) -> None:
    save(tmp_path, a=ros2_log(states_and_commands()))
    for folder in ("one", "two"):
        import_logs(source(), tmp_path / folder, name="arm", progress=lambda _: None)
    for name in ("0000-a.mcap", "import.json"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_a_tick_without_a_fresh_value_is_dropped_and_counted_and_cuts_the_episode(tmp_path: Path) -> None:
    quiet = range(100 * SECOND + SECOND, 100 * SECOND + 2 * SECOND)
    messages = [each for each in states_and_commands(3.0) if each[1] not in quiet]
    save(tmp_path, a=json_log(messages))
    transitions = imported()
    counts, details = account()["files"]["logs/a.mcap"], account()["details"]["logs/a.mcap"]
    assert len(np.unique(transitions.episode)) == 2
    assert counts["late"] == counts["ticks"] - counts["samples"] > 0
    assert details["topics"]["/joint_states"]["late"] > 0
    assert len(transitions) == counts["samples"] - 2


def test_every_message_is_used_held_over_or_counted_as_unused(tmp_path: Path) -> None:
    save(tmp_path, a=json_log(states_and_commands()))
    imported(rate_hz=50.0)
    for counts in account()["details"]["logs/a.mcap"]["topics"].values():
        assert counts["messages"] == counts["used"] + counts["unused"] + counts["not_finite"]
        assert counts["used"] + counts["held"] + counts["late"] == account()["totals"]["ticks"]
        assert counts["held"] > 0


def test_values_that_are_not_finite_or_unset_are_ignored_and_counted(tmp_path: Path) -> None:
    messages = states_and_commands()
    for index, value in ((4, float("nan")), (8, None), (12, 1e300)):
        topic, time, message = [each for each in messages if each[0] == "/joint_states"][index]
        messages[messages.index((topic, time, message))] = (topic, time, message | {"position": [value, 0]})
    save(tmp_path, a=json_log(messages))
    assert len(imported()) == 9
    assert account()["totals"]["not_finite"] == 3


def test_values_outside_the_bounds_are_kept_and_counted(tmp_path: Path) -> None:
    save(tmp_path, a=json_log(states_and_commands()))
    joint = {"field": "/joint_states.position[0:2]", "unit": "rad", "low": 0.5, "high": None}
    assert imported(observation={"joint": joint}).observation.min() < 0.5
    outside = account()["details"]["logs/a.mcap"]["out_of_range"]
    assert outside["observation.joint_0"] > 0
    assert account()["totals"]["out_of_range"] == sum(outside.values())


def test_small_disorder_is_sorted_and_counted(tmp_path: Path) -> None:
    messages = states_and_commands()
    swapped = [*messages[:5], messages[7], messages[5], messages[6], *messages[8:]]
    save(tmp_path, a=json_log(swapped), b=json_log(messages))
    transitions = imported()
    np.testing.assert_array_equal(transitions.observation[:9], transitions.observation[9:])
    assert account()["files"]["logs/a.mcap"]["backwards"] == 1
    assert account()["files"]["logs/b.mcap"]["backwards"] == 0


def test_a_silence_ends_an_episode(tmp_path: Path) -> None:
    quiet = range(100 * SECOND + SECOND, 100 * SECOND + SECOND + SECOND // 4)
    messages = [each for each in states_and_commands(3.0) if each[1] not in quiet or each[0] == "/cmd"]
    save(tmp_path, a=json_log(messages))
    assert len(np.unique(imported(tolerance_s=0.5, episode={"by": "gap", "seconds": 0.5}).episode)) == 1
    assert account()["details"]["logs/a.mcap"]["warnings"] == []
    assert len(np.unique(imported(tolerance_s=0.5, episode={"by": "gap", "seconds": 0.2}).episode)) == 2
    (warning,) = account()["details"]["logs/a.mcap"]["warnings"]
    assert warning.startswith("/joint_states holds for 0.5 s, but a silence of 0.2 s ends an episode")


@pytest.mark.parametrize("labels", [(1, 2, 3), ("walk", "run", "walk")])
def test_an_episode_ends_where_its_topic_changes_however_long_ago_it_spoke(
    tmp_path: Path, labels: tuple[Any, ...]
) -> None:
    marks = [("/episode", 100 * SECOND + i * SECOND, {"id": label}) for i, label in enumerate(labels)]
    messages = sorted(states_and_commands(3.0) + marks, key=lambda each: each[1])
    save(tmp_path, a=json_log(messages))
    transitions = imported(episode={"by": "topic", "field": "/episode.id"})
    assert np.unique(transitions.episode, return_counts=True)[1].tolist() == [9, 9, 9]


def test_short_episodes_are_dropped_and_counted(tmp_path: Path) -> None:
    save(tmp_path, long=json_log(states_and_commands()), short=json_log(states_and_commands(0.3)))
    imported(min_length=5)
    assert account()["totals"]["short"] == 1
    assert account()["details"]["logs/short.mcap"]["log"] is None
    assert account()["files"]["logs/short.mcap"]["dropped"] == account()["files"]["logs/short.mcap"]["samples"]


@pytest.mark.parametrize("modes", [(0, 1, 2), ("left", "none", "right")])
def test_discrete_actions_are_numbers_or_names_and_rewards_are_read(tmp_path: Path, modes: tuple[Any, ...]) -> None:
    messages = [
        (topic, time, {"mode": modes[i % 3], "gain": 0.5} if topic == "/cmd" else message)
        for i, (topic, time, message) in enumerate(states_and_commands())
    ]
    save(tmp_path, a=json_log(messages))
    action = {"discrete": {"field": "/cmd.mode", "names": ["left", "none", "right"]}}
    transitions = imported(action=action, reward="/cmd.gain")
    assert transitions.spec.action == DiscreteAction(("left", "none", "right"))
    assert set(transitions.action.tolist()) <= {0, 1, 2}
    assert transitions.reward.tolist() == [0.5] * 9


@settings(max_examples=20)
@given(data=st.data())
def test_consecutive_samples_are_one_step_apart_whatever_is_lost(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    messages = states_and_commands(2.0)
    kept = data.draw(st.lists(st.booleans(), min_size=len(messages) - 3, max_size=len(messages) - 3))
    folder = save(
        tmp_path_factory.mktemp("lossy"),
        whole=json_log(messages),
        lossy=json_log([*messages[:3], *(each for each, keep in zip(messages[3:], kept, strict=True) if keep)]),
    )
    import_logs(
        source(files=[str(folder / "logs" / "*.mcap")], tolerance_s=0.3),
        folder / "out",
        name="arm",
        progress=lambda _: None,
    )
    transitions = read_transitions(folder / "out")  # checks the contract
    counts = json.loads((folder / "out" / "import.json").read_text())["totals"]
    assert counts["samples"] - counts["dropped"] - counts["episodes"] == len(transitions)
    assert counts["ticks"] == counts["samples"] + counts["late"]


def test_exogenous_inputs_are_held_like_the_command_of_the_same_tick(tmp_path: Path) -> None:
    save(tmp_path, a=json_log(states_and_commands()))
    transitions = imported(exogenous={"load": {"field": "/cmd.torque", "unit": "N m"}})
    np.testing.assert_array_equal(transitions.exogenous, transitions.action)
    assert len(np.unique(transitions.exogenous)) > 5
    assert transitions.spec.exogenous[0].unit == "N m"
