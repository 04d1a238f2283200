"""A model of motion as an environment: commands are the actions, in the same calls as of any other."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from driven import FEATURES, motion_model
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3.common.env_checker import check_env as check_for_stable_baselines

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.envs import LEARNED
from addressed_dynamics.evaluation.motion.closed_loop.commands import Segment, script
from addressed_dynamics.evaluation.motion.closed_loop.run import closed_loop
from addressed_dynamics.networks.files import SavedNetwork, save_network
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.motion import MotionModel
from addressed_dynamics.simulators.motion_environment import COMMANDS, SPACES
from addressed_dynamics.simulators.motion_loop import mean_pose
from addressed_dynamics.simulators.stable_baselines import StableBaselinesEnvironments

WALK = np.array([0.0, 2.5, 0.0, 1.0, 0.0, 0.0, 0.0], np.float32)
"""To walk along z, and to look there."""


def made(**options: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(LEARNED, model=motion_model(), **options)


def many(number: int, **options: Any) -> gymnasium.vector.VectorEnv[Any, Any, Any]:
    whole = {"model": motion_model(), **options}
    return gymnasium.make_vec(LEARNED, num_envs=number, vectorization_mode="vector_entry_point", **whole)


def far_on(state: np.ndarray, action: np.ndarray, next_state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return next_state[:, 1] - state[:, 1] + action[:, 4], next_state[:, 1] > 5.0


def flies() -> MotionModel:
    """A model whose next pose is farther away than anything can be."""
    stack = StackedMLP(1, (FEATURES.inputs, FEATURES.outputs), "relu")
    stack.biases[0].data.fill_(1e6)
    return MotionModel(FEATURES, stack.requires_grad_(False))


@pytest.mark.filterwarnings("ignore:.*(A Box observation space|symmetric and normalized)")
def test_the_checks_of_gymnasium_and_of_stable_baselines_pass() -> None:
    env = made(reward=far_on)
    check_env(env.unwrapped)
    check_for_stable_baselines(env.unwrapped)


def test_names_units_and_the_clock_are_told() -> None:
    env = made()
    described = env.metadata["addressed_dynamics"]
    assert described["step_seconds"] == 1 / 60
    assert described["action"] == tuple((each.name, each.unit) for each in COMMANDS.dimensions)
    names = [name for name, _ in described["observation"]]
    assert env.observation_space.shape == (len(names),) == (len(set(names)),)
    assert all(name.isidentifier() for name in names)
    assert names[:4] == ["root_x", "root_z", "facing_x", "facing_z"]
    assert "trajectory_position_x_minus_60" in names
    assert not any(name.startswith("height") for name in names)


def test_under_the_same_commands_it_goes_where_the_closed_loop_goes() -> None:
    frames = 40
    walk = script([Segment(frames / 60, stick=1.0, turn=45.0)])
    trace = closed_loop({"model": motion_model().predictor()}, [walk], mean_pose(FEATURES))["model"]
    env = made()
    state, info = env.reset(options={"facing": float(np.angle(walk.facing[0]))})
    assert info == {}
    for frame in range(frames):
        # What is seen in a frame of the loop is where the environment was before it.
        np.testing.assert_allclose(state[:2], [trace.root[0, frame].imag, trace.root[0, frame].real], atol=1e-4)
        velocity, facing = walk.velocity[frame], walk.facing[frame]
        action = [velocity.imag, velocity.real, facing.imag, facing.real, 0.0, 0.0, 0.0]
        state, reward, terminated, truncated, info = env.step(np.array(action, np.float32))
        assert (reward, terminated, truncated, info["stopped_by"]) == (0.0, False, False, "")
    assert (info["reward_source"], info["end_source"]) == ("none", "none")
    assert 0 <= info["network"] < motion_model().networks.members
    assert "trust" not in info


def test_a_seed_decides_where_a_character_looks_and_copies_go_as_one_alone() -> None:
    copies = many(3)
    first, _ = copies.reset(seed=5)
    again, _ = many(3).reset(seed=5)
    np.testing.assert_array_equal(first, again)
    assert len(np.unique(first[:, 2])) == 3
    alone = made()
    state, _ = alone.reset(seed=6)
    np.testing.assert_array_equal(first[1], state)
    for _ in range(10):
        all_states, state = copies.step(np.tile(WALK, (3, 1)))[0], alone.step(WALK)[0]
        np.testing.assert_allclose(all_states[1], state, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_copies_end_and_start_anew_as_gymnasium_has_it(mode: str) -> None:
    options: dict[str, Any] = {"reward": far_on, "max_episode_steps": 7}
    copies = many(2, autoreset_mode=mode, **options)
    single = SyncVectorEnv([lambda: made(**options)] * 2, autoreset_mode=AutoresetMode(mode))
    expected, found = single.reset(seed=1)[0], copies.reset(seed=1)[0]
    np.testing.assert_array_equal(found, expected)
    for _ in range(18):
        ours, theirs = (each.step(np.tile(WALK, (2, 1))) for each in (copies, single))
        for own, other in zip(ours[:4], theirs[:4], strict=True):
            np.testing.assert_allclose(own, other, rtol=1e-4, atol=1e-4)
        assert ours[4].get("_final_obs", np.zeros(2)).tolist() == theirs[4].get("_final_obs", np.zeros(2)).tolist()


def test_stable_baselines_takes_it() -> None:
    copies = StableBaselinesEnvironments(many(2, autoreset_mode="SameStep", max_episode_steps=2, reward=far_on))
    copies.reset()
    copies.step(np.tile(WALK, (2, 1)))
    _, _, done, infos = copies.step(np.tile(WALK, (2, 1)))
    assert done.all()
    assert infos[0]["TimeLimit.truncated"]
    assert infos[0]["terminal_observation"].shape == (len(SPACES.observation),)


def test_without_a_direction_it_looks_where_it_looked_before() -> None:
    blind = WALK * np.float32([1, 1, 0, 0, 1, 1, 1])
    env, other = made(), made()
    for each in (env, other):
        each.reset(options={"facing": 0.0})
    for _ in range(5):
        np.testing.assert_array_equal(env.step(blind)[0], other.step(WALK * np.float32([1, 1, 7, 0.3, 1, 1, 1]))[0])


def test_motion_that_flies_off_is_truncated_and_stays_where_it_was() -> None:
    env = gymnasium.make(LEARNED, model=flies()).unwrapped
    before, _ = env.reset(seed=0)
    after, _, terminated, truncated, info = env.step(WALK)
    assert (terminated, truncated, info["stopped_by"]) == (False, True, "flown_off")
    np.testing.assert_array_equal(after[:4], before[:4])
    with pytest.raises(ModelError, match="its episode has ended; reset it first"):
        env.step(WALK)


def test_a_folder_of_a_motion_model_is_enough(tmp_path: Path) -> None:
    folder = tmp_path / "walker"
    motion_model().save(folder, {})
    own, loaded = made(), gymnasium.make(LEARNED, model=str(folder))
    for env in (own, loaded):
        env.reset(seed=2)
    np.testing.assert_array_equal(own.step(WALK)[0], loaded.step(WALK)[0])
    save_network(tmp_path / "broken" / "network", SavedNetwork(motion_model().networks, FEATURES, {"mode": "no"}))
    with pytest.raises(ModelError, match="no mode of a motion model"):
        gymnasium.make(LEARNED, model=str(tmp_path / "broken"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"trust": True}, "no option 'trust': none is calibrated for it"),
        ({"least_trust": 0.1}, "no option 'least_trust'"),
        ({"begin": "anywhere"}, "no option 'begin'"),
        ({"reward": "learned"}, "logs of motion have no reward"),
        ({"mode": "argmax"}, "candidate and mode choose among the models in a folder"),
    ],
)
def test_what_says_nothing_of_motion_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        made(**options)


def test_commands_outside_the_space_and_unknown_starts_are_refused() -> None:
    env = made().unwrapped
    with pytest.raises(ModelError, match="reset knows no option 'state' of motion"):
        env.reset(options={"state": [0.0]})
    with pytest.raises(ModelError, match="option 'facing' should be an angle"):
        env.reset(options={"facing": "north"})
    env.reset(seed=0)
    with pytest.raises(ModelError, match="'velocity_z' should lie in"):
        env.step(WALK * 10)
