"""What is driven as logs: true transitions that can be trained on, and predictions that nobody takes for them."""

import errno
from pathlib import Path

import numpy as np
import pytest
from driven import CAR_ENVIRONMENT, driven, say, session_of, steps

from addressed_dynamics.base.errors import DriveError, LogError
from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.drive.recorder import DriveRecorder, Recorded, _unused, driven_by_hand
from addressed_dynamics.envs import CONTINUING_MOUNTAIN_CAR, LEARNED, mountain_car_step
from addressed_dynamics.episodes.parquet import load_transitions
from addressed_dynamics.logs import TransitionLogWriter, read_log, recover_log
from addressed_dynamics.sources.transitions.conversion import convert_recording
from addressed_dynamics.sources.transitions.params import ConvertParams

PARAMS = ConvertParams(validation_share=0.2, test_share=0.2)


def recorded(answers: list[dict[str, object]]) -> Path:
    (answer,) = answers
    assert (answer["type"], answer["on"]) == ("recording", False)
    return Path(str(answer["path"]))


def drive_about(folder: Path, world: str = "car", *, alone: bool = False, episodes: int = 12) -> Path:
    """Drive some episodes of twelve steps, all of them recorded."""
    session = session_of(driven(world, environment=None if alone else CAR_ENVIRONMENT), folder)
    assert say(session, "record") == [{"type": "recording", "on": True}]
    for episode in range(episodes):
        say(session, "act", action=episode % 3)
        assert steps(session, 12)[-1]["recorded"] == 12 * (episode + 1)
        say(session, "reset")
    return recorded(say(session, "stop"))


def test_the_truth_is_recorded_and_converted_as_any_log(tmp_path: Path) -> None:
    log = drive_about(tmp_path / "driven")
    assert log.parent == tmp_path / "driven"
    contents = read_log(log)
    found = contents.transitions
    assert (contents.run.environment, contents.run.behaviour) == (CONTINUING_MOUNTAIN_CAR, "driven")
    # The world was reset with 3 when the drive began, and counts up.
    assert [(each.length, each.ended, each.seed) for each in contents.episodes] == [
        (12, "cut", seed) for seed in range(3, 15)
    ]
    np.testing.assert_array_equal(found.action, np.repeat(np.arange(12) % 3, 12))
    np.testing.assert_array_equal(found.step, np.tile(np.arange(12), 12))
    after = mountain_car_step(found.observation.astype(np.float64), found.action)
    np.testing.assert_allclose(found.next_observation, after, atol=1e-7)
    assert set(found.reward.tolist()) == {-1.0}

    convert_recording(
        log.parent, tmp_path / "tables", tmp_path / "reports", PARAMS, cores=1, progress=lambda _count: None
    )
    table = load_transitions(tmp_path / "tables")
    for name in ("observation", "action", "next_observation", "reward", "step"):
        rows = np.argsort(table.episode, kind="stable")
        np.testing.assert_array_equal(getattr(table, name)[rows], getattr(found, name), err_msg=name)


def test_a_model_alone_is_recorded_as_predictions_which_nobody_trains_on_unknowingly(tmp_path: Path) -> None:
    log = drive_about(tmp_path / "driven", alone=True)
    contents = read_log(log)
    assert contents.run.environment == LEARNED
    assert contents.run.kwargs["model"] == "models/car"
    where = tmp_path / "tables", tmp_path / "reports"
    with pytest.raises(LogError, match=r"drive-.*mcap: it was recorded in a learned model.*predictions: true") as error:
        convert_recording(log.parent, *where, PARAMS, cores=1, progress=lambda _count: None)
    assert "\n" not in str(error.value)
    knowingly = PARAMS.model_copy(update={"predictions": True})
    convert_recording(log.parent, *where, knowingly, cores=1, progress=lambda _count: None)
    assert len(load_transitions(tmp_path / "tables")) == len(contents.transitions) == 144


def test_exogenous_inputs_are_recorded_beside_the_actions(tmp_path: Path) -> None:
    session = session_of(driven("boat"), tmp_path)
    say(session, "record")
    winds = [session.reset()["exogenous"][0]]
    winds += [each["exogenous"][0] for each in steps(session, 4)][:3]
    say(session, "exogenous", values=[0.5])
    steps(session, 2)
    found = read_log(recorded(say(session, "stop"))).transitions
    np.testing.assert_allclose(found.exogenous[:, 0], [*winds, 0.5, 0.5], rtol=1e-6)
    np.testing.assert_array_equal(found.observation[1:], found.next_observation[:-1])


def test_a_recording_may_begin_within_an_episode_and_be_of_many_frames(tmp_path: Path) -> None:
    session = session_of(driven("car", 3, CAR_ENVIRONMENT), tmp_path)
    steps(session, 4)
    say(session, "record")
    steps(session, 2)
    say(session, "reset")
    steps(session, 1)
    found = read_log(recorded(say(session, "stop"))).transitions
    # After the reset the truth is idle for two steps, until there are as many frames as the model is given.
    np.testing.assert_array_equal(found.step, [6, 7, 0, 1, 2])
    np.testing.assert_array_equal(found.episode, [0, 0, 1, 1, 1])


def test_an_environment_that_ends_an_episode_ends_it_in_the_log(tmp_path: Path) -> None:
    hill = EnvironmentParams(id="MountainCar-v0")
    session = session_of(driven("car", environment=hill), tmp_path)
    say(session, "record")
    while not (frame := steps(session, 1)[0])["ended"]:
        say(session, "act", action=2 if frame["truth"][1] >= 0 else 0)
    steps(session, 3)
    say(session, "reset")
    steps(session, 2)
    contents = read_log(recorded(say(session, "stop")))
    assert [each.ended for each in contents.episodes] == ["terminated", "cut"]
    assert contents.episodes[0].length == frame["step"] == len(contents.transitions) - 2
    assert contents.transitions.next_observation[frame["step"] - 1, 0] >= 0.5


def test_no_recording_takes_the_place_of_another(tmp_path: Path) -> None:
    session = session_of(driven("car", environment=CAR_ENVIRONMENT), tmp_path)
    logs = []
    for _ in range(3):
        say(session, "record")
        steps(session, 1)
        logs.append(recorded(say(session, "stop")))
    assert len({*logs}) == 3
    assert sorted(tmp_path.iterdir()) == sorted(logs)
    unfinished = tmp_path / f"{_stem(tmp_path)}.mcap.partial"
    unfinished.write_bytes(b"what someone may yet recover")
    say(session, "record")
    steps(session, 1)
    say(session, "stop")
    assert unfinished.read_bytes() == b"what someone may yet recover"


def test_what_was_not_driven_makes_no_log(tmp_path: Path) -> None:
    session = session_of(driven("car", environment=CAR_ENVIRONMENT), tmp_path / "none")
    say(session, "record")
    assert say(session, "record")[0]["message"] == "this drive is recorded already; stop that first"
    assert say(session, "stop") == [{"type": "recording", "on": False, "path": None, "count": 0}]
    assert not (tmp_path / "none").exists()


def test_who_leaves_leaves_a_complete_log(tmp_path: Path) -> None:
    session = session_of(driven("car", environment=CAR_ENVIRONMENT), tmp_path)
    say(session, "record")
    steps(session, 5)
    log = session.close()
    assert log is not None
    assert len(read_log(log).transitions) == 5
    assert session.close() is None


def test_a_disk_that_is_full_is_told_and_the_drive_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = session_of(driven("car", environment=CAR_ENVIRONMENT), tmp_path)

    def refuse(*_arguments: object, **_options: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "mkdir", refuse)
    say(session, "record")
    refusal, ended, frame = session.tick()
    assert "recording ended: [Errno 28] No space left on device" in refusal["message"]
    assert (ended, frame["step"]) == ({"type": "recording", "on": False}, 1)
    assert [each["type"] for each in session.tick()] == ["frame"]
    assert session.close() is None


def test_a_log_that_cannot_be_completed_is_told_with_what_saves_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = session_of(driven("car", environment=CAR_ENVIRONMENT), tmp_path)
    say(session, "record")
    steps(session, 3)
    say(session, "reset")
    steps(session, 2)

    def refuse(*_arguments: object) -> None:
        raise LogError("the disk is full")

    monkeypatch.setattr(TransitionLogWriter, "close", refuse)
    refusal, ended = say(session, "stop")
    assert "recording ended: the disk is full; 'addressed-dynamics recover" in refusal["message"]
    assert "saves 5 transitions" in refusal["message"]
    assert ended == {"type": "recording", "on": False}
    (unfinished,) = tmp_path.iterdir()
    assert unfinished.name.endswith(".mcap.partial")
    assert recover_log(unfinished, tmp_path / "saved.mcap").transitions == 5


def test_numbers_that_are_none_end_a_recording(tmp_path: Path) -> None:
    session = session_of(driven("car", environment=CAR_ENVIRONMENT), tmp_path)
    recorder = DriveRecorder(tmp_path, session.recorder._spaces)
    recorder.start(driven_by_hand("Some-v0", {}))
    state = np.float32([0, 0])
    with pytest.raises(DriveError, match="recording ended: a number in this step is not finite"):
        recorder.add(Recorded(0, state, 0, 0.0, np.float32([np.nan, 0])))
    assert not recorder.recording


def _stem(folder: Path) -> str:
    """Return the name that a recording would have that began now, and a second later."""
    return _unused(folder, driven_by_hand("Some-v0", {})).stem
