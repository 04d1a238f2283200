"""Policies that are learned in a model: their files, how they learn, how they are played, and what is said of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.numpy
import torch
from builders import CAR
from gymnasium.utils import seeding
from learned_worlds import far_out, learned, many
from learning import CHANGE, drive
from pretended_gpu import GPUS, gpu
from trusted_models import linear_model, write_pair

from addressed_dynamics import load_policy
from addressed_dynamics.base.errors import ModelError, TrainingError
from addressed_dynamics.base.params.recording import DqnBehaviour, EnvironmentParams
from addressed_dynamics.base.torch_runtime import CPU
from addressed_dynamics.evaluation.transitions.calibration import calibrate
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.starting import starts_of
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.policies.learning import greedy_policy, learn_policy
from addressed_dynamics.policies.offline import decisions_of, learn_offline
from addressed_dynamics.policies.playing import (
    play_beside,
    play_in_model,
    play_in_truth,
    played,
    trust_along,
)
from addressed_dynamics.policies.policy import Policy, save_policy
from addressed_dynamics.policies.records import mean_of, score_of
from addressed_dynamics.policies.suite import train_policy, write_outcome
from addressed_dynamics.recording.dqn import dqn_of
from addressed_dynamics.simulators.copies import Copies, all_rows
from addressed_dynamics.simulators.given import Given
from addressed_dynamics.simulators.holding import held_step
from addressed_dynamics.simulators.stable_baselines import StableBaselinesEnvironments
from addressed_dynamics.simulators.starts import write_starts
from addressed_dynamics.simulators.tasks import told
from addressed_dynamics.simulators.worlds import World
from addressed_dynamics.sources.transitions.params import PolicyParams

TRUE = EnvironmentParams(id="MountainCar-v0")
LEARNER = DqnBehaviour(
    kind="dqn", learning_rate=1e-2, batch_size=16, buffer_size=400, learning_starts=8, target_update_interval=16,
    train_every=2, gradient_steps=1, return_steps=2, hidden=(8,),
)  # fmt: skip


def policy(hold: int = 1, seed: int = 0) -> Policy:
    random = np.random.default_rng(seed)
    layers = tuple(
        (random.normal(size=(after, before)).astype(np.float32), random.normal(size=after).astype(np.float32))
        for before, after in ((2, 8), (8, 3))
    )
    centre, reach = np.array([-0.3, 0.0], np.float32), np.array([0.9, 0.07], np.float32)
    return Policy(CAR, hold, centre, reach, layers)


def pusher(action: int, hold: int = 1) -> Policy:
    """Always the same action."""
    bias = np.eye(3, dtype=np.float32)[action]
    return Policy(CAR, hold, np.zeros(2, np.float32), np.ones(2, np.float32), ((np.zeros((3, 2), np.float32), bias),))


def world(history: int = 1, **options: Any) -> World:
    of = learned("car", history)
    return World.of(of.model, starts=of.starts, **{"reward": far_out, "trust": False, **options})


def states(number: int = 50) -> np.ndarray:
    return np.random.default_rng(3).uniform([-1.2, -0.07], [0.6, 0.07], (number, 2)).astype(np.float32)


def test_a_policy_that_was_saved_does_the_same_when_it_is_loaded_and_its_bytes_repeat(tmp_path: Path) -> None:
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        save_policy(tmp_path / name, policy(hold=4))
    again = load_policy(tmp_path / "first")
    assert (again.hold, again.spaces, again.action_names) == (4, CAR, ("push_left", "no_push", "push_right"))
    np.testing.assert_array_equal(again(states()), policy()(states()))
    assert len(np.unique(again(states()))) > 1
    one = again(states()[7].tolist())
    assert isinstance(one, int)
    assert one == again(states())[7]
    for file in (tmp_path / "first").iterdir():
        assert file.read_bytes() == (tmp_path / "second" / file.name).read_bytes()


def test_what_is_no_state_is_refused_in_a_line() -> None:
    for wrong in ([0.0], [[0.0, 1.0, 2.0]], [np.nan, 0.0], np.zeros((1, 1, 2))):
        with pytest.raises(ModelError) as error:
            policy()(wrong)
        assert "\n" not in str(error.value)


def test_a_folder_without_a_policy_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data" / "policies" / "boat").mkdir(parents=True)
    Path("params.yaml").write_text("experiments: {car: {kind: transitions, raw: data/raw/car}}\n")
    with pytest.raises(ModelError, match=r"car: there is no such folder of a policy; 'dvc repro train_policy@car'"):
        load_policy("data/policies/car")
    known = r"nope: there is no such folder of a policy \(experiments of params\.yaml: car; in data/policies: boat\)"
    with pytest.raises(ModelError, match=known):
        load_policy("nope")
    folder = tmp_path / "room"
    write_outcome(folder, None)
    with pytest.raises(ModelError, match="asks for no policy"):
        load_policy(folder)


@pytest.mark.parametrize("damage", ["cut", "other", "gone", "shape"])
def test_damaged_weights_are_an_error_that_says_so(tmp_path: Path, damage: str) -> None:
    save_policy(tmp_path, policy())
    weights = tmp_path / "weights.safetensors"
    if damage == "cut":
        weights.write_bytes(weights.read_bytes()[:100])
    elif damage == "gone":
        weights.unlink()
    elif damage == "other":
        index = json.loads((tmp_path / "policy.json").read_text())
        index["policy"]["layers"] = 3
        (tmp_path / "policy.json").write_text(json.dumps(index))
    else:
        tensors = safetensors.numpy.load_file(weights)
        safetensors.numpy.save_file({**tensors, "layer.1.weight": np.zeros((3, 9), np.float32)}, weights)
    with pytest.raises(ModelError, match="incomplete or damaged"):
        load_policy(tmp_path)


def test_it_does_what_the_learner_would() -> None:
    environments = StableBaselinesEnvironments(many(learned("car"), 2, autoreset_mode="SameStep", reward=far_out))
    model = dqn_of(environments, LEARNER, 5, exploration_share=1.0)
    ours = greedy_policy(model, CAR, 1)
    theirs = model.policy.predict(states(200), deterministic=True)[0]
    np.testing.assert_array_equal(ours(states(200)), theirs)
    with torch.no_grad():
        values = model.policy.q_net(torch.from_numpy(states(200))).numpy()
    np.testing.assert_allclose(ours.values(states(200)), values, atol=1e-5)


def test_the_best_check_is_kept_the_first_of_several_and_the_same_seed_learns_the_same() -> None:
    asked: list[Policy] = []

    def score(each: Policy) -> tuple[float, float]:
        asked.append(each)
        return (-5.0, -2.0, -2.0, -3.0)[(len(asked) - 1) % 4], 0.5

    found = []
    for _ in range(2):
        copies = many(learned("car"), 4, autoreset_mode="SameStep", reward=far_out, max_episode_steps=9)
        made = learn_policy(
            copies, CAR, LEARNER, decisions=80, checks=4, seed=1, score=score, progress=lambda _: None
        )  # fmt: skip
        found.append(made)
    assert [check.decisions for check in found[0].checks] == [20, 40, 60, 80]
    assert found[0].kept == 1
    assert found[0].policy is asked[1]
    first, last = (policy.layers[0][0] for policy in (asked[0], asked[3]))
    assert not np.array_equal(first, last), "it learns"
    for one, other in zip(found[0].policy.layers, found[1].policy.layers, strict=True):
        np.testing.assert_array_equal(one[0], other[0])


def test_a_decision_is_rows_under_one_action_to_the_end_of_the_task() -> None:
    action = np.array([0, 0, 0, 1, 2, 2, 2, 2, 2, 2, 0, 0] + [1] * 9)
    train = replace(drive((12, 9)), action=action)

    def task(state: np.ndarray, taken: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        del taken, after
        return np.arange(len(state), dtype=float), np.arange(len(state)) == 8

    found = decisions_of(train, told(task, "reward"), 3)
    # 0-2; 3 is alone; 4-6; 7-8, where the task ends; 9 is alone; 10-11 end with the episode; then three more.
    assert list(zip(found.first.tolist(), found.last.tolist(), strict=True)) == [
        (0, 2), (4, 6), (7, 8), (12, 14), (15, 17), (18, 20),
    ]  # fmt: skip
    assert found.reward.tolist() == [3.0, 15.0, 15.0, 39.0, 48.0, 57.0]
    assert found.terminated.tolist() == [False, False, True, False, False, False]
    assert found.broken.tolist() == [True, False, False, False, False, True]


@GPUS
def test_a_policy_is_learned_in_an_environment_on_a_device(kind: str) -> None:
    def learn(environments: torch.device, learner: torch.device) -> Policy:
        copies = many(learned("car"), 4, autoreset_mode="SameStep", reward=far_out, max_episode_steps=9,
                      device=environments)  # fmt: skip
        return learn_policy(
            copies, CAR, LEARNER, decisions=80, checks=2, seed=1, score=lambda _: (0.0, 0.0), progress=lambda _: None,
            device=learner,
        ).policy  # fmt: skip

    wanted = learn(CPU, CPU)
    with gpu(kind) as device:
        # What is pretended cannot be made of arrays, as the learner does.
        found = learn(device, device if kind == "real" else CPU)
    for mine, theirs in zip(found.layers, wanted.layers, strict=True):
        np.testing.assert_allclose(mine[0], theirs[0], rtol=1e-2, atol=1e-3)


def test_without_a_world_a_learner_sees_every_recorded_decision_and_learns_the_same_again() -> None:
    train = drive((40, 30))
    found = [
        learn_offline(world(), train, LEARNER, copies=4, decisions=80, seed=2, progress=lambda _: None)
        for _ in range(2)
    ]
    assert found[0][1] == 70
    np.testing.assert_array_equal(found[0][0].layers[0][0], found[1][0].layers[0][0])
    changing = replace(train, action=np.arange(70) % 3)
    with pytest.raises(TrainingError, match="no action is held for 5"):
        learn_offline(
            world(reward=lambda state, *_: (np.zeros(len(state)), np.False_)),
            changing,
            LEARNER.model_copy(update={"frame_skip": 5}),
            copies=4,
            decisions=80,
            seed=2,
            progress=lambda _: None,
        )


def test_actions_that_are_held_are_steps_of_the_model_with_their_rewards_summed() -> None:
    of = learned("car")
    slow = many(of, 3, autoreset_mode="Disabled", reward=far_out, hold=4, exact=True, max_episode_steps=2)
    fast = many(of, 3, autoreset_mode="Disabled", reward=far_out, exact=True)
    before, _ = slow.reset(seed=1)
    np.testing.assert_array_equal(before, fast.reset(seed=1)[0])
    assert slow.metadata["addressed_dynamics"]["step_seconds"] == 4 * CAR.step_seconds
    actions = np.array([0, 2, 1])
    state, reward, terminated, _, _ = slow.step(actions)
    expected, over = np.zeros(3), np.zeros(3, bool)
    last = before
    for _ in range(4):
        for copy in np.flatnonzero(~over):
            after = np.clip(of.model.predict(last[copy], int(actions[copy])), fast.single_observation_space.low,
                            fast.single_observation_space.high)  # fmt: skip
            earned, ends = far_out(last[copy][None], actions[copy][None], after[None])
            expected[copy] += earned[0]
            over[copy] = ends[0]
            last = last.copy()
            last[copy] = after
    np.testing.assert_allclose(state, last, atol=1e-6)
    np.testing.assert_allclose(reward, expected, atol=1e-5)
    np.testing.assert_array_equal(terminated, over)


def test_a_hold_of_no_step_is_refused() -> None:
    with pytest.raises(ModelError, match="hold should be at least 1"):
        world(hold=0)


def test_an_episode_in_the_model_is_its_rewards_to_its_end_or_limit() -> None:
    of, actor = world(exact=True), pusher(2, hold=3)
    found = play_in_model(of, actor, range(5, 11), 10)
    assert found.ended.any()
    assert (found.steps[~found.ended] == 10).all()
    for place, seed in enumerate(range(5, 11)):
        copy = Copies(of, 1, 10)
        copy.generators = [seeding.np_random(seed)[0]]
        copy.start(all_rows(1))
        earned, over = 0.0, False
        while not over:
            stepped = held_step(copy, [2], all_rows(1), 3)
            earned += stepped.reward[0]
            over = bool(stepped.terminated[0] | stepped.truncated[0])
        assert found.returns[place] == pytest.approx(earned)
        assert found.steps[place] == copy.steps[0]


@pytest.mark.parametrize("history", [1, 3])
def test_true_episodes_go_on_in_the_model_from_where_they_were(history: int) -> None:
    of, actor = world(history, exact=True), policy(hold=2)
    episodes = play_in_truth(TRUE, actor, range(3), 11)
    assert [len(each.states) for each in episodes] == [12, 12, 12]
    assert played(episodes).returns.tolist() == [-11.0] * 3
    found = play_beside(of, actor, episodes, 11)
    begin = 0 if history == 1 else 2
    past = history - 1
    given = Given(
        np.stack([each.states[begin - past : begin + 1] for each in episodes]),
        np.stack([each.actions[begin - past : begin] for each in episodes]),
        None,
    )
    after = play_in_model(of, actor, range(3), 11 - begin, given)
    np.testing.assert_allclose(found.returns, after.returns - begin)
    np.testing.assert_array_equal(found.steps, after.steps + begin)


def test_trust_along_true_episodes_is_none_where_nobody_calibrated_it() -> None:
    assert trust_along(world(), play_in_truth(TRUE, policy(), range(2), 5), 1) is None


def test_intervals_hold_the_value_and_are_narrower_of_more_episodes() -> None:
    few, more = (mean_of(np.random.default_rng(1).normal(size=number)) for number in (10, 1000))
    assert few.low < few.value < few.high
    assert more.high - more.low < (few.high - few.low) / 4
    score = score_of(played(play_in_truth(TRUE, policy(), range(3), 5)))
    assert (score.ended.value, score.ended.low) == (0.0, 0.0)
    assert 0.4 < score.ended.high < 0.7  # Wilson's of 0 of 3: 3.84 / (3 + 3.84)


PARAMS = PolicyParams(
    candidate="total_parameters",
    environment=TRUE,
    episode_steps=12,
    copies=4,
    decisions=64,
    checks=2,
    check_episodes=3,
    episodes=5,
    learner=LEARNER,
)


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two straight lines through episodes of a car, with starts and trust."""
    folder = tmp_path_factory.mktemp("models") / "car"
    data, held = drive((40, 60, 50, 40)), drive((50, 40), seed=1)
    features = fit_features(data, CHANGE)
    half = data.episode < 2
    model, partner = (linear_model(features, data.select(rows)) for rows in (half, ~half))
    trust = calibrate(model, partner, Points.of(data, features), Points.of(held, features), steps=10)
    write_pair(folder, model, partner, trust)
    write_starts(folder, starts_of(data, 1))
    return folder


def test_a_policy_is_learned_chosen_and_scored_and_the_same_params_make_the_same_bytes(
    models: Path, tmp_path: Path
) -> None:
    asked = PARAMS.model_copy(update={"reward": "addressed_dynamics.envs:mountain_car_reward"})
    for name in ("first", "second"):
        outcome = train_policy(models, lambda: drive((40, 30)), asked, lambda _: None)
        write_outcome(tmp_path / name, outcome)
    figures = outcome.figures
    assert figures.truth is not None
    assert figures.true_learner is not None
    assert set(outcome.curves) == {"model", "truth"}
    assert {check.decisions for check in outcome.curves["model"].checks} == {32, 64}
    gap = outcome.arrays["returns_truth"] - outcome.arrays["returns_beside"]
    assert figures.gap is not None
    assert figures.gap.value == pytest.approx(gap.mean())
    for file in (tmp_path / "first").iterdir():
        assert file.read_bytes() == (tmp_path / "second" / file.name).read_bytes(), file.name
    np.testing.assert_array_equal(load_policy(tmp_path / "first")(states()), outcome.policy(states()))
    assert figures.trust is not None
    assert figures.trust.decisions == len(outcome.arrays["trust"]) == outcome.arrays["steps_truth"].sum()
    assert figures.trust.low == (outcome.arrays["trust"] < 0.05).mean()


def test_without_an_environment_it_is_scored_in_the_model_alone(models: Path) -> None:
    asked = PARAMS.model_copy(update={"reward": "learned_worlds:far_out", "environment": None})
    outcome = train_policy(models, lambda: drive((40, 30)), asked, lambda _: None)
    assert (outcome.figures.truth, outcome.figures.gap, outcome.figures.true_learner) == (None, None, None)
    assert set(outcome.curves) == {"model"}
    assert {"return/model", "return/model_offline"} <= set(outcome.figures.headline)


def test_what_cannot_be_learned_is_said_before_anything_is(models: Path) -> None:
    with pytest.raises(TrainingError, match="nobody says the reward"):
        train_policy(models, lambda: drive((40,)), PARAMS, lambda _: None)
    other = PARAMS.model_copy(
        update={"reward": "learned_worlds:far_out", "environment": EnvironmentParams(id="CartPole-v1")}
    )
    with pytest.raises(TrainingError, match="CartPole"):
        train_policy(models, lambda: drive((40,)), other, lambda _: None)


def test_params_that_do_not_fit_say_so() -> None:
    for wrong, words in (
        ({"episode_steps": 15, "learner": LEARNER.model_dump() | {"frame_skip": 2}}, "no multiple"),
        ({"decisions": 7, "copies": 4}, "raise it"),
        ({"least_ended": 0.5}, "no environment"),
    ):
        with pytest.raises(ValueError, match=words):
            PolicyParams.model_validate(wrong)
