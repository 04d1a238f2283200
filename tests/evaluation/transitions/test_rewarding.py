"""Reward and end of steps, learned from logs and judged on episodes that nobody learned from."""

from dataclasses import replace

import numpy as np
import pytest
from trusted_models import drifting

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.evaluation.transitions.rewarding import best_threshold, judge_tasks, learn_task
from addressed_dynamics.simulators.rewards import KeptTask

EDGE = 1.0


def on_the_raft(episodes: int, seed: int, *, ends: bool = True, first: int = 0) -> Transitions:
    """Drifting that is paid for the thrust and the place, and ends beyond an edge, or goes on there."""
    whole = drifting(max(episodes, 1), seed)
    if not episodes:
        return whole.select(slice(0, 0))
    over = (whole.next_observation[:, 0] > EDGE) & ends
    rows = [np.arange(part.start, part.stop) for part in whole.episode_slices()]
    kept = np.concatenate([each[: 1 + int(np.argmax(over[each]))] if over[each].any() else each for each in rows])
    cut = whole.select(kept)
    return replace(
        cut,
        episode=cut.episode + first,
        reward=(cut.next_observation[:, 1] - 0.1 * cut.action[:, 0]).astype(np.float32),
        terminated=over[kept],
        truncated=cut.truncated & ~over[kept],
    )


def segments(*parts: tuple[Transitions, str]) -> dict[int, str]:
    return {int(episode): name for part, name in parts for episode in np.unique(part.episode)}


def known(_: np.ndarray, action: np.ndarray, next_state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return next_state[:, 1] - 0.1 * action[:, 0], next_state[:, 0] > EDGE


def test_reward_and_end_are_learned_and_judged_on_other_episodes_beside_a_known_function() -> None:
    train, validation, test = on_the_raft(120, 0), on_the_raft(30, 1, first=500), on_the_raft(40, 2, first=900)
    names = segments((train, "raft"), (validation, "raft"), (test, "raft"))
    task, telling = learn_task(train, validation, names)
    record = judge_tasks(KeptTask("test_rewarding:known", task), telling, train, test, names)
    assert (record.reward_source, record.end_source) == ("test_rewarding:known",) * 2
    assert record.ends_in_training == train.terminated.sum() > 20
    own, function = record.judged["learned"], record.judged["test_rewarding:known"]
    assert (function.false_ends, function.missed_ends) == (0, 0)
    assert function.reward_rmse == pytest.approx(0.0, abs=1e-6)
    assert own.ends == test.terminated.sum() > 5
    assert own.ends + own.steps_that_go_on == own.steps == len(test)
    assert own.reward_rmse < 0.2 * record.reward_deviation
    assert own.false_ends_per_thousand < 30
    assert own.missed_ends_per_thousand < 350
    alone = judge_tasks(KeptTask(None, task), telling, train, test, names)
    assert (alone.reward_source, alone.end_source, list(alone.judged)) == ("learned", "learned", ["learned"])


def test_a_segment_that_never_ends_has_no_part_in_ends_where_others_have_some() -> None:
    train, endless = on_the_raft(60, 0), on_the_raft(20, 3, ends=False, first=100)
    both = Transitions.concatenate([train, endless])
    names = segments((train, "raft"), (endless, "ocean"))
    assert (endless.next_observation[:, 0] > EDGE).any()
    task, telling = learn_task(both, on_the_raft(0, 1), names)
    assert (telling.telling, telling.silent) == ({"raft"}, {"ocean": len(endless)})
    record = judge_tasks(KeptTask(None, task), telling, both, both, names)
    assert record.judged["learned"].ends + record.judged["learned"].steps_that_go_on == len(train)
    assert record.judged["learned"].steps == len(both)
    assert record.judged["learned"].missed_ends_per_thousand < 200


def test_without_rewards_and_ends_nobody_says_them() -> None:
    train = drifting(4, 0)
    task, telling = learn_task(train, drifting(2, 1), dict.fromkeys(range(4), "sea"))
    assert (task.reward, task.end, task.sources) == (None, None, ("none", "none"))
    reward, ends = task(train.observation, train.action, train.next_observation, train.exogenous)
    assert not reward.any()
    assert not ends.any()
    record = judge_tasks(KeptTask(None, task), telling, train, train, dict.fromkeys(range(4), "sea"))
    judged = record.judged["learned"]
    assert (judged.reward_rmse, judged.false_ends_per_thousand, judged.missed_ends_per_thousand) == (None, None, None)


def test_a_reward_that_is_the_same_in_every_step_is_said_to_the_bit() -> None:
    train = replace(drifting(4, 0), reward=np.full(160, -0.3, np.float32))
    task, telling = learn_task(train, train, dict.fromkeys(range(4), "sea"))
    assert (task.reward, task.sources) == (None, ("learned", "none"))
    assert judge_tasks(KeptTask(None, task), telling, train, train, dict.fromkeys(range(4), "sea")).judged[
        "learned"
    ].reward_largest_error == pytest.approx(0.0, abs=1e-7)


def test_learning_twice_gives_the_same_networks() -> None:
    train = on_the_raft(20, 0)
    names = segments((train, "raft"))
    x = train.observation, train.action, train.next_observation, train.exogenous
    first, second = (learn_task(train, train, names)[0] for _ in range(2))
    assert first.threshold == second.threshold
    np.testing.assert_array_equal(first(*x)[0], second(*x)[0])


def test_a_threshold_costs_least_of_all() -> None:
    generator = np.random.default_rng(0)
    ended = generator.random(400) < 0.05
    score = generator.standard_normal(400) + 2.0 * ended
    found, weight = best_threshold(score, ended), np.sqrt((~ended).sum() / ended.sum())

    def cost(threshold: float) -> float:
        return weight * (score[ended] <= threshold).sum() + (score[~ended] > threshold).sum()

    assert cost(found) == min(cost(each) for each in [*score, score.min() - 1.0])
    apart = np.array([0.0, 1.0, 5.0])
    assert best_threshold(apart, np.array([False, False, True])) == 3.0


def test_a_named_function_that_there_is_not_is_refused() -> None:
    train = drifting(2, 0)
    task, telling = learn_task(train, train, dict.fromkeys(range(2), "sea"))
    with pytest.raises(ModelError, match=r"evaluation.reward: there is no function 'test_rewarding:unknown'"):
        judge_tasks(KeptTask("test_rewarding:unknown", task), telling, train, train, dict.fromkeys(range(2), "sea"))
