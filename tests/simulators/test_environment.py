"""A model as an environment: the same calls as Gymnasium's, alone or in many copies."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from learned_worlds import LEARNED, WORLDS, ends_at, far_out, learned, many, single
from learning import drive, untrained_model
from stable_baselines3.common.env_checker import check_env as check_for_stable_baselines
from trusted_models import drifting, trusted_model, write_models

from addressed_dynamics import TransitionRecorder, read_transitions
from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.envs import mountain_car_reward
from addressed_dynamics.evaluation.transitions.starting import starts_of
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.environment import LearnedEnvironment, LearnedEnvironments
from addressed_dynamics.simulators.modes import Mode
from addressed_dynamics.simulators.starts import write_starts

CASES = [(world, history) for world in WORLDS for history in (1, 3)]
REWARD = "addressed_dynamics.envs:mountain_car_reward"


def raises(*_: Any) -> Any:
    message = "the battery is empty\nand more"
    raise RuntimeError(message)


def seasons(step: np.ndarray) -> np.ndarray:
    return np.sin(0.3 * step)[:, None]


def actions(env: gymnasium.vector.VectorEnv[Any, Any, Any], steps: int) -> list[np.ndarray]:
    env.action_space.seed(5)
    return [env.action_space.sample() for _ in range(steps)]


@pytest.mark.parametrize("history", [1, 3])
def test_the_checks_of_gymnasium_and_of_stable_baselines_pass(history: int) -> None:
    env = single(learned("car", history), reward=REWARD)
    check_env(env.unwrapped)
    check_for_stable_baselines(env.unwrapped)


def test_spaces_have_the_names_units_and_bounds_of_the_model() -> None:
    car, arm = single(learned("car")), single(learned("arm"))
    assert car.observation_space == gymnasium.spaces.Box(
        np.float32([-1.2, -0.07]), np.float32([0.6, 0.07]), dtype=np.float32
    )
    assert car.action_space == gymnasium.spaces.Discrete(3)
    described = car.metadata["addressed_dynamics"]
    assert described["observation"] == (("position", "m"), ("velocity", "m/step"))
    assert described["action"] == ("push_left", "no_push", "push_right")
    assert described["step_seconds"] == 1 / 30
    np.testing.assert_array_equal(arm.observation_space.low, np.float32([-np.inf, -8.0]))
    assert arm.action_space == gymnasium.spaces.Box(np.float32([-2.0, 0.0]), np.float32([2.0, 1.0]), dtype=np.float32)


def test_actions_without_bounds_are_bounded_by_what_was_recorded() -> None:
    model, _, _ = trusted_model()
    train = drifting(4, 0)
    spaces = model.features.spaces.to_json()
    spaces["action"]["dimensions"][0] |= {"low": None, "high": None}
    unbounded = type(train.spec).from_json(spaces)
    features = type(model.features).from_json(model.features.to_json() | {"spaces": spaces})
    starts = starts_of(type(train)(**{**vars(train), "spec": unbounded}), 1)
    env = LearnedEnvironment(AddressedDynamics(features, model.ensemble), starts=starts)
    np.testing.assert_array_equal(env.action_space.low, train.action.min(axis=0))
    np.testing.assert_array_equal(env.action_space.high, train.action.max(axis=0))


@pytest.mark.parametrize("history", [1, 3])
def test_it_goes_where_a_rollout_from_its_start_goes_under_what_acted_there(history: int) -> None:
    boat = learned("boat", history)
    env, starts = single(boat).unwrapped, boat.starts
    env.action_space.seed(0)
    taken = [env.action_space.sample() for _ in range(8)]
    first, info = env.reset(seed=7)
    states = [env.step(action)[0] for action in taken]
    index = int(np.flatnonzero((starts.episode == info["episode"]) & (starts.step == info["step"]))[0])
    assert starts.beginning[index]
    frames = starts.observation[index]
    np.testing.assert_array_equal(first, frames[-1])
    wind = starts.exogenous[starts.row[index] :][: history - 1 + 8]
    acted = np.concatenate([starts.action[index], taken])
    rolled = boat.model.rollout(frames if history > 1 else frames[0], acted, exogenous=wind)
    np.testing.assert_allclose(states, rolled, rtol=1e-5, atol=1e-6)


def test_exogenous_inputs_are_replayed_until_their_episode_ends() -> None:
    env = single(learned("boat")).unwrapped
    _, info = env.reset(seed=1)
    length = {0: 30, 1: 20, 2: 12}[info["episode"]]
    ends = [env.step(np.zeros(1, np.float32))[3:] for _ in range(length)]
    assert [(truncated, told["stopped_by"]) for truncated, told in ends] == [(False, "")] * (length - 1) + [
        (True, "exogenous")
    ]


@pytest.mark.parametrize("history", [1, 3])
def test_exogenous_inputs_may_be_a_function_of_the_step(history: int) -> None:
    boat = learned("boat", history)
    env = single(boat, exogenous=seasons).unwrapped
    given = {"state": boat.train.observation[:history], "actions": boat.train.action[: history - 1]}
    if history == 1:
        given = {"state": given["state"][0]}
    env.reset(options=given)
    states = [env.step(np.full(1, 0.5, np.float32))[0] for _ in range(40)]
    acted = np.concatenate([boat.train.action[: history - 1], np.full((40, 1), 0.5, np.float32)])
    wind = seasons(np.arange(1 - history, 40))
    rolled = boat.model.rollout(given["state"], acted, exogenous=wind)
    np.testing.assert_allclose(states, rolled, rtol=1e-5, atol=1e-6)


def test_a_given_start_comes_with_what_is_replayed_from_it() -> None:
    boat = learned("boat", 3)
    env = single(boat).unwrapped
    rows = slice(4, 11)
    given = {
        "state": boat.train.observation[4:7], "actions": boat.train.action[4:6],
        "exogenous": boat.train.exogenous[rows],
    }  # fmt: skip
    _, info = env.reset(options=given)
    assert (info["episode"], info["step"]) == (-1, -1)
    found = [env.step(boat.train.action[6 + step]) for step in range(5)]
    rolled = boat.model.rollout(given["state"], boat.train.action[rows], exogenous=given["exogenous"])
    np.testing.assert_allclose([each[0] for each in found], rolled, rtol=1e-5, atol=1e-6)
    assert [each[4]["stopped_by"] for each in found] == ["", "", "", "", "exogenous"]


def test_starts_are_where_episodes_begin_or_anywhere() -> None:
    car = learned("car")
    for begin, expected in {"beginnings": {0}, "anywhere": set(car.train.step.tolist())}.items():
        env = many(car, 600, begin=begin)
        _, info = env.reset(seed=0)
        assert set(info["step"].tolist()) == expected


@pytest.mark.parametrize("mode", ["argmax", "sample", "mixture"])
@pytest.mark.parametrize(("world", "history"), CASES)
def test_a_seed_gives_the_same_trajectory_one_by_one_and_in_a_batch(world: str, history: int, mode: Mode) -> None:
    of = learned(world, history, mode)
    env = many(of, 5, exact=True, max_episode_steps=6, reward=far_out)
    alone = SyncVectorEnv(
        [lambda: single(of, exact=True, max_episode_steps=6, reward=far_out)] * 5, autoreset_mode="NextStep"
    )
    for found, expected in zip(played(env, 20), played(alone, 20), strict=True):
        assert_same(found, expected)


@pytest.mark.parametrize("history", [1, 3])
def test_in_single_precision_a_batch_differs_from_one_by_rounding_alone(history: int) -> None:
    of = learned("boat", history)
    together, alone = many(of, 6), SyncVectorEnv([lambda: single(of)] * 6)
    scale = np.array(of.model.features.scale)
    for found, expected in zip(played(together, 10), played(alone, 10), strict=True):
        np.testing.assert_allclose(found[0] / scale, expected[0] / scale, rtol=0, atol=1e-5)


@pytest.mark.parametrize("mode", [each.value for each in AutoresetMode])
def test_copies_start_anew_as_those_of_gymnasiums_own_vector_environment(mode: str) -> None:
    of = learned("arm")
    options = {"exact": True, "reward": far_out, "max_episode_steps": 7}
    together = many(of, 4, autoreset_mode=mode, **options)
    assert together.metadata["autoreset_mode"] is AutoresetMode(mode)
    alone = SyncVectorEnv([lambda: single(of, **options)] * 4, autoreset_mode=mode)
    steps = 30
    found, expected = played(together, steps), played(alone, steps)
    for ours, theirs in zip(found, expected, strict=True):
        assert_same(ours, theirs)
    ended = np.array([each[2] for each in found[1:]]), np.array([each[3] for each in found[1:]])
    assert min(ended[0].sum(), (ended[1] & ~ended[0]).sum()) >= 2, "both kinds of ends occur"


def played(env: gymnasium.vector.VectorEnv[Any, Any, Any], steps: int) -> list[tuple[Any, ...]]:
    """What a vector environment says of a reset and of some steps; one without resets is told to."""
    found: list[tuple[Any, ...]] = [env.reset(seed=11)]
    for taken in actions(env, steps):
        found.append(env.step(taken))
        done = found[-1][2] | found[-1][3]
        if env.metadata["autoreset_mode"] is AutoresetMode.DISABLED and done.any():
            found.append(env.reset(options={"reset_mask": done}))
            found[-1] = (found[-1][0], np.zeros(len(done)), np.zeros_like(done), np.zeros_like(done), found[-1][1])
    return found


def assert_same(found: Any, expected: Any) -> None:
    """Compare all that is said, `info` included."""
    assert type(found) is type(expected)
    if isinstance(found, dict):
        assert found.keys() == expected.keys()
        found, expected = list(found.values()), [expected[name] for name in found]
    if isinstance(found, np.ndarray) and found.dtype == object:
        found, expected = found.tolist(), expected.tolist()
    if isinstance(found, (list, tuple)):
        assert len(found) == len(expected)
        for ours, theirs in zip(found, expected, strict=True):
            assert_same(ours, theirs)
    else:
        np.testing.assert_equal(found, expected)


def test_copies_share_one_step_of_the_model(monkeypatch: pytest.MonkeyPatch) -> None:
    env = many(learned("car", 3), 50)
    env.reset(seed=0)
    batches, step = [], AddressedDynamics.step_and_member

    def counted(model: AddressedDynamics, observation: torch.Tensor, *rest: Any, **options: Any) -> Any:
        batches.append(len(observation))
        return step(model, observation, *rest, **options)

    monkeypatch.setattr(AddressedDynamics, "step_and_member", counted)
    env.step(np.zeros(50, np.int64))
    assert batches == [50]


def test_some_copies_can_be_given_a_start_and_the_others_go_on() -> None:
    env = many(learned("car"), 3)
    env.reset(seed=0)
    before = env.step(np.array([0, 1, 2]))[0]
    mask = np.array([False, True, False])
    options = {"reset_mask": mask, "state": [-0.5, 0.0]}
    after, info = env.reset(options=options)
    np.testing.assert_array_equal(after, [before[0], np.float32([-0.5, 0.0]), before[2]])
    np.testing.assert_array_equal(info["_episode"], mask)
    assert "reset_mask" in options


def test_a_known_function_says_reward_and_end_and_info_says_who() -> None:
    env = single(learned("car"), reward=REWARD).unwrapped
    env.reset(options={"state": [0.45, 0.07]})
    state, reward, terminated, truncated, info = env.step(2)
    expected = mountain_car_reward(np.zeros((1, 2)), np.array([2]), state[None])
    assert (reward, terminated, truncated) == (-1.0, bool(expected[1][0]), False)
    assert (info["reward_source"], info["end_source"]) == (REWARD, REWARD)
    own = single(learned("car"), reward=far_out).unwrapped
    first, _ = own.reset(seed=2)
    state, reward, terminated, _, info = own.step(2)
    assert info["reward_source"] == "learned_worlds:far_out"
    assert reward == pytest.approx(first[1] + 0.2 - state[0])
    assert terminated == ends_at(state[None])[0]


def test_without_a_function_the_reward_is_0_and_info_says_that_nobody_says_it() -> None:
    env = single(learned("car")).unwrapped
    env.reset(seed=0)
    _, reward, terminated, _, info = env.step(1)
    assert (reward, terminated, info["reward_source"], info["end_source"]) == (0.0, False, "none", "none")


def test_a_horizon_truncates() -> None:
    env = single(learned("car"), max_episode_steps=3)
    env.reset(seed=0)
    assert [env.step(0)[2:4] for _ in range(3)] == [(False, False), (False, False), (False, True)]
    assert gymnasium.spec(LEARNED).max_episode_steps == 1000


def test_info_names_the_network_that_the_model_addresses() -> None:
    of = learned("arm")
    env = many(of, 40, begin="anywhere")
    states, _ = env.reset(seed=0)
    taken = env.action_space.sample()
    *_, info = env.step(taken)
    np.testing.assert_array_equal(info["network"], of.model.address(states, taken))
    assert len(set(info["network"].tolist())) > 1


@pytest.mark.parametrize("history", [1, 2])
def test_info_has_the_trust_in_the_step_and_too_little_truncates(history: int) -> None:
    model, _, _ = trusted_model(history)
    starts = starts_of(drifting(60, 5), history)
    env = LearnedEnvironments(model, 30, starts=starts, least_trust=0.3, begin="anywhere")
    env.reset(seed=0)
    frames = env._copies._frames.copy(), env._copies._actions.copy()
    taken = env.action_space.sample()
    *_, truncated, info = env.step(taken)
    acted = np.concatenate([frames[1], taken[:, None]], axis=1)
    expected = model.trust(*((frames[0], acted) if history > 1 else (frames[0][:, 0], taken)))
    np.testing.assert_allclose(info["trust"], expected, atol=1e-6)
    np.testing.assert_array_equal(truncated, info["trust"] < 0.3)
    assert 0 < truncated.sum() < 30
    np.testing.assert_array_equal(info["stopped_by"] == "trust", truncated)


def test_trust_is_left_out_if_nobody_calibrated_it_or_nobody_asks_and_never_made_up() -> None:
    model, _, _ = trusted_model()
    starts = starts_of(drifting(3, 5), 1)
    for env in (LearnedEnvironment(model, starts=starts, trust=False), single(learned("car")).unwrapped):
        env.reset(seed=0)
        assert "trust" not in env.step(env.action_space.sample())[4]
    with pytest.raises(ModelError, match="nobody calibrated how far this model is to be trusted"):
        single(learned("car"), trust=True)
    with pytest.raises(ModelError, match="nobody calibrated"):
        single(learned("car"), least_trust=0.1)


def test_what_leaves_the_bounds_is_put_at_them_and_info_says_so() -> None:
    of = learned("car")
    env = many(of, 200, begin="anywhere")
    states, _ = env.reset(seed=0)
    taken = np.full(200, 2)
    after, *_, info = env.step(taken)
    free = of.model.predict(states, taken)
    low, high = env.single_observation_space.low, env.single_observation_space.high
    np.testing.assert_array_equal(after, np.clip(free, low, high))
    np.testing.assert_array_equal(info["clipped"], (after != free).any(axis=1))
    assert 0 < info["clipped"].sum() < 200


def test_a_prediction_that_is_no_number_ends_an_episode_where_it_was() -> None:
    train = drive()
    model = untrained_model(train, members=1)
    model.ensemble.biases[-1].fill_(torch.nan)
    env = LearnedEnvironment(model, starts=starts_of(train, 1))
    first, _ = env.reset(seed=0)
    state, _, terminated, truncated, info = env.step(0)
    np.testing.assert_array_equal(state, first)
    assert (terminated, truncated, info["stopped_by"]) == (False, True, "not_finite")


def test_it_is_made_of_a_folder_of_models_with_what_is_kept_there(tmp_path: Path) -> None:
    folder = write_models(tmp_path / "drift")
    options: dict[str, Any] = {"model": str(folder), "candidate": "total_parameters"}
    env = gymnasium.make(LEARNED, **options).unwrapped
    with pytest.raises(ModelError, match=r"starts: missing.*'dvc repro evaluate@drift' writes them"):
        env.reset(seed=0)
    env.reset(options={"state": [0.1, 0.2]})
    assert 0.0 <= env.step(np.zeros(1, np.float32))[4]["trust"] <= 1.0
    write_starts(folder, starts_of(drifting(3, 0), 1))
    env = gymnasium.make(LEARNED, **options)
    saved = str(folder / "baselines" / "total_parameters" / "seed-0")
    other = gymnasium.make(LEARNED, model=saved, starts=folder)
    np.testing.assert_array_equal(env.reset(seed=1)[0], other.reset(seed=1)[0])
    with pytest.raises(ModelError, match=r"seed-0: one saved model, beside which no starts are kept; name the folder"):
        gymnasium.make(LEARNED, model=saved).unwrapped.reset(seed=0)


def test_it_is_recorded_with_the_names_of_its_dimensions(tmp_path: Path) -> None:
    env = TransitionRecorder(single(learned("arm")), tmp_path / "arm.mcap")
    states = [env.reset(seed=0)[0]]
    states += [env.step(env.action_space.sample())[0] for _ in range(4)]
    env.close()
    found = read_transitions(tmp_path / "arm.mcap")
    assert found.spec.observation_names == ("angle", "speed")
    assert found.spec.step_seconds == 0.05
    np.testing.assert_array_equal(found.observation, states[:-1])
    np.testing.assert_array_equal(found.next_observation, states[1:])


def one_reward(*_: Any) -> Any:
    return np.zeros(1)


def nan_reward(state: np.ndarray, *_: Any) -> Any:
    return np.full(len(state), np.nan), np.zeros(len(state), bool)


def wide_reward(state: np.ndarray, *_: Any) -> Any:
    return state, np.zeros(len(state), bool)


def numeric_end(state: np.ndarray, *_: Any) -> Any:
    return np.zeros(len(state)), np.zeros(len(state))


@pytest.mark.parametrize(
    ("function", "problem"),
    [
        (raises, r"the reward function 'test_environment:raises' raised RuntimeError: the battery is empty$"),
        (one_reward, r"'test_environment:one_reward' should return \(reward, terminated\), but returned"),
        (nan_reward, r"'test_environment:nan_reward' returned rewards that are not finite: nan for copy 0"),
        (wide_reward, r"should return rewards of shape \(1,\), one row a copy, but they have \(1, 2\)"),
        (numeric_end, r"should say in 1 booleans which steps end an episode, but said so in float64"),
    ],
)
def test_a_reward_function_that_fails_is_named_in_one_line(function: Any, problem: str) -> None:
    env = single(learned("car"), reward=function).unwrapped
    env.reset(seed=0)
    with pytest.raises(ModelError, match=problem) as error:
        env.step(0)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("world", "options", "problem"),
    [
        ("car", {"reward": "nowhere:at_all"}, r"reward: there is no function 'nowhere:at_all' \(No module named"),
        ("car", {"reward": "math:nothing"}, r"reward: there is no function 'math:nothing'"),
        ("car", {"reward": "math:pi"}, r"reward: 'math:pi' is no function, but a float"),
        ("car", {"reward": 3.0}, r"reward should be a function, or its name as 'module:function', but is 3.0"),
        ("car", {"begin": "nowhere"}, r"begin should be one of beginnings, anywhere, but is 'nowhere'"),
        ("car", {"mode": "mixture"}, r"a model was given; leave them out"),
        ("car", {"exogenous": seasons}, r"the model has no exogenous inputs, but a function of them was given"),
        ("car", {"least_trust": 1.5}, r"least_trust should lie in 0..1, but is 1.5"),
        ("car", {"least_trust": 0.5, "trust": False}, r"asks for trust, which trust=False leaves out"),
        ("car", {"autoreset_mode": "Never"}, r"should be one of NextStep, SameStep, Disabled, but is 'Never'"),
        ("car", {"max_episode_steps": 0}, r"max_episode_steps should be at least 1, but is 0"),
    ],
)
def test_what_cannot_be_made_is_said_in_one_line(world: str, options: dict[str, Any], problem: str) -> None:
    with pytest.raises(ModelError, match=problem) as error:
        many(learned(world), 2, **options)
    assert "\n" not in str(error.value)


def test_a_folder_that_is_none_and_starts_of_another_model_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="no such model folder"):
        gymnasium.make(LEARNED, model=tmp_path / "nowhere")
    with pytest.raises(ModelError, match="the starts are of another model: of 1 frames with angle, speed, where this"):
        LearnedEnvironment(learned("car").model, starts=learned("arm").starts)
    with pytest.raises(ModelError, match="of 1 frames with position, velocity, where this one has 3"):
        LearnedEnvironment(learned("car", 3).model, starts=learned("car").starts)
    env = LearnedEnvironment(learned("car").model)
    with pytest.raises(ModelError, match="nobody says where to start"):
        env.reset(seed=0)


@pytest.mark.parametrize(
    ("world", "history", "options", "problem"),
    [
        ("car", 1, {"state": [0.0]}, r"option 'state' should have shape \(2,\), but has \(1,\)"),
        ("car", 1, {"state": [0.0, np.nan]}, r"option 'state' should be finite"),
        ("car", 1, {"state": [0.9, 0.0]}, r"option 'state': 'position' should lie in -1.2..0.6 m, but one is 0.9"),
        ("car", 1, {"place": [0.0, 0.0]}, r"reset knows no option 'place' \(options: state, actions, exogenous\)"),
        ("car", 1, {"actions": []}, r"option 'actions' belongs to a given start; give its 'state', too"),
        ("car", 1, {"state": [0.0, 0.0], "exogenous": [[1.0]]}, r"option 'exogenous' is not asked for"),
        ("car", 3, {"state": [0.0, 0.0]}, r"option 'state' should have shape \(3, 2\)"),
        ("car", 3, {"state": np.zeros((3, 2))}, r"a start of 3 frames needs option 'actions', of shape \(2,\)"),
        ("car", 3, {"state": np.zeros((3, 2)), "actions": [0, 3]}, r"actions should lie in 0..2 .*, but one is 3"),
        ("boat", 1, {"state": [0.0, 0.0]}, r"a given start needs option 'exogenous', of shape \(rows, 1\), with at"),
        ("boat", 1, {"state": [0.0, 0.0], "exogenous": [1.0]}, r"option 'exogenous' should have shape \(rows, 1\)"),
    ],
)
def test_what_is_no_start_is_refused_in_one_line(
    world: str, history: int, options: dict[str, Any], problem: str
) -> None:
    env = single(learned(world, history)).unwrapped
    with pytest.raises(ModelError, match=problem) as error:
        env.reset(options=options)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("world", "taken", "problem"),
    [
        ("car", [0, 1, 7], r"actions should lie in 0..2 \(push_left, no_push, push_right\), but one is 7"),
        ("car", [0.0, 1.0, 2.0], r"actions should be 3 integers, but are float64 of shape \(3,\)"),
        ("car", [0, 1], r"there should be an action for each of 3 copies, but they have shape \(2,\)"),
        ("arm", np.zeros((3, 1)), r"actions should have shape \(3, 2\), but have \(3, 1\)"),
        ("arm", np.full((3, 2), 1.5), r"actions: 'brake' should lie in 0..1, but one is 1.5"),
        ("arm", np.full((3, 2), np.nan), r"actions should be finite"),
    ],
)
def test_an_action_outside_the_space_is_refused_in_one_line(world: str, taken: Any, problem: str) -> None:
    env = many(learned(world), 3)
    env.reset(seed=0)
    with pytest.raises(ModelError, match=problem) as error:
        env.step(taken)
    assert "\n" not in str(error.value)


def test_what_has_ended_or_not_begun_does_not_step() -> None:
    env = single(learned("car"), reward=lambda *_: (0.0, True)).unwrapped
    with pytest.raises(ModelError, match="copy 0 has not started, or its episode has ended; reset it first"):
        env.step(0)
    env.reset(seed=0)
    assert env.step(0)[2]
    with pytest.raises(ModelError, match="its episode has ended"):
        env.step(0)


def test_a_mask_or_seeds_that_do_not_fit_are_refused() -> None:
    env = many(learned("car"), 3)
    with pytest.raises(ModelError, match=r"there should be one seed, or 3, one for each copy, but there are 2"):
        env.reset(seed=[1, 2])  # type: ignore[arg-type] # seeds for each copy, as SyncVectorEnv takes them
    with pytest.raises(ModelError, match=r"option 'reset_mask' should be an array of 3 booleans, one of them true"):
        env.reset(options={"reset_mask": np.zeros(3, bool)})
