"""Recording plans: what is recorded, under which names and numbers, and that the same plan records the same."""

import json
import random
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from builders import assert_same
from example_params import EXAMPLE

from addressed_dynamics.base.errors import RecordingError
from addressed_dynamics.base.params.recording import EnvironmentParams, RecordParams
from addressed_dynamics.logs import read_log
from addressed_dynamics.recording.environments import make_environment
from addressed_dynamics.recording.plan import first_episode, record_plan, recording_folder
from addressed_dynamics.sources.transitions.reading import read_transitions


def plan(**changes: Any) -> RecordParams:
    """Return the example's plan, each segment with these changes."""
    record = EXAMPLE["record"]
    segments = [segment | changes for segment in record["segments"]]
    return RecordParams.model_validate_json(json.dumps(record | {"segments": segments}))


def plan_of(behaviour: dict[str, Any], **changes: Any) -> RecordParams:
    """Return a plan with one segment called `only`."""
    segment = EXAMPLE["record"]["segments"][0] | {"name": "only", "behaviour": behaviour} | changes
    return RecordParams.model_validate_json(json.dumps({"shard_transitions": 10_000, "segments": [segment]}))


def record(folder: Path, params: RecordParams) -> Path:
    record_plan(params, folder, progress=lambda _: None)
    return folder


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("recording"), plan())


def test_every_segment_has_exactly_its_transitions_shared_equally_by_its_copies(recording: Path) -> None:
    for segment in plan().segments:
        for copy in range(segment.environments):
            logs = sorted(recording.glob(f"{segment.name}-env{copy:02d}-*.mcap"))
            assert sum(len(read_log(log).transitions) for log in logs) == segment.transitions // segment.environments


def test_logs_roll_at_the_end_of_the_episode_that_fills_them_and_nothing_else_is_left(recording: Path) -> None:
    # Episodes last 200 steps, logs are full after 150: one log for each episode.
    names = sorted(path.name for path in recording.iterdir())
    copies = [f"{segment}-env{copy:02d}" for segment in ("late", "learner", "random", "right") for copy in range(2)]
    assert names == [f"{copy}-000.mcap" for copy in copies]


def test_numbers_of_episodes_differ_over_the_whole_recording(recording: Path) -> None:
    whole = read_transitions(recording)
    assert len(set(whole.episode.tolist())) == 4 * 2
    assert first_episode(2, 1) in set(whole.episode.tolist())


def test_a_log_says_who_acted_where(recording: Path) -> None:
    contents = read_log(recording / "right-env01-000.mcap")
    run = contents.run
    assert (run.segment, run.behaviour, run.environment, run.seed) == ("right", "constant", "MountainCar-v0", 0)
    assert "gymnasium" in run.versions
    assert contents.episodes[0].seed == 1
    assert set(contents.transitions.action.tolist()) == {2}


def test_the_same_plan_records_the_same_transitions(recording: Path, tmp_path: Path) -> None:
    assert_same(read_transitions(record(tmp_path, plan())), read_transitions(recording))


def test_another_seed_records_other_transitions(recording: Path, tmp_path: Path) -> None:
    other = read_transitions(record(tmp_path, plan(seed=5))).observation
    assert (other != read_transitions(recording).observation).any()


def global_generators() -> tuple[object, ...]:
    """The states of Python's, NumPy's and PyTorch's."""
    numpy_state = np.random.get_state()[1].tolist()  # noqa: NPY002 - what is asked about is the old generator
    return random.getstate(), numpy_state, torch.get_rng_state().tolist()


def test_recording_leaves_the_global_generators_and_threads_alone(tmp_path: Path) -> None:
    before = global_generators()
    threads = torch.get_num_threads()
    record(tmp_path, plan())
    assert global_generators() == before
    assert torch.get_num_threads() == threads


def test_progress_counts_every_transition_of_the_plan(tmp_path: Path) -> None:
    counts: list[int] = []
    record_plan(plan(), tmp_path, progress=counts.append)
    assert sum(counts) == sum(segment.transitions for segment in plan().segments)


def test_a_learner_stops_at_its_last_transition_inside_a_round_of_training(tmp_path: Path) -> None:
    params = plan_of(EXAMPLE["record"]["segments"][0]["behaviour"] | {"train_every": 7}, transitions=306)
    assert len(read_transitions(record(tmp_path, params))) == 306


def test_the_continuing_environment_is_known_and_takes_arguments(tmp_path: Path) -> None:
    environment = {
        "id": "addressed_dynamics/MountainCarContinuing-v0",
        "kwargs": {"max_episode_steps": 50, "start_position": [0.5, 0.5], "start_velocity": [0.02, 0.02]},
    }
    params = plan_of({"kind": "constant", "action": 2}, environment=environment, transitions=200)
    whole = read_transitions(record(tmp_path, params))
    assert whole.observation[:, 0].max() == np.float32(0.6)
    assert not whole.terminated.any()
    assert np.bincount(whole.step)[49] == 4


def frame_skipping_plan(seed: int = 0) -> RecordParams:
    """Return a plan of a learner that holds actions for 4 steps in episodes of up to 45, and of one that follows it."""
    environment = {"id": "addressed_dynamics/Acrobot-v0", "kwargs": {"max_episode_steps": 45, "start_angle": [-3, 3]}}
    learner = EXAMPLE["record"]["segments"][0]
    learning = learner["behaviour"] | {"frame_skip": 4, "reward_scale": 0.25, "train_every": 3, "learning_starts": 20}
    segments = [
        learner | {"name": "learner", "behaviour": learning, "environment": environment, "seed": seed},
        learner
        | {"name": "late", "behaviour": {"kind": "greedy", "segment": "learner", "epsilon": 0.9}}
        | {"environment": environment, "seed": seed},
    ]
    return RecordParams.model_validate_json(json.dumps({"shard_transitions": 10_000, "segments": segments}))


def test_every_step_is_recorded_where_a_learner_and_who_follows_it_hold_their_actions(tmp_path: Path) -> None:
    record(tmp_path, frame_skipping_plan())
    logs = sorted(tmp_path.iterdir())
    assert [log.name.split("-")[0] for log in logs] == ["late"] * 2 + ["learner"] * 2
    for log in logs:
        transitions = read_log(log).transitions
        assert len(transitions) == 200
        assert transitions.reward.max() <= 0.0
        assert transitions.reward.min() == -1.0
        lengths = []
        for rows in transitions.episode_slices():
            observation, action = transitions.observation[rows], transitions.action[rows]
            np.testing.assert_array_equal(observation[1:], transitions.next_observation[rows][:-1])
            assert set(np.flatnonzero(np.diff(action)) % 4) <= {3}
            lengths.append(len(action))
        assert any(length % 4 for length in lengths[:-1]), "an episode should end inside a decision"
        assert len(set(transitions.action.tolist())) > 1


def test_a_plan_with_held_actions_records_the_same_again(tmp_path: Path) -> None:
    first, again, other = (
        read_transitions(record(tmp_path / name, frame_skipping_plan(seed)))
        for name, seed in (("first", 0), ("again", 0), ("other", 1))
    )
    assert_same(first, again)
    assert (first.action != other.action).any()


@pytest.mark.parametrize(
    ("behaviour", "environment", "what"),
    [
        ({"kind": "random", "mean_hold_steps": 1}, {"id": "NoCar-v0", "kwargs": {}}, "'NoCar-v0' cannot be made"),
        (
            {"kind": "random", "mean_hold_steps": 1},
            {"id": "MountainCar-v0", "kwargs": {"wings": 2}},
            "'MountainCar-v0' cannot be made with {'wings': 2}: .*unexpected keyword argument",
        ),
        ({"kind": "constant", "action": 3}, {"id": "MountainCar-v0", "kwargs": {}}, "expected a constant action in"),
        (
            EXAMPLE["record"]["segments"][0]["behaviour"],
            {"id": "MountainCarContinuous-v0", "kwargs": {}},
            "a dqn needs discrete actions",
        ),
    ],
)
def test_a_segment_that_cannot_be_carried_out_is_one_clear_line(
    tmp_path: Path, behaviour: dict[str, Any], environment: dict[str, Any], what: str
) -> None:
    with pytest.raises(RecordingError, match=what) as caught:
        record(tmp_path, plan_of(behaviour, environment=environment))
    assert "\n" not in str(caught.value)


def test_too_many_copies_for_the_numbering_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="at most 1000 environments"):
        record(tmp_path, plan_of({"kind": "constant", "action": 0}, environments=1001, transitions=1001))


def test_a_recording_appears_whole_and_replaces_the_one_before(tmp_path: Path) -> None:
    target = tmp_path / "car"
    for text in ("old", "new"):
        with recording_folder(target) as folder:
            (folder / f"{text}.mcap").write_text(text)
            assert not (target / f"{text}.mcap").exists()
    assert [path.name for path in target.iterdir()] == ["new.mcap"]
    assert list(tmp_path.iterdir()) == [target]


def test_a_recording_that_fails_before_its_first_log_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(RecordingError) as caught, recording_folder(tmp_path / "car"):
        raise RecordingError("no such environment")
    assert not hasattr(caught.value, "__notes__")
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_recording_stays_aside_until_the_next_one(tmp_path: Path) -> None:
    target = tmp_path / "car"

    def interrupted() -> None:
        with recording_folder(target) as folder:
            (folder / "some.mcap.partial").write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        interrupted()
    assert not target.exists()
    assert "addressed-dynamics recover" in caught.value.__notes__[0]
    assert [path.name for path in (tmp_path / ".car.partial").iterdir()] == ["some.mcap.partial"]
    with recording_folder(target):
        pass
    assert list(tmp_path.iterdir()) == [target]


def test_two_recordings_for_one_target_do_not_mix(tmp_path: Path) -> None:
    target = tmp_path / "car"
    with recording_folder(target) as folder:
        (folder / "first.mcap").write_text("first")
        # As a stage that goes on when only DVC was killed, and the next 'dvc repro'.
        with pytest.raises(RecordingError, match=r"\.car\.partial: another process is recording"):
            recording_folder(target).__enter__()
    assert [path.name for path in target.iterdir()] == ["first.mcap"]
    assert list(tmp_path.iterdir()) == [target]


def test_the_clock_of_a_copy_goes_on_from_log_to_log(tmp_path: Path) -> None:
    environment = {"id": "MountainCar-v0", "kwargs": {"max_episode_steps": 50}}
    params = plan_of({"kind": "constant", "action": 2}, environment=environment, environments=1, transitions=200)
    record(tmp_path, params.model_copy(update={"shard_transitions": 60}))
    logs = sorted(tmp_path.iterdir())
    times = [read_log(log).transitions.time_ns for log in logs]
    assert [len(part) for part in times] == [100, 100]
    np.testing.assert_array_equal(np.concatenate(times), np.round(np.arange(200) * 1e9 / 30))


def test_a_gait_is_recorded_and_every_episode_begins_it_anew(tmp_path: Path) -> None:
    # A spring as weak as this holds nothing: what is recorded is the sine, from its beginning in every episode.
    joint = {"angle": "cos_angle", "velocity": "angular_velocity", "centre": 1e9, "swing": 1e9}
    behaviour = {
        "kind": "gait",
        "joints": {"arm": joint},
        "period_steps": 50,
        "stiffness": 1e-9,
        "mean_gait_steps": 1e9,
    }
    pendulum = {"id": "Pendulum-v1", "kwargs": {"max_episode_steps": 30}}
    params = plan_of(behaviour, environment=pendulum, transitions=120)
    actions = read_transitions(record(tmp_path, params)).action.reshape(4, 30)
    wanted = 1 + np.sin(2 * np.pi * np.arange(30) / 50)
    np.testing.assert_allclose(actions, np.tile(wanted, (4, 1)), atol=1e-4)


def test_an_environment_whose_package_is_not_installed_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def make(*_: Any, **__: Any) -> None:
        raise gymnasium.error.DependencyNotInstalled(reason)

    monkeypatch.setattr(gymnasium, "make", make)
    reason = 'MuJoCo is not installed, run `pip install "gymnasium[mujoco]"`'
    params = EnvironmentParams(id="Hopper-v5")
    with pytest.raises(RecordingError, match=r"^the environment 'Hopper-v5' needs MuJoCo: pip install 'addressed-dy"):
        make_environment(params)
    reason = "Box2D is not installed, run pip install gymnasium[box2d]"
    with pytest.raises(
        RecordingError, match=r"needs a package that is not installed \(Box2D is not installed, run pip"
    ):
        make_environment(params)
