"""What is found in logs that nobody described, and which section `source` is proposed for them."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from bags import encoded, write_bag
from foreign_logs import SECOND, json_log, protobuf_log, ros2_log, source, states_and_commands
from lerobot_data import frames, write_v3
from rosbags.rosbag2 import StoragePlugin

from addressed_dynamics.base.errors import LogError, ParamsError, TableError
from addressed_dynamics.cli.new import source_params
from addressed_dynamics.importing import import_logs
from addressed_dynamics.importing.assessing import assess
from addressed_dynamics.importing.finding import find_logs
from addressed_dynamics.importing.looking import MOST_VALUES, Look
from addressed_dynamics.importing.looking_at import look_at
from addressed_dynamics.importing.proposing import Proposal, Wishes, propose
from addressed_dynamics.reporting.transitions.quality import COUNTERS
from addressed_dynamics.sources.transitions.reading import read_transitions


@pytest.fixture(autouse=True)
def _in_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def looked(**files: bytes) -> Look:
    for name, data in files.items():
        Path(f"{name}.mcap").write_bytes(data)
    return look_at(find_logs([Path()]))


def proposed(look: Look, **wishes: Any) -> Proposal:
    return propose(look, ["*.mcap"], Wishes(**wishes))


def robot(seconds: int = 10) -> bytes:
    """A robot that says more than its state: labels, counters, an image, a goal, and times of its own."""
    messages: list[Any] = [("/goal", 1, {"x": 3.0})]
    for i in range(seconds * 20):
        at = SECOND + i * SECOND // 20
        stamp = {"header": {"stamp": {"sec": 1, "nanosec": i * SECOND // 20 - SECOND // 100 if i else 0}}}
        values = {
            "name": ["elbow", "shoulder"],
            "position": [i % 7, -i % 5],
            "seq": i,
            "mode": ["run", "walk"][i % 2],
        }
        messages.append(("/arm/state", at, {**stamp, **values, "image": [0] * 100, "fixed": 1.5}))
        if i % 4 == 0:
            messages.append(("/arm/cmd_torque", at + 1, {"data": i % 3}))
    return json_log(messages)


def test_fields_have_names_rates_ranges_and_texts() -> None:
    look = looked(a=robot())
    found = {each.field: each for each in look.fields}
    assert list(found) == [
        "/goal.x",
        "/arm/state.position[elbow]",
        "/arm/state.position[shoulder]",
        "/arm/state.seq",
        "/arm/state.mode",
        "/arm/state.fixed",
        "/arm/cmd_torque.data",
    ]
    elbow = found["/arm/state.position[elbow]"]
    assert (elbow.range, elbow.total, elbow.constant) == ((0.0, 6.0), 200, False)
    assert elbow.rate_hz == pytest.approx(20)
    assert found["/arm/cmd_torque.data"].rate_hz == pytest.approx(5)
    assert set(found["/arm/state.mode"].texts) == {"walk", "run"}
    assert found["/arm/state.fixed"].constant
    (stamps,) = look.stamps
    assert stamps.topic == "/arm/state"
    assert stamps.median_s == pytest.approx(0.01, abs=1e-6)


def test_of_many_messages_some_are_looked_at_from_beginning_to_end() -> None:
    count = 5 * MOST_VALUES
    log = json_log([("/s", SECOND + i * SECOND // 100, {"x": i}) for i in range(count)])
    (field,) = looked(a=log).fields
    assert field.total == count
    assert MOST_VALUES / 2 <= len(field.values) <= 2 * MOST_VALUES
    assert field.range is not None
    assert field.range[0] == 0
    assert field.range[1] > 0.95 * count
    assert field.rate_hz == pytest.approx(100)


@pytest.mark.parametrize("write", [json_log, protobuf_log, ros2_log])
def test_every_encoding_gives_the_same_fields(write: Any) -> None:
    look = looked(a=write(states_and_commands()))
    numbers = [each for each in look.fields if each.is_number]
    assert [each.field for each in numbers] == [
        "/joint_states.position[0]", "/joint_states.position[1]", "/cmd.torque",
    ]  # fmt: skip


def test_a_topic_that_cannot_be_read_does_not_keep_the_others_away() -> None:
    messages = [*states_and_commands(), ("/broken", 200 * SECOND, b"{")]
    look = looked(a=json_log(messages))
    assert "/broken" in look.unread
    assert len(look.fields) == 4


def test_a_proposal_is_imported_as_it_is_with_what_was_guessed_said() -> None:
    look = looked(a=robot())
    proposal = proposed(look)
    assert proposal.unknown == ()
    assert set(proposal.source["observation"]) == {"elbow", "shoulder"}
    assert proposal.source["action"] == {"continuous": {"cmd_torque": {"field": "/arm/cmd_torque.data"}}}
    assert (proposal.source["rate_hz"], proposal.source["tolerance_s"]) == (5.0, 0.075)
    assert proposal.source["topics"] == {"/arm/cmd_torque": {"tolerance_s": 0.3}}
    assert [line.split(":")[0] for line in proposal.guessed] == ["action", "observation", "rate", "episodes"]
    assert proposal.notes["elbow"] == "0 to 6, 20 Hz"
    section = source_params(proposal.source)
    import_logs(section, Path("out"), name="arm", progress=lambda _: None)
    assert len(read_transitions(Path("out"))) == assess(section).transitions == 49


def test_what_is_wished_for_is_taken_and_named() -> None:
    look = looked(a=robot())
    wishes = {"observation": ("q=/arm/state.position", "/arm/state.fixed"), "action": ("push=/arm/cmd_torque.data",)}
    proposal = proposed(look, **wishes, exogenous=("/goal.x",), rate_hz=20.0, episode="reset")
    assert list(proposal.source["observation"]) == ["q_0", "q_1", "fixed"]
    assert list(proposal.source["action"]["continuous"]) == ["push"]
    assert proposal.source["exogenous"] == {"goal_x": {"field": "/goal.x"}}
    assert proposal.source["topics"]["/goal"] == {"hold": True}
    assert (proposal.source["rate_hz"], proposal.source["episode"]) == (20.0, {"by": "reset"})
    assert proposal.guessed == ()
    assert source_params(proposal.source).rate_hz == 20.0


def test_an_action_of_words_is_discrete() -> None:
    messages = states_and_commands(2.0)
    log = [(topic, at, {"command": "go" if i % 3 else "stop"} if topic == "/cmd" else message)
           for i, (topic, at, message) in enumerate(messages)]  # fmt: skip
    proposal = proposed(looked(a=json_log(log)))
    assert proposal.source["action"] == {"discrete": {"field": "/cmd.command", "names": ["go", "stop"]}}


def test_what_files_do_not_say_is_unknown() -> None:
    log = json_log([("/s", SECOND + i, {f"x{k}": i * i * (k + 1) % 11 for k in range(30)}) for i in range(5)])
    assert proposed(looked(a=log)).unknown == ("action", "observation", "rate")


def test_a_wish_for_what_is_not_there_is_answered_with_what_is() -> None:
    with pytest.raises(ParamsError, match=r"there is no field '/arm/state.velocity'; the fields are: /goal.x"):
        proposed(looked(a=robot()), observation=("/arm/state.velocity",))


def test_files_are_found_in_folders_and_named_with_patterns(tmp_path: Path) -> None:
    for name in ("bags/a.mcap", "bags/deep/b.mcap", "flat/c.mcap", "flat/notes.txt", "tables/a.csv", "mixed/x.csv"):
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "mixed/y.parquet").write_bytes(b"")
    found = find_logs([Path("bags")])
    assert (found.kind, found.patterns, found.dependency) == ("mcap", ("bags/**/*.mcap",), "bags")
    assert [file.name for file in found.files] == ["a.mcap", "b.mcap"]
    assert find_logs([tmp_path / "flat"]).patterns == ("flat/*.mcap",)
    both = find_logs([Path("bags/a.mcap"), Path("flat/c.mcap")])
    assert (both.patterns, both.dependency) == (("bags/a.mcap", "flat/c.mcap"), ".")
    assert find_logs([Path("tables")]).kind == "csv"
    for paths, what in (
        (["nowhere"], "there is no such file or folder"),
        (["flat/notes.txt"], "expected logs or tables"),
        (["mixed"], "expected files of one kind, but there are 1 of kind csv, 1 of kind parquet"),
    ):
        with pytest.raises(LogError, match=what):
            find_logs([Path(each) for each in paths])


def test_an_assessment_is_plain_json() -> None:
    assessment = assess(source_params(proposed(looked(a=robot())).source))
    found = json.loads(json.dumps(assessment.to_json()))
    assert [each["verdict"] for each in found["episodes"]] == ["use"]
    assert found["counts"]["messages"] == 250


def written(name: str, text: str) -> Proposal:
    Path(name).write_text(text)
    found = find_logs([Path(name)])
    return propose(look_at(found), found.patterns, Wishes(observation=("q",), action=("u",)))


@pytest.mark.parametrize(
    ("header", "row", "expected"),
    [
        ("t,q,u", lambda i: f"{i / 20},{i % 7},{i % 3}", {"clock": {"column": "t"}, "rate_hz": 20.0}),
        ("t [ms],q,u", lambda i: f"{50 * i},{i % 7},{i % 3}", {"clock": {"column": "t [ms]", "unit": "ms"}}),
        ("time;q;u", lambda i: f"{i / 20};{i % 7},5;{i % 3}".replace(".", ","), {"separator": ";", "decimal": ","}),
        ("timestamp\tq\tu", lambda i: f"{1_700_000_000_000_000_000 + i * 50_000_000}\t{i % 7}\t{i % 3}",
         {"clock": {"column": "timestamp", "unit": "ns"}, "separator": "\t", "rate_hz": 20.0}),
        ("# by somebody\nframe,q,u,episode", lambda i: f"{i % 30},{i % 7},{i % 3},{i // 30}",
         {"comment": "#", "clock": {"frame": "frame"}, "episode": {"by": "column", "column": "episode"}}),
        ("date,q,u,done,reward", lambda i: f"2026-01-01T00:00:{i % 60:02}.{i // 60}00,{i % 7},{i % 3},{i % 20 == 19},1",
         {"reward": "reward", "terminated": "done", "episode": {"by": "end"}}),
    ],
)  # fmt: skip
def test_how_a_table_is_written_is_found_out(header: str, row: Any, expected: dict[str, Any]) -> None:
    proposal = written("a.csv", "\n".join([header, *(row(i) for i in range(60))]) + "\n")
    assert {key: proposal.source.get(key) for key in expected} == expected
    if proposal.unknown:
        assert proposal.unknown == ("rate",)
        proposal.source["rate_hz"] = 20.0
    assert assess(source_params(proposal.source)).transitions > 50


@pytest.mark.parametrize("cell", ["1.5", ""])
def test_where_no_state_moves_it_has_to_be_said(cell: str) -> None:
    Path("a.csv").write_text("t,q,torque\n" + "".join(f"{i / 10},{cell},{i % 3}\n" for i in range(40)))
    found = find_logs([Path("a.csv")])
    assert propose(look_at(found), found.patterns, Wishes()).unknown == ("observation",)


def test_a_table_whose_names_are_in_another_encoding_is_refused() -> None:
    Path("a.csv").write_bytes("t,q °,torque\n0,1,2\n1,2,3\n".encode("latin-1"))
    with pytest.raises(TableError, match=r"the name 'q .' is not in UTF-8\); save it in UTF-8"):
        look_at(find_logs([Path("a.csv")]))


def test_units_in_the_names_of_columns_are_taken() -> None:
    Path("a.csv").write_text("t,angle [rad],torque (N m)\n" + "".join(f"{i / 10},{i % 7},{i % 3}\n" for i in range(40)))
    found = find_logs([Path("a.csv")])
    proposal = propose(look_at(found), found.patterns, Wishes())
    assert proposal.source["observation"] == {"angle": {"field": "angle [rad]", "unit": "rad"}}
    assert proposal.source["action"]["continuous"] == {"torque": {"field": "torque (N m)", "unit": "N m"}}
    assert assess(source_params(proposal.source)).transitions == 39


def test_structures_and_vectors_in_tables_are_fields() -> None:
    rows = [{"s": {"x": i % 5, "v": [i, -i]}, "action": [i % 3, 1], "image": [0] * 100, "t": i / 10} for i in range(40)]
    polars.DataFrame(rows).write_parquet("a.parquet")
    found = find_logs([Path("a.parquet")])
    look = look_at(found)
    assert [each.field for each in look.fields] == ["s.x", "s.v[0]", "s.v[1]", "action[0]", "action[1]"]
    proposal = propose(look, found.patterns, Wishes(observation=("s",)))
    assert [each["field"] for each in proposal.source["observation"].values()] == ["s.x", "s.v[0]", "s.v[1]"]
    assert assess(source_params(proposal.source)).transitions == 39


def test_a_lerobot_dataset_is_known_by_its_folder(tmp_path: Path) -> None:
    write_v3(tmp_path / "so101", frames(4, 30), 70)
    found = find_logs([tmp_path / "so101"])
    proposal = propose(look_at(found), found.patterns, Wishes())
    assert (found.kind, proposal.source["folder"], proposal.unknown) == ("lerobot", "so101", ())
    assert list(proposal.source["observation"]) == ["shoulder_pan_pos", "gripper_pos"]
    assert assess(source_params(proposal.source)).transitions > 0


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
@pytest.mark.parametrize("inside", ["run_1", "bags/run_1"])
def test_bags_are_found_by_their_metadata(storage: StoragePlugin, inside: str) -> None:
    Path(inside).parent.mkdir(exist_ok=True)
    write_bag(Path(inside), encoded(states_and_commands(10.0)), storage)
    found = find_logs([Path(inside.split("/")[0])])
    assert (found.kind, found.patterns) == ("mcap", ("run_1",) if inside == "run_1" else ("bags/**/metadata.yaml",))
    proposal = propose(look_at(found), found.patterns, Wishes())
    assert proposal.unknown == ()
    assert assess(source_params(proposal.source)).transitions > 90


def test_all_names_that_several_programs_write_are_shown_and_fields_that_never_come_together_are_refused() -> None:
    messages: list[Any] = []
    for i in range(80):
        own = "a" if i % 2 else "b"
        messages.append(("/j", SECOND + i * SECOND // 40, {"name": [own], "position": [i % 7 + 10 * (i % 2)]}))
        messages.append(("/cmd", SECOND + i * SECOND // 40, {"data": i % 3}))
    look = looked(a=json_log(messages))
    ranges = {each.field: each.range for each in look.fields}
    assert ranges["/j.position[b]"] == (0.0, 6.0)
    assert ranges["/j.position[a]"] == (10.0, 16.0)
    proposal = proposed(look, observation=("/j.position",))
    with pytest.raises(LogError, match="several programs seem to write to the topic: take the fields of one of them"):
        assess(source_params(proposal.source))
    alone = proposed(look, observation=("/j.position[a]",))
    assert assess(source_params(alone.source)).transitions > 20


def test_tables_without_a_state_are_no_reason_to_fail() -> None:
    polars.DataFrame({"t": [i / 20 for i in range(60)], "u": [i % 3 for i in range(60)], "n": range(60)}).write_csv(
        "a.csv"
    )
    proposal = propose(look_at(find_logs([Path("a.csv")])), ["a.csv"], Wishes())
    assert proposal.unknown == ("observation",)
    assert proposal.source["rate_hz"] == 20.0
    assert "clock: t in s, for its name; gaps end episodes" in proposal.guessed


def test_values_that_float32_cannot_tell_apart_get_an_offset() -> None:
    index = np.arange(400)
    north = 5_301_234.0 + 0.01 * (index * index % 97)
    polars.DataFrame({"north": north, "small": np.sin(index), "u": index % 3}).write_csv("a.csv")
    proposal = propose(look_at(find_logs([Path("a.csv")])), ["a.csv"], Wishes(rate_hz=20.0))
    assert proposal.source["observation"] == {
        "north": {"field": "north", "offset": 5301234.0},
        "small": {"field": "small"},
    }
    assert "offset of north: 5301234, without which float32 cannot hold its steps" in proposal.guessed
    assert assess(source_params(proposal.source)).warnings == ()


def test_what_an_import_would_refuse_or_count_is_told_before_it() -> None:
    index = np.arange(400)
    polars.DataFrame({"q": 5_301_234.0 + 0.01 * index, "u": index % 3}).write_csv("a.csv")
    section = {"kind": "csv", "files": "a.csv", "observation": {"q": {"field": "q", "high": 5_301_235.0}},
               "action": {"continuous": {"u": {"field": "u"}}}, "reward": None, "rate_hz": 20.0,
               "episode": {"by": "file"}, "min_length": 20}  # fmt: skip
    assessment = assess(source_params(section))
    assert (assessment.counts["swallowed"], assessment.counts["out_of_range"]) == (391, 299)
    (warning,) = assessment.warnings
    assert warning.startswith("a.csv: float32 cannot hold 'observation.q'")


def test_the_rate_of_jittering_messages_is_the_one_they_were_sent_at() -> None:
    rng = np.random.default_rng(1)
    times = (100 + (np.arange(400) + rng.uniform(-0.3, 0.3, 400)) / 20) * SECOND
    messages = [("/q", int(at), {"x": i % 7}) for i, at in enumerate(times)]
    (found,) = looked(a=json_log(messages)).fields
    assert found.rate_hz == pytest.approx(20.0, rel=2e-3)


@pytest.mark.parametrize(
    ("field", "name"), [("größe [m]", "groe"), ("température", "temperature"), ("高さ", "field"), ("2nd", "x_2nd")]
)
def test_dimensions_have_names_that_a_log_can_hold_whatever_the_fields_are_called(field: str, name: str) -> None:
    polars.DataFrame({field: [i * i % 7 for i in range(60)], "u": [i % 3 for i in range(60)]}).write_csv("a.csv")
    proposal = propose(look_at(find_logs([Path("a.csv")])), ["a.csv"], Wishes(rate_hz=20.0))
    assert list(proposal.source["observation"]) == [name]
    assert assess(source_params(proposal.source)).transitions == 59


def test_what_cannot_be_an_action_or_a_name_is_refused_in_a_line() -> None:
    table = {"q": [i * i % 7 for i in range(60)], "u": [i % 3 for i in range(60)]}
    words = {"few": ["go" if i % 3 else "stop" for i in range(60)], "many": [f"w{i % 13}" for i in range(60)]}
    polars.DataFrame(table | words).write_csv("a.csv")
    look = look_at(find_logs([Path("a.csv")]))
    for wishes, what in (
        ({"action": ("few", "u")}, "but one of words, such as 'few', has no other one beside it"),
        ({"action": ("many",)}, "'many' has more than 12 different texts"),
        ({"observation": ("größe=q",)}, "'größe' cannot be the name of a dimension; give letters, digits and _"),
    ):
        with pytest.raises(ParamsError, match=re.escape(what)):
            propose(look, ["a.csv"], Wishes(rate_hz=20.0, **wishes))


def test_categories_are_texts() -> None:
    words = polars.Series(["go" if i % 3 else "stop" for i in range(60)]).cast(polars.Categorical)
    polars.DataFrame({"q": [i * i % 7 for i in range(60)], "command": words}).write_parquet("a.parquet")
    proposal = propose(look_at(find_logs([Path("a.parquet")])), ["a.parquet"], Wishes(rate_hz=20.0))
    assert proposal.source["action"] == {"discrete": {"field": "command", "names": ["go", "stop"]}}
    assert assess(source_params(proposal.source)).transitions == 59


def test_the_report_explains_the_counters_of_logs_and_of_tables() -> None:
    Path("a.mcap").write_bytes(json_log(states_and_commands()))
    Path("a.csv").write_text("t,q,u\n" + "".join(f"{i / 10},{i * i % 7},{i % 3}\n" for i in range(20)))
    table = {"kind": "csv", "observation": {"q": {"field": "q"}}, "action": {"continuous": {"u": {"field": "u"}}},
             "tolerance_s": ..., "clock": {"column": "t"}}  # fmt: skip
    counted = dict[str, int]()
    for changes in (
        {"files": "a.mcap", "episode": {"by": "reset"}},
        {"files": "a.csv", "episode": {"by": "file"}} | table,
    ):
        counted |= assess(source(**changes)).counts
    assert (
        {"reordered", "joined_files", "incomplete_parts", "repeated", "off_rate"} <= counted.keys() <= COUNTERS.keys()
    )


def test_a_state_does_not_hold_through_the_pauses_between_episodes_but_a_command_does() -> None:
    messages: list[Any] = []
    for i in range(15 * 30):
        at = SECOND * (100 + 10 * (i // 30)) + i % 30 * SECOND // 10
        messages.append(("/q", at, {"x": i * i % 7}))
        if i % 30 < 20 and i % 4 == 0:
            messages.append(("/cmd", at, {"data": i % 3}))
    proposal = proposed(looked(a=json_log(messages)))
    assert proposal.source["tolerance_s"] == 0.15
    assert proposal.source["topics"]["/cmd"]["tolerance_s"] > 1.0
    assessment = assess(source_params(proposal.source | {"rate_hz": 10.0}))
    assert len(assessment.episodes) == 15
    assert max(each.samples for each in assessment.episodes) <= 31
