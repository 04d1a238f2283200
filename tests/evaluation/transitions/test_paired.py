"""Errors by held-out episode, and in multiples of the addressed ensemble's."""

import numpy as np
import pytest
import torch
from builders import CAR

from addressed_dynamics.evaluation.common.bootstrap import ratio_of_medians
from addressed_dynamics.evaluation.transitions.paired import PairedErrors, paired_errors
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts
from addressed_dynamics.features.common.spool import IN_MEMORY

OWN, OTHER = "ensemble/argmax", "linear/seed-0"


class PointsOf:
    """Points of which only the episodes are asked."""

    scratch, run = IN_MEMORY, Points.run

    def __init__(self, episode: list[int]) -> None:
        self.episode = np.array(episode)
        self.begins = np.append(np.flatnonzero(np.diff(episode, prepend=-1)), len(episode))

    def __len__(self) -> int:
        return len(self.episode)


def truth(states: np.ndarray, episode: np.ndarray | None = None) -> TrueRollouts:
    rollouts, steps = states.shape[0], states.shape[1] - 1
    history = states[:, :1], np.zeros((rollouts, 0), dtype=np.int64)
    everything = {"all": np.ones(rollouts, dtype=np.bool_)}
    return TrueRollouts(states, np.zeros((rollouts, steps), dtype=np.int64), *history, everything, episode=episode)


def test_losses_are_summed_over_the_points_of_each_episode() -> None:
    losses = {OWN: torch.tensor([1.0, 4.0, 2.0, 8.0]), OTHER: torch.tensor([1.0, 0.0, 0.0, 3.0])}
    found = paired_errors(losses, PointsOf([7, 7, 3, 3]), {OWN: np.zeros((1, 1, 1))}, truth(np.zeros((1, 2, 1))))
    assert found.episode.tolist() == [3, 7]
    assert found.samples.tolist() == [2, 2]
    assert {name: each.tolist() for name, each in found.one_step.items()} == {OWN: [10.0, 5.0], OTHER: [3.0, 1.0]}


def test_errors_of_rollouts_are_means_over_their_steps_and_a_rollout_that_flies_off_counts() -> None:
    states = np.zeros((2, 3, 2))
    predicted = np.array([[[1.0, 0.0], [3.0, 2.0]], [[np.nan, 0.0], [0.0, 0.0]]])
    found = paired_errors({OWN: torch.ones(1)}, PointsOf([0]), {OWN: predicted}, truth(states, np.array([5, 5])))
    np.testing.assert_allclose(found.rollouts[OWN], [[5.0, 2.0], [0.5e12, 0.0]])
    assert found.rollout_episode.tolist() == [5, 5]


def test_beside_an_environment_each_rollout_is_an_episode_of_its_own() -> None:
    found = paired_errors({OWN: torch.ones(1)}, PointsOf([0]), {OWN: np.ones((3, 1, 1))}, truth(np.zeros((3, 2, 1))))
    assert found.rollout_episode.tolist() == [0, 1, 2]


def errors(times: float = 2.0, episodes: int = 30) -> PairedErrors:
    generator = np.random.default_rng(0)
    sums, rollouts = generator.gamma(1.0, 1.0, episodes), generator.gamma(1.0, 1.0, (episodes, 2))
    numbers = np.arange(episodes)
    return PairedErrors(
        numbers,
        np.ones_like(numbers),
        {OWN: sums, OTHER: times * sums, "ensemble/mean": sums},
        numbers,
        {OWN: rollouts, OTHER: rollouts * [1.0, times]},
    )


def test_a_model_with_twice_the_error_in_every_episode_has_twice_the_error_for_sure() -> None:
    found = errors().beside(OWN, CAR.observation_names, (1.0, 1e6))[OTHER]
    assert found["one_step"] == pytest.approx({"value": 2.0, "low": 2.0, "high": 2.0})
    assert found["dimensions"]["velocity"] == pytest.approx({"value": 2.0, "low": 2.0, "high": 2.0})
    assert found["dimensions"]["position"] == {"value": 1.0, "low": 1.0, "high": 1.0}
    # Of the other dimension's range an error is nothing.
    assert found["rollouts"] == pytest.approx({"value": 1.0, "low": 1.0, "high": 1.0}, abs=1e-6)


def test_the_ensemble_beside_itself_is_exactly_one_and_what_is_not_rolled_out_has_no_ratio() -> None:
    found = errors().beside(OWN, CAR.observation_names, (1.0, 1.0))
    one = {"value": 1.0, "low": 1.0, "high": 1.0}
    assert found[OWN] == {"one_step": one, "rollouts": one, "dimensions": {"position": one, "velocity": one}}
    assert found["ensemble/mean"]["one_step"] == one
    assert found["ensemble/mean"]["rollouts"] is None


def test_few_episodes_have_no_ratios() -> None:
    found = errors(episodes=4).beside(OWN, CAR.observation_names, (1.0, 1.0))[OTHER]
    nothing = {"one_step": None, "rollouts": None, "dimensions": dict.fromkeys(("position", "velocity"))}
    assert found == nothing


def test_few_rollouts_have_no_ratios_whatever_the_number_of_episodes() -> None:
    found = errors(episodes=19).beside(OWN, CAR.observation_names, (1.0, 1.0))[OTHER]
    assert found["one_step"] == pytest.approx({"value": 2.0, "low": 2.0, "high": 2.0})
    assert found["rollouts"] is None
    assert found["dimensions"] == dict.fromkeys(("position", "velocity"))


def test_what_is_drawn_are_episodes_and_not_their_rollouts() -> None:
    generator = np.random.default_rng(0)
    own, other = generator.gamma(1.0, 1.0, (2, 6, 1)), generator.gamma(1.0, 1.0, (2, 6, 1))
    episode = np.arange(6)
    few = PairedErrors(episode, np.ones(6, np.int64), {OWN: np.ones(6), OTHER: np.ones(6)}, np.repeat(episode, 4), {
        OWN: np.repeat(own[0], 4, axis=0), OTHER: np.repeat(other[0], 4, axis=0)
    })  # fmt: skip
    found = few.beside(OWN, ("position",), (1.0,))[OTHER]["rollouts"]
    # Four equal rollouts of each episode tell as much as one of each.
    expected = ratio_of_medians(other[0, :, 0], own[0, :, 0], episode)
    assert (found["value"], found["low"], found["high"]) == pytest.approx((expected.value, expected.low, expected.high))


def test_the_arrays_hold_all_that_the_ratios_are_made_of() -> None:
    found = errors().arrays()
    assert found["paired_candidates"].tolist() == [OWN, OTHER, "ensemble/mean"]
    assert found["paired_one_step"].shape == (3, 30)
    assert found["paired_rollout_candidates"].tolist() == [OWN, OTHER]
    assert found["paired_rollouts"].shape == (2, 30, 2)
    assert all(array.dtype.kind in "iufU" for array in found.values())
