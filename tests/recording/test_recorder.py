import os
import signal
import subprocess
import sys
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from builders import fill_disk_after
from gymnasium.spaces import Box, Dict, Discrete, MultiDiscrete
from gymnasium.vector import SyncVectorEnv
from gymnasium.wrappers import Autoreset, TimeLimit

from addressed_dynamics.base.errors import LogError, RecordingError, SpaceError
from addressed_dynamics.logs import RunInfo, read_log, recover_log
from addressed_dynamics.recording.recorder import TransitionRecorder
from addressed_dynamics.recording.spaces import space_spec
from addressed_dynamics.sources.transitions.reading import read_transitions


class Counter(gymnasium.Env):
    """Counts its steps in every number of its observation, in an array that it reuses; ends after `length` steps."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": [], "render_fps": 20}

    def __init__(self, shape=(2,), dtype=np.float32, action_space=None, length=3):
        self.observation_space = Box(-np.inf, np.inf, shape, dtype)
        self.action_space = action_space or Discrete(3)
        self.length = length
        self.state = np.zeros(shape, dtype)
        self.steps = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed, options=options)
        self.steps = 0
        self.state[...] = 0
        return self.state, {}

    def step(self, _):
        self.steps += 1
        self.state += 1
        return self.state, 0.5 * self.steps, self.steps >= self.length, False, {}


class ResetsWithinTheStep(Counter):
    """Returns the next episode's first observation with the end of an episode, as Gymnasium's SAME_STEP mode does."""

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        if terminated:
            info = {"final_obs": observation.copy()}
            observation, _ = self.reset()
        return observation, reward, terminated, truncated, info


def test_everything_that_the_environment_makes_is_in_the_log(tmp_path):
    steps = []
    env = TransitionRecorder(gymnasium.make("MountainCar-v0", max_episode_steps=30), tmp_path / "car.mcap")
    generator = np.random.default_rng(0)
    before, _ = env.reset(seed=5)
    for _ in range(100):
        action = generator.integers(3)
        after, reward, terminated, truncated, _ = env.step(action)
        steps.append((before, action, reward, after, terminated, truncated))
        before = env.reset()[0] if terminated or truncated else after
    env.close()
    contents = read_log(tmp_path / "car.mcap")
    recorded = contents.transitions
    observations, actions, rewards, followers, terminated, truncated = map(np.array, zip(*steps, strict=True))
    np.testing.assert_array_equal(recorded.observation, observations)
    np.testing.assert_array_equal(recorded.next_observation, followers)
    np.testing.assert_array_equal(recorded.action, actions)
    np.testing.assert_array_equal(recorded.reward, rewards)
    np.testing.assert_array_equal(recorded.terminated, terminated)
    np.testing.assert_array_equal(recorded.truncated[:99], truncated[:99])
    assert [(each.length, each.ended) for each in contents.episodes] == [(30, "truncated")] * 3 + [(10, "cut")]
    assert [each.seed for each in contents.episodes] == [5, None, None, None]
    assert recorded.truncated[99]
    assert env.transitions == 100
    assert contents.run.environment == "MountainCar-v0"
    assert contents.run.kwargs == {}
    assert "gymnasium" in contents.run.versions


def test_the_wrapper_changes_nothing(tmp_path):
    def rollout(env):
        env.action_space.seed(1)
        results = [env.reset(seed=3)]
        for _ in range(60):
            results.append(env.step(env.action_space.sample()))
            if results[-1][2] or results[-1][3]:
                results.append(env.reset())
        env.close()
        return results

    plain = rollout(gymnasium.make("MountainCar-v0", max_episode_steps=25))
    recorded = rollout(TransitionRecorder(gymnasium.make("MountainCar-v0", max_episode_steps=25), tmp_path / "a.mcap"))
    for expected, found in zip(plain, recorded, strict=True):
        np.testing.assert_array_equal(found[0], expected[0])
        assert found[1:] == expected[1:]


def test_a_reset_in_the_middle_of_an_episode_cuts_it(tmp_path):
    env = TransitionRecorder(Counter(length=5), tmp_path / "a.mcap", first_episode=40)
    env.reset(seed=1)
    env.step(0)
    env.step(1)
    env.reset(seed=2)
    env.reset(seed=3)
    env.step(2)
    env.close()
    contents = read_log(tmp_path / "a.mcap")
    assert [(e.episode, e.seed, e.length, e.ended) for e in contents.episodes] == [(40, 1, 2, "cut"), (41, 3, 1, "cut")]
    assert contents.transitions.truncated.tolist() == [False, True, True]
    assert contents.transitions.observation[:, 0].tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize("make", [lambda: Autoreset(Counter()), ResetsWithinTheStep], ids=["next step", "same step"])
def test_an_environment_that_resets_itself_is_recorded_without_the_jump(tmp_path, make):
    env = TransitionRecorder(make(), tmp_path / "a.mcap")
    env.reset(seed=1)
    while env.transitions < 8:
        env.step(0)
    env.close()
    contents = read_log(tmp_path / "a.mcap")
    assert contents.transitions.observation[:, 0].tolist() == [0, 1, 2, 0, 1, 2, 0, 1]
    assert contents.transitions.next_observation[:, 0].tolist() == [1, 2, 3, 1, 2, 3, 1, 2]
    assert [(e.length, e.ended, e.seed) for e in contents.episodes] == [
        (3, "terminated", 1),
        (3, "terminated", None),
        (2, "cut", None),
    ]


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.uint8])
def test_observations_of_any_shape_are_flattened_row_by_row(tmp_path, dtype):
    env = Counter(shape=(2, 3), dtype=np.float32)
    env.observation_space = Box(0, 200, (2, 3), dtype)
    env.state = np.zeros((2, 3), dtype)
    recorder = TransitionRecorder(env, tmp_path / "a.mcap")
    recorder.reset()
    recorder.step(0)
    recorder.close()
    transitions = read_log(tmp_path / "a.mcap").transitions
    assert transitions.spec.observation_names == tuple(f"observation_{i}" for i in range(6))
    assert transitions.next_observation.tolist() == [[1.0] * 6]


def test_continuous_actions_are_recorded_as_they_were_given(tmp_path):
    class Clips(Counter):
        def step(self, action):
            np.clip(action, -1, 1, out=action)
            return super().step(action)

    env = TransitionRecorder(Clips(action_space=Box(-1, 1, (2, 2))), tmp_path / "a.mcap")
    env.reset()
    action = np.array([[5.0, 0.1], [-0.2, -7.0]], dtype=np.float32)
    env.step(action)
    assert action.max() == 1.0
    env.close()
    np.testing.assert_array_equal(
        read_log(tmp_path / "a.mcap").transitions.action, np.float32([[5.0, 0.1, -0.2, -7.0]])
    )


def test_shards_roll_at_the_end_of_an_episode_and_join_without_a_seam(tmp_path):
    env = TransitionRecorder(Counter(), tmp_path / "a.mcap", shard_transitions=5)
    for _ in range(5):
        env.reset()
        for _ in range(3):
            env.step(0)
    assert (tmp_path / "a-001.mcap").exists()
    assert not (tmp_path / "a-002.mcap").exists()
    env.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a-000.mcap", "a-001.mcap", "a-002.mcap"]
    assert [path.name for path in env.paths] == ["a-000.mcap", "a-001.mcap", "a-002.mcap"]
    episodes = [[e.episode for e in read_log(path).episodes] for path in env.paths]
    assert episodes == [[0, 1], [2, 3], [4]]


def test_no_empty_shard_follows_the_last(tmp_path):
    env = TransitionRecorder(Counter(), tmp_path / "a.mcap", shard_transitions=3)
    env.reset()
    for _ in range(3):
        env.step(0)
    env.reset()
    env.close()
    env.close()
    assert [path.name for path in tmp_path.iterdir()] == ["a-000.mcap"]


def test_a_given_run_and_topic_are_kept(tmp_path):
    run = RunInfo(environment="Counter-v9", segment="part", seed=8)
    env = TransitionRecorder(Counter(), tmp_path / "a.mcap", run=run, topic="/env_07")
    env.close()
    assert read_log(tmp_path / "a.mcap").run == run
    assert b"/env_07/transition" in (tmp_path / "a.mcap").read_bytes()


@pytest.mark.parametrize(
    ("env", "problem"),
    [
        (Counter(action_space=Discrete(3, start=1)), r"Counter: actions should be .* Discrete\(3, start=1\)"),
        (Counter(action_space=MultiDiscrete([2, 2])), r"actions should be .* MultiDiscrete"),
        (Counter(action_space=Box(0, 5, (1,), np.int32)), r"actions should be .* Box\(0, 5, \(1,\), int32\)"),
        (Counter(shape=(0,)), "the observation has 0 dimensions"),
    ],
)
def test_spaces_that_cannot_be_recorded_are_refused(tmp_path, env, problem):
    with pytest.raises(SpaceError, match=problem):
        TransitionRecorder(env, tmp_path / "a.mcap")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("space", [Discrete(16), Dict({"a": Discrete(2)}), Box(0, 9, (2,), np.int64)], ids=str)
def test_observations_that_are_no_vector_of_floats_are_refused(space):
    env = Counter()
    env.observation_space = space
    with pytest.raises(SpaceError, match="Counter: observations should be a Box of floats or small integers"):
        space_spec(env)


def test_a_description_that_does_not_fit_its_space_is_refused():
    env = Counter()
    env.metadata = {"addressed_dynamics": {"observation": (("position", "m"),)}}
    with pytest.raises(SpaceError, match=r"\['observation'\] describes 1 components, but the observation space has 2"):
        space_spec(env)


def test_names_units_and_step_come_from_the_environments_own_description():
    env = Counter(action_space=Box(-2, 2, (1,)))
    env.metadata = {
        "render_fps": 10,
        "addressed_dynamics": {
            "observation": (("height", "m"), ("speed", "m/s")),
            "action": (("thrust", "N"),),
            "step_seconds": 0.02,
        },
    }
    spec = space_spec(TimeLimit(env, 5))
    assert [(each.name, each.unit) for each in spec.observation] == [("height", "m"), ("speed", "m/s")]
    assert [(each.name, each.unit, each.low, each.high) for each in spec.action.dimensions] == [
        ("thrust", "N", -2.0, 2.0)
    ]
    assert spec.step_seconds == 0.02


def test_a_step_lasts_a_frame_or_else_a_second():
    env = Counter()
    assert space_spec(env).step_seconds == 1 / 20
    env.metadata = {}
    assert space_spec(env).step_seconds == 1.0


@pytest.mark.parametrize(
    ("name", "first", "action", "step_seconds"),
    [
        ("MountainCar-v0", "position", "push_left", 1 / 30),
        ("MountainCarContinuous-v0", "position", "force", 1 / 30),
        ("Acrobot-v1", "cos_angle_1", "torque_negative", 0.2),
        ("CartPole-v1", "position", "push_left", 0.02),
        ("Pendulum-v1", "cos_angle", "torque", 0.05),
    ],
)
def test_gymnasiums_environments_have_names_for_their_numbers(tmp_path, name, first, action, step_seconds):
    env = TransitionRecorder(gymnasium.make(name), tmp_path / "a.mcap")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()
    spec = read_log(tmp_path / "a.mcap").transitions.spec
    assert spec.observation_names[0] == first
    names = getattr(spec.action, "names", None) or [each.name for each in spec.action.dimensions]
    assert names[0] == action
    assert spec.step_seconds == step_seconds


@pytest.mark.parametrize("where", ["observation", "reward", "first observation"])
def test_a_number_that_is_not_finite_is_one_error_with_its_place_and_the_rest_is_kept(tmp_path, where):
    class Fails(Counter):
        def reset(self, **kwargs):
            first, info = super().reset(**kwargs)
            return (first * np.float32("nan") if where == "first observation" and kwargs.get("seed") else first), info

        def step(self, action):
            observation, reward, *rest = super().step(action)
            if self.steps == 3 and where == "observation":
                observation = observation * np.float32("nan")
            if self.steps == 3 and where == "reward":
                reward = float("inf")
            return observation, reward, *rest

    env = TransitionRecorder(Fails(length=9), tmp_path / "a.mcap")
    env.reset()
    env.step(0)
    env.step(0)
    go_on = (lambda: env.reset(seed=1)) if where == "first observation" else (lambda: env.step(0))
    with pytest.raises(RecordingError, match=r"a\.mcap: Fails, episode \d, step \d: the .*(nan|inf)"):
        go_on()
    env.reset()
    env.step(0)
    env.close()
    assert [(e.length, e.ended) for e in read_log(tmp_path / "a.mcap").episodes] == [(2, "cut"), (1, "cut")]


@pytest.mark.parametrize(
    ("space", "action", "problem"),
    [
        (Discrete(3), 3, "the action is 3, but actions are 0..2"),
        (Discrete(3), 1.7, r"the action is 1\.7, but should be a whole number"),
        (Discrete(3), np.float32("nan"), "the action is .*nan.*, but should be a whole number"),
        (Discrete(3), "1", "the action is '1', but should be a whole number"),
        (Discrete(3), np.array([1]), r"an array of shape \(1,\), but should be one whole number: .* action\[0\]"),
        (Discrete(3), np.array([1, 2]), r"an array of shape \(2,\), .*: give one action at a time"),
        (Box(-1, 1, (2,)), np.zeros(3), "the action has 3 components, but its space has 2"),
        (Box(-1, 1, (2,)), np.array([0.0, np.nan]), "the action is not finite"),
    ],
)
def test_an_action_outside_its_space_is_refused(tmp_path, space, action, problem):
    env = TransitionRecorder(Counter(action_space=space), tmp_path / "a.mcap")
    env.reset()
    with pytest.raises(RecordingError, match=problem):
        env.step(action)
    env.close()
    assert len(read_log(tmp_path / "a.mcap").transitions) == 0


@pytest.mark.parametrize("action", [1, np.int64(1), np.array(1), np.uint8(1), 1.0, np.float32(1), True])
def test_a_whole_number_of_any_type_is_an_action(tmp_path, action):
    env = TransitionRecorder(Counter(), tmp_path / "a.mcap")
    env.reset()
    env.step(action)
    env.close()
    assert read_log(tmp_path / "a.mcap").transitions.action.tolist() == [1]


def test_a_vectorised_environment_is_refused_with_what_to_do(tmp_path):
    envs = gymnasium.make_vec("CartPole-v1", num_envs=3, vectorization_mode="sync")
    with pytest.raises(SpaceError, match=r"SyncVectorEnv: .* a vector of 3; wrap each .*TransitionRecorder") as caught:
        TransitionRecorder(envs, tmp_path / "a.mcap")
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())
    with pytest.raises(SpaceError, match=r"records a gymnasium\.Env, but this is a str"):
        TransitionRecorder("CartPole-v1", tmp_path / "a.mcap")


def test_recorders_inside_a_vectorised_environment_leave_one_folder_of_different_episodes(tmp_path):
    envs = SyncVectorEnv([lambda i=i: TransitionRecorder(Counter(), tmp_path / f"{i}.mcap") for i in range(3)])
    envs.reset(seed=0)
    for step in range(12):
        envs.step(np.array([step % 3, 0, 1]))
    envs.close()
    logs = [read_log(tmp_path / f"{i}.mcap") for i in range(3)]
    assert [[each.episode for each in log.episodes] for log in logs] == [[0, 1, 2]] * 3
    found = read_transitions(tmp_path)
    np.testing.assert_array_equal(np.unique(found.episode), np.arange(9))
    np.testing.assert_array_equal(found.action, np.concatenate([log.transitions.action for log in logs]))


def test_a_seed_that_does_not_fit_is_refused(tmp_path):
    env = TransitionRecorder(Counter(), tmp_path / "a.mcap")
    with pytest.raises(RecordingError, match="the seed 9223372036854775808 cannot be recorded"):
        env.reset(seed=2**63)
    env.close()


def test_a_full_disk_is_one_error_and_what_was_safe_can_be_recovered(tmp_path, monkeypatch):
    fill_disk_after(monkeypatch, 9000)
    env = TransitionRecorder(Counter(length=20), tmp_path / "a.mcap")

    def record_forever():
        while True:
            env.reset()
            for _ in range(20):
                env.step(0)

    with pytest.raises(RecordingError, match=r"a\.mcap\.partial: the log cannot be written \(No space left") as caught:
        record_forever()
    monkeypatch.undo()
    env.close()
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.partial"]
    with pytest.raises(RecordingError, match="No space left"):
        env.step(0)
    report = recover_log(tmp_path / "a.mcap.partial", tmp_path / "a.mcap")
    promised = int(str(caught.value).split(" transitions are safe")[0].rsplit(" ", 1)[1])
    assert 0 < promised <= report.transitions <= promised + 20


def test_a_disk_that_is_full_at_the_end_is_an_error_too(tmp_path, monkeypatch):
    fill_disk_after(monkeypatch, 5000)
    env = TransitionRecorder(Counter(length=500), tmp_path / "a.mcap")
    env.reset()
    for step in range(400):
        env.step(step % 3)
    with pytest.raises(RecordingError, match="No space left"):
        env.close()
    env.close()


def test_a_second_recorder_does_not_touch_the_first_ones_file(tmp_path):
    first = TransitionRecorder(Counter(), tmp_path / "a.mcap")
    with pytest.raises(LogError, match="another recording is writing this file"):
        TransitionRecorder(Counter(), tmp_path / "a.mcap")
    first.close()


RECORD_FOREVER = """
import sys
import gymnasium
from addressed_dynamics.recording.recorder import TransitionRecorder

env = TransitionRecorder(gymnasium.make("MountainCar-v0", max_episode_steps=50), sys.argv[1])
env.reset(seed=0)
episodes = 0
while True:
    _, _, terminated, truncated, _ = env.step(episodes % 3)
    if terminated or truncated:
        episodes += 1
        if episodes == 7:
            print("seven", flush=True)
        env.reset()
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system cannot kill a process without warning")
def test_a_killed_recording_keeps_every_episode_that_had_ended(tmp_path):
    path = tmp_path / "car.mcap"
    child = subprocess.Popen([sys.executable, "-c", RECORD_FOREVER, str(path)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    with child.stdout:
        assert child.stdout.readline() == "seven\n"
    os.kill(child.pid, signal.SIGKILL)
    assert child.wait() == -signal.SIGKILL
    assert not path.exists()
    with pytest.raises(LogError, match=r"the recording was not finished|follow"):
        read_log(tmp_path / "car.mcap.partial")
    report = recover_log(tmp_path / "car.mcap.partial", path)
    contents = read_log(path)
    assert report.episodes == len(contents.episodes) >= 7
    env = gymnasium.make("MountainCar-v0", max_episode_steps=50)
    state, _ = env.reset(seed=0)
    for row in range(350):
        np.testing.assert_array_equal(contents.transitions.observation[row], state)
        state, _, _, truncated, _ = env.step(row // 50 % 3)
        np.testing.assert_array_equal(contents.transitions.next_observation[row], state)
        state = env.reset()[0] if truncated else state
