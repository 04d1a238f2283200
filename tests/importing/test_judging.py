"""What is said of imported samples: verdicts, excitation, delays and noise, on systems whose truth is known."""

import numpy as np
import pytest
from foreign_logs import source

from addressed_dynamics.importing.judging import judge_all, judge_episodes, stretches
from addressed_dynamics.importing.samples import Recorded, Samples, find_episodes
from addressed_dynamics.importing.signals import signals_of

SIGNALS = signals_of(
    source(
        observation={"x": {"field": "/s.x"}, "v": {"field": "/s.v"}},
        action={"continuous": {"push": {"field": "/u.push"}, "idle": {"field": "/u.idle"}}},
    )
)
STEP = SIGNALS.spec.step_seconds


def system(steps: int, *, delay: int = 0, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """A damped mass that is pushed at random, `delay` steps late; columns x, v, push, idle."""
    generator = np.random.default_rng(seed)
    push = np.repeat(generator.normal(size=steps // 4 + 1), 4)[:steps]
    x, v = np.zeros(steps), np.zeros(steps)
    for t in range(1, steps):
        acting = push[t - 1 - delay] if t > delay else 0.0
        v[t] = 0.9 * v[t - 1] + 0.3 * acting + noise * generator.normal()
        x[t] = 0.95 * x[t - 1] + 0.1 * v[t - 1]
    return np.column_stack([x, v, push, np.zeros(steps)])


def samples(*parts: np.ndarray) -> Samples:
    values = np.concatenate(parts)
    follows = np.ones(len(values), dtype=np.bool_)
    follows[np.cumsum([0, *map(len, parts)])[:-1]] = False
    return Samples(values, follows, np.zeros(len(values), dtype=np.bool_), {})


def judged(found: Samples, min_length: int = 5) -> list[tuple[str, tuple[str, ...]]]:
    episodes = find_episodes(Recorded.of(found), min_length)
    verdicts = judge_episodes("a", found, episodes, SIGNALS, min_length=min_length, step_seconds=STEP)
    assert [each.number for each in verdicts] == list(range(len(verdicts)))
    assert sum(each.samples for each in verdicts) == len(found.follows)
    return [(each.verdict, each.reasons) for each in verdicts]


def moving(steps: int, seed: int = 0) -> np.ndarray:
    found = system(steps, seed=seed)
    found[:, 3] = np.arange(steps) % 2
    return found


def test_an_episode_is_used_unless_there_is_a_reason() -> None:
    far, still = moving(40, 1), moving(40, 2)
    far[30, 0] = 1e6
    still[10:, :2] = still[10, :2]
    found = judged(samples(moving(40), np.zeros((40, 4)), far, still, moving(3)))
    assert [verdict for verdict, _ in found] == ["use", "leave", "look", "look", "leave"]
    assert found[1][1] == ("no state ever changes",)
    assert found[2][1] == (f"x is far from all its other values 1 times, first at {30 * STEP:.2f} s",)
    assert found[3][1][0].startswith("no state changes in 74% of its steps, first at 1.00 s")
    assert found[4][1] == ("3 samples are fewer than min_length (5)",)


def test_of_no_samples_there_is_no_episode() -> None:
    none = Samples(moving(50)[:0], np.zeros(0, np.bool_), np.zeros(0, np.bool_), {})
    assert judged(none) == []


def test_what_never_changes_is_named() -> None:
    one = moving(40)
    one[:, 1] = 3.0
    one[:, 2] = 1.0
    assert judged(samples(one))[0] == ("look", ("v never changes", "the action push never changes"))


@pytest.mark.parametrize("delay", [0, 1, 4])
def test_the_delay_between_an_action_and_what_it_moves_is_found(delay: int) -> None:
    found = samples(system(600, delay=delay), system(400, delay=delay, seed=1))
    _, delays, _ = judge_all(stretches(found, find_episodes(Recorded.of(found), 2), SIGNALS), SIGNALS)
    assert [(each.action, each.state, each.steps) for each in delays] == [("push", "v", delay)]
    assert delays[0].seconds == pytest.approx(delay * STEP)
    assert delays[0].explained > 0.9


def test_an_action_that_does_nothing_has_no_delay() -> None:
    found = system(2_000, noise=0.1)
    found[:, 2] = np.random.default_rng(9).normal(size=len(found))
    _, delays, _ = judge_all(stretches(samples(found), find_episodes(Recorded.of(samples(found)), 2), SIGNALS), SIGNALS)
    assert delays == []


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.2])
def test_noise_is_told_from_what_can_be_predicted(noise: float) -> None:
    found = samples(*(system(1_500, noise=noise, seed=seed) for seed in range(2)))
    *_, noises = judge_all(stretches(found, find_episodes(Recorded.of(found), 2), SIGNALS), SIGNALS)
    x, v = noises
    assert v.deviation == pytest.approx(noise, abs=0.035)
    assert x.share < 0.2


def test_excitation_says_how_an_action_was_moved() -> None:
    found = samples(system(400))
    (push, idle), *_ = judge_all(stretches(found, find_episodes(Recorded.of(found), 2), SIGNALS), SIGNALS)
    assert push.changing == pytest.approx(0.25, abs=0.01)
    assert (push.values, push.covered > 0.7) == (100, True)
    assert (idle.low, idle.high, idle.changing, idle.values, idle.covered) == (0.0, 0.0, 0.0, 1, 0.0)
