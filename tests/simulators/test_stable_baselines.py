"""The adapter to stable-baselines3, held against its own vector environment of single ones."""

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv
from learned_worlds import far_out, learned, many, single
from stable_baselines3 import A2C
from stable_baselines3.common.vec_env import DummyVecEnv

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.simulators.stable_baselines import StableBaselinesEnvironments

OPTIONS: dict[str, Any] = {"exact": True, "reward": far_out, "max_episode_steps": 7}


@pytest.mark.parametrize("world", ["car", "arm"])
def test_it_says_what_stable_baselines_own_vector_environment_says(world: str) -> None:
    of = learned(world)
    ours = StableBaselinesEnvironments(many(of, 4, autoreset_mode="SameStep", **OPTIONS))
    theirs = DummyVecEnv([lambda: single(of, **OPTIONS)] * 4)
    for env in (ours, theirs):
        env.seed(9)
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    np.testing.assert_equal(ours.reset_infos, theirs.reset_infos)
    ours.action_space.seed(1)
    ended = {True: 0, False: 0}
    for _ in range(30):
        actions = np.array([ours.action_space.sample() for _ in range(4)])
        found, expected = ours.step(actions), theirs.step(actions)
        for mine, own in zip(found, expected, strict=True):
            np.testing.assert_equal(mine, own)
        assert (found[1].dtype, found[2].dtype) == (expected[1].dtype, expected[2].dtype)
        np.testing.assert_equal(ours.reset_infos, theirs.reset_infos)
        for done, info in zip(found[2], found[3], strict=True):
            assert ("terminal_observation" in info) == done
            if done:
                ended[info["TimeLimit.truncated"]] += 1
    assert min(ended.values()) >= 2, "episodes end in both ways"


def test_the_last_state_of_an_episode_is_where_the_model_went_and_not_where_the_next_began() -> None:
    of = learned("car")
    env = StableBaselinesEnvironments(many(of, 3, autoreset_mode="SameStep", max_episode_steps=2))
    env.seed(0)
    env.reset()
    before = env.step(np.array([0, 1, 2]))[0]
    after, _, done, infos = env.step(np.array([2, 1, 0]))
    assert done.all()
    low, high = env.observation_space.low, env.observation_space.high
    expected = np.clip(of.model.predict(before, np.array([2, 1, 0])), low, high)
    np.testing.assert_array_equal([info["terminal_observation"] for info in infos], expected)
    assert all(info["TimeLimit.truncated"] for info in infos)
    beginnings = of.starts.observation[of.starts.beginning, -1]
    assert all((state == beginnings).all(axis=1).any() for state in after)


def test_any_vector_environment_that_starts_anew_in_the_same_step_will_do() -> None:
    of = learned("car")
    alone = SyncVectorEnv([lambda: single(of, **OPTIONS)] * 2, autoreset_mode="SameStep")
    ours, theirs = StableBaselinesEnvironments(alone), DummyVecEnv([lambda: single(of, **OPTIONS)] * 2)
    for env in (ours, theirs):
        env.seed(3)
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    for step in range(15):
        for mine, own in zip(ours.step(np.full(2, step % 3)), theirs.step(np.full(2, step % 3)), strict=True):
            np.testing.assert_equal(mine, own)


def test_an_agent_learns_in_it() -> None:
    env = StableBaselinesEnvironments(many(learned("car"), 8, autoreset_mode="SameStep", **OPTIONS))
    agent = A2C("MlpPolicy", env, n_steps=4, seed=0, device="cpu", policy_kwargs={"net_arch": [8]})
    before = {name: value.clone() for name, value in agent.policy.state_dict().items()}
    agent.learn(96)
    assert agent.num_timesteps == 96
    assert any((value != before[name]).any() for name, value in agent.policy.state_dict().items())


@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_copies_that_start_anew_in_another_step_are_refused(mode: str) -> None:
    with pytest.raises(ModelError, match=rf"make_vec\(\.\.\., autoreset_mode='SameStep'\), but these have '{mode}'"):
        StableBaselinesEnvironments(many(learned("car"), 2, autoreset_mode=mode))


def test_options_are_those_of_all_copies() -> None:
    env = StableBaselinesEnvironments(many(learned("car"), 2, autoreset_mode="SameStep"))
    env.set_options({"state": [[-0.5, 0.0], [-0.4, 0.01]]})
    np.testing.assert_array_equal(env.reset(), np.float32([[-0.5, 0.0], [-0.4, 0.01]]))
    env.set_options([{}, {"state": [0.0, 0.0]}])
    with pytest.raises(ModelError, match="all copies are reset with the same options"):
        env.reset()
    for call in (lambda: env.env_method("wave"), lambda: env.set_attr("gravity", 1.0)):
        with pytest.raises(ModelError, match="copies that are stepped together have no"):
            call()
