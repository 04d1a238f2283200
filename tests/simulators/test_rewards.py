"""Who says reward and end of a learned environment: what is kept with a model, and what a user chooses."""

import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from learned_worlds import LEARNED, far_out
from trusted_models import SPACES, drifting, write_models

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.transitions import Dimension, DiscreteAction, SpaceSpec
from addressed_dynamics.evaluation.transitions.starting import starts_of
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.rewards import Fitted, KeptTask, LearnedTask, read_task, task_inputs, write_task
from addressed_dynamics.simulators.starts import write_starts


def network(inputs: int, outputs: int, seed: int) -> Fitted:
    stack = StackedMLP(1, (inputs, 8, outputs), "tanh", torch.Generator().manual_seed(seed)).requires_grad_(False)
    return Fitted(stack, torch.full((inputs,), 0.1), torch.full((inputs,), 0.5))


def task() -> LearnedTask:
    return LearnedTask(SPACES, network(5, 1, 0), -0.5, 2.0, network(6, 2, 1), 0.05)


def steps(number: int) -> tuple[np.ndarray, ...]:
    data = drifting(number, 4, length=1)
    return data.observation, data.action, data.next_observation, data.exogenous


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = write_models(tmp_path / "drift")
    write_starts(made, starts_of(drifting(3, 0), 1))
    return made


def stepped(folder: Path, **options: Any) -> tuple[Any, ...]:
    env = gymnasium.make(LEARNED, model=folder, candidate="total_parameters", **options)
    first, _ = env.reset(seed=3)
    action = np.array([0.5], np.float32)
    after, reward, terminated, _, info = env.step(action)
    return first, action, after, reward, terminated, (info["reward_source"], info["end_source"])


def test_what_is_kept_is_read_as_it_was(tmp_path: Path) -> None:
    for kept in (
        KeptTask("a:b", task()),
        KeptTask(None, LearnedTask(SPACES, None, 0.0, 0.0, None, 0.0)),
        KeptTask(None, None),
    ):
        write_task(tmp_path, kept)
        found = read_task(tmp_path)
        assert found is not None
        assert found.function == kept.function
        if kept.learned is None or found.learned is None:
            assert found.learned is kept.learned
            continue
        for own, read in zip(kept.learned(*steps(50)), found.learned(*steps(50)), strict=True):
            np.testing.assert_array_equal(own, read)
    write_task(tmp_path, None)
    assert read_task(tmp_path) == KeptTask(None, None)
    assert read_task(tmp_path / "elsewhere") is None


def test_what_is_learned_says_reward_and_end_unless_something_else_is_asked_for(folder: Path) -> None:
    assert stepped(folder)[3:] == (0.0, False, ("none", "none"))
    write_task(folder, KeptTask(None, task()))
    first, action, after, reward, terminated, said_by = stepped(folder)
    expected = task()(first[None], action[None], after[None], np.empty((1, 0), np.float32))
    assert reward == pytest.approx(expected[0][0])
    assert (terminated, said_by) == (bool(expected[1][0]), ("learned", "learned"))
    assert stepped(folder, reward="none")[3:] == (0.0, False, ("none", "none"))
    assert stepped(folder, reward=far_out)[5] == ("learned_worlds:far_out",) * 2


def test_a_function_that_the_experiment_names_comes_first_if_it_is_this_packages(folder: Path) -> None:
    own = "addressed_dynamics.envs:mountain_car_reward"
    write_task(folder, KeptTask(own, task()))
    assert stepped(folder)[3:] == (-1.0, False, (own, own))
    assert stepped(folder, reward="learned")[5] == ("learned", "learned")
    write_task(folder, KeptTask("learned_worlds:far_out", task()))
    with pytest.raises(
        ModelError, match=r"names 'learned_worlds:far_out'.*is not run unasked; give reward='learned_wor"
    ):
        stepped(folder)
    assert stepped(folder, reward="learned_worlds:far_out")[5] == ("learned_worlds:far_out",) * 2


@pytest.mark.filterwarnings("ignore:.*A Box observation space")
def test_the_checks_of_gymnasium_pass_with_what_is_learned(folder: Path) -> None:
    write_task(folder, KeptTask(None, task()))
    check_env(gymnasium.make(LEARNED, model=folder, candidate="total_parameters").unwrapped)


def test_rewards_do_not_depend_on_how_many_copies_there_are_in_double_precision(folder: Path) -> None:
    write_task(folder, KeptTask(None, task()))
    options: dict[str, Any] = {"model": folder, "candidate": "total_parameters", "exact": True}
    copies = gymnasium.make_vec(LEARNED, num_envs=33, vectorization_mode="vector_entry_point", **options)
    alone = gymnasium.make(LEARNED, **options)
    copies.reset(seed=7)
    alone.reset(seed=7)
    actions = np.linspace(-1, 1, 33, dtype=np.float32)[:, None]
    for _ in range(5):
        rewards, ends = copies.step(actions)[1:3]
        _, reward, terminated, _, _ = alone.step(actions[0])
        assert (reward, terminated) == (rewards[0], ends[0])
        if terminated:
            break


def test_discrete_actions_are_one_hot_and_the_state_before_is_a_change() -> None:
    spaces = SpaceSpec((Dimension("x", "m", -1.0, 1.0),), DiscreteAction(("left", "right")), 0.1)
    x = task_inputs(spaces, np.float32([[0.5]]), np.array([1]), np.float32([[0.75]]), np.empty((1, 0), np.float32))
    assert x.tolist() == [[0.75, 0.25, 0.0, 1.0]]


def test_what_is_damaged_missing_or_of_another_model_is_refused(folder: Path) -> None:
    with pytest.raises(ModelError, match=r"no reward was learned that is kept with it.*'dvc repro evaluate@NAME'"):
        stepped(folder, reward="learned")
    other = SpaceSpec(SPACES.observation, SPACES.action, 0.2)
    write_task(folder, KeptTask(None, LearnedTask(other, None, 1.0, 0.0, None, 0.0)))
    with pytest.raises(ModelError, match="other spaces"):
        stepped(folder)
    write_task(folder, KeptTask(None, task()))
    index = folder / "reward" / "reward.json"
    whole = json.loads(index.read_text())
    del whole["learned"]["threshold"]
    index.write_text(json.dumps(whole))
    with pytest.raises(
        ModelError, match=r"reward: incomplete or malformed \('threshold'\); 'dvc repro evaluate@drift'"
    ):
        stepped(folder)
    index.write_text(json.dumps({**whole, "format": 99}))
    with pytest.raises(ModelError, match="format 1 expected"):
        stepped(folder)
