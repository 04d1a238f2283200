import math
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from projects import errors_by_episode

from addressed_dynamics.comparing.intervals import one_step_beside, rollouts_beside
from addressed_dynamics.comparing.versions import EpisodeErrors
from addressed_dynamics.evaluation.common.bootstrap import ratio_of_medians, ratio_of_sums

MODEL = "ensemble/argmax"


def errors(factor: float = 1.0, spread: float = 0.0, episodes: int = 40) -> EpisodeErrors:
    found = EpisodeErrors.of(errors_by_episode(factor, spread, episodes))
    assert found is not None
    return found


def test_on_the_same_episodes_it_is_the_paired_bootstrap_of_the_evaluation() -> None:
    first, second = errors(), errors(0.7, 0.5)
    found = one_step_beside(first, MODEL, second, MODEL, same_data=True)
    assert found is not None
    oracle = ratio_of_sums(second.one_step[MODEL], first.one_step[MODEL], first.episode)
    assert found.paired
    assert found.ratio is not None
    assert oracle is not None
    assert asdict(found.ratio) == pytest.approx(asdict(oracle))
    weights = np.array([0.25, 0.1])
    rolled = rollouts_beside(first, MODEL, second, MODEL, weights, same_data=True)
    assert rolled is not None
    sides = (second.rollouts[MODEL] @ weights, first.rollouts[MODEL] @ weights)
    oracle = ratio_of_medians(*sides, first.rollout_episode)
    assert rolled.ratio is not None
    assert oracle is not None
    assert asdict(rolled.ratio) == pytest.approx(asdict(oracle))


@settings(max_examples=20, deadline=None)
@given(factor=st.floats(0.05, 20.0))
def test_a_model_that_is_worse_by_the_same_factor_everywhere_has_that_factor_and_no_width(factor: float) -> None:
    found = one_step_beside(errors(), MODEL, errors(factor), MODEL, same_data=True)
    assert found is not None
    assert found.ratio is not None
    assert found.ratio.value == pytest.approx(factor)
    assert (found.ratio.low, found.ratio.high) == (pytest.approx(factor), pytest.approx(factor))


def test_without_the_same_data_each_draws_its_own_episodes_and_the_interval_is_wider() -> None:
    first, second = errors(), errors(0.8)
    paired = one_step_beside(first, MODEL, second, MODEL, same_data=True)
    unpaired = one_step_beside(first, MODEL, second, MODEL, same_data=False)
    assert paired is not None
    assert unpaired is not None
    assert paired.ratio is not None
    assert unpaired.ratio is not None
    assert not unpaired.paired
    assert unpaired.ratio.value == pytest.approx(paired.ratio.value)
    assert unpaired.ratio.low < 0.8 < unpaired.ratio.high


def test_models_of_other_histories_are_paired_on_the_episodes_that_both_have() -> None:
    first, second = errors(), errors(0.5)
    fewer = EpisodeErrors(
        second.episode[5:], second.samples[5:] - 3, {MODEL: second.one_step[MODEL][5:]},
        second.rollout_episode, second.rollouts, second.scale,
    )  # fmt: skip
    found = one_step_beside(first, MODEL, fewer, MODEL, same_data=True)
    assert found is not None
    assert found.ratio is not None
    assert found.first == pytest.approx(first.one_step[MODEL][5:].sum() / first.samples[5:].sum())
    assert found.ratio.value == pytest.approx(0.5 * 25 / 22)


def test_rollouts_that_begin_otherwise_are_not_paired() -> None:
    first, second = errors(), errors(0.8)
    moved = {**second.rollouts, "persistence/seed-0": second.rollouts["persistence/seed-0"] * 1.01}
    others = EpisodeErrors(second.episode, second.samples, second.one_step, second.rollout_episode, moved, second.scale)
    found = rollouts_beside(first, MODEL, others, MODEL, np.ones(2), same_data=True)
    assert found is not None
    assert not found.paired


def test_four_episodes_have_no_interval() -> None:
    found = one_step_beside(errors(episodes=4), MODEL, errors(0.5, episodes=4), MODEL, same_data=True)
    assert found is not None
    assert found.ratio is None
    assert math.isclose(found.second, 0.5 * found.first)
