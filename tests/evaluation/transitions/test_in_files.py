"""What belongs to each point may lie in files, and is looked at block by block: all that is found is the same."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from learning import drive, untrained_model
from test_rewarding import EDGE, on_the_raft
from trusted_models import drifting, trusted_model

from addressed_dynamics.base.errors import TransitionsError
from addressed_dynamics.episodes.parquet import joined
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.evaluation.transitions.calibration import shuffled, stretches
from addressed_dynamics.evaluation.transitions.candidates import ensemble_candidates, recorded_change
from addressed_dynamics.evaluation.transitions.hindsight import evaluate_guesses, evaluate_oracle
from addressed_dynamics.evaluation.transitions.measures.explained import measure
from addressed_dynamics.evaluation.transitions.noise_floor import noise_floor
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.repeats import repeats
from addressed_dynamics.evaluation.transitions.rewarding import Telling, best_threshold, judge_tasks
from addressed_dynamics.evaluation.transitions.rollouts import roll_out, seen_range
from addressed_dynamics.evaluation.transitions.suite import (
    evaluate_addressing,
    evaluate_candidates,
    evaluate_specialisation,
    figure_arrays,
    held_out,
    predicted_states,
)
from addressed_dynamics.evaluation.transitions.trusting import Pair, judge_trust
from addressed_dynamics.evaluation.transitions.truth import replay_recorded
from addressed_dynamics.features.common import spool
from addressed_dynamics.features.common.spool import IN_MEMORY, Scratch, Spool
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.simulators.delivery import Origin
from addressed_dynamics.simulators.rewards import KeptTask
from addressed_dynamics.sources.transitions.params import RecordedRollouts, ShiftParams

ROWS = 7
"""Rows of a block; episodes go on from one to the next."""
TRAIN, TEST = drive((40, 60, 50)), drive((1, 30, 2, 45, 20), seed=1)


def same(found: Any, expected: Any) -> None:
    """Check that two results have the same bytes."""
    assert type(found) is type(expected)
    if isinstance(expected, dict):
        assert list(found) == list(expected)
        for name in expected:
            same(found[name], expected[name])
    elif isinstance(expected, list | tuple):
        assert len(found) == len(expected)
        for each, other in zip(found, expected, strict=True):
            same(each, other)
    elif isinstance(expected, np.ndarray):
        assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
        assert found.tobytes() == expected.tobytes()
    else:
        assert found == expected


@pytest.fixture
def both_ways(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[Scratch], Any]], None]:
    """Return what checks that a function finds the same in memory and in files, of which nothing is left."""

    def check(function: Callable[[Scratch], Any]) -> None:
        expected = function(IN_MEMORY)
        scratch = Spool(tmp_path / "scratch", 0).scratch(1)
        monkeypatch.setattr(spool, "BLOCK_ROWS", ROWS)
        same(function(scratch), expected)
        assert list((tmp_path / "scratch").iterdir()) == []

    return check


def in_(scratch: Scratch, transitions: Transitions, features: FeatureSpec) -> Points:
    parts = [transitions.select(slice(first, first + ROWS)) for first in range(0, len(transitions), ROWS)]
    return Points.of(joined(parts, len(transitions), scratch.like), features, scratch=scratch)


@pytest.mark.parametrize("history", [1, 3])
def test_one_step_ahead(both_ways, history: int) -> None:
    model, other = (untrained_model(TRAIN, 3, seed=seed, history=history) for seed in (0, 1))
    rollouts = RecordedRollouts(kind="recorded", episodes=4, steps=10, seed=0)
    truth = replay_recorded(rollouts, TEST, history, dict.fromkeys(range(9), "car"))

    def found(scratch: Scratch) -> Any:
        # Anew, for one of them draws its members.
        candidates = ensemble_candidates({0: {"plain": model}, 1: {"plain": other}}, {0: "plain", 1: "plain"})
        candidates += recorded_change(model.features)
        predicted = roll_out(candidates[:2], truth, cores=1)
        train, test = in_(scratch, TRAIN, model.features), in_(scratch, TEST, model.features)
        results, *_, paired = evaluate_candidates(
            candidates, test, truth, rollouts, "mae", predicted, seen_range(train.transitions), {}
        )
        shown = predicted["ensemble/argmax"]
        return {
            "held_out": held_out(test),
            "table": evaluate_addressing(model, test, "mse"),
            "specialisation": evaluate_specialisation(model, test, "mse"),
            "hindsight": [evaluate(model, test, "mse") for evaluate in (evaluate_oracle, evaluate_guesses)],
            "results": results,
            "paired": paired.arrays(),
            "noise": noise_floor(train, test, "mse"),
            "repeats": repeats(train, test, predicted_states(candidates[0], test)),
            "explained": [row.value for row in measure(candidates[0], test)],
            "arrays": figure_arrays(model, other.ensemble, test, truth, shown, "mse"),
        }

    both_ways(found)


def test_trust(both_ways) -> None:
    model, partner, trust = trusted_model()
    pair = Pair(model, Origin("total_parameters", 0), partner, Origin("total_parameters", 1))
    shifts = {"far": drifting(3, 6, scale=30.0), "strong": drifting(3, 7, gain=1.5)}
    kinds = [
        ShiftParams.model_construct(name=name, kind=kind) for name, kind in (("far", "starts"), ("strong", "mechanics"))
    ]
    errors = {"model": np.array([0.1, 0.5]), "persistence": np.array([0.2, 0.4])}

    def found(scratch: Scratch) -> Any:
        points = {
            "validation": in_(scratch, drifting(5, 1), model.features),
            "test": in_(scratch, drifting(6, 5), model.features),
        }
        ways = stretches(points["test"], 12, 9, "some")
        return *judge_trust(pair, trust, points, shifts, kinds, errors), ways.states.numpy(), ways.episode

    both_ways(found)


def test_reward_and_end(both_ways) -> None:
    test = on_the_raft(8, 2)
    assert test.terminated.any()
    names = {each: "raft" if each % 3 else "elsewhere" for each in range(8)}
    telling = Telling(frozenset({"raft"}), {})
    score = test.next_observation[:, 0].round(1).astype(np.float64)

    def found(scratch: Scratch) -> Any:
        given = joined([test], len(test), scratch.like)
        record = judge_tasks(KeptTask("test_rewarding:known", None), telling, test, given, names, scratch)
        assert record.judged["test_rewarding:known"].steps_that_go_on < len(test)
        return record.model_dump(), best_threshold(score, test.next_observation[:, 0] > EDGE, scratch)

    both_ways(found)


def test_what_is_drawn(both_ways) -> None:
    both_ways(lambda scratch: shuffled(1000, "some", scratch))
    assert sorted(shuffled(50, "some", IN_MEMORY).tolist()) == list(range(50))


def test_transitions_are_checked_across_blocks_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("addressed_dynamics.episodes.transitions.CHECKED_ROWS", ROWS)
    assert len(replace(TEST)) == len(TEST)
    for row in (2 * ROWS - 1, 2 * ROWS):
        state = TEST.observation.copy()
        state[row] += 0.01
        with pytest.raises(TransitionsError, match=rf"row {row - 1} .* is not the observation of the step after it"):
            replace(TEST, observation=state)
        state[row] = np.nan
        with pytest.raises(TransitionsError, match=rf"not finite in row {row}:"):
            replace(TEST, observation=state)


def test_a_split_that_memory_holds_is_in_no_file(tmp_path: Path) -> None:
    assert Spool(tmp_path / "none", 10).scratch(10) is IN_MEMORY
    mapped = Spool(tmp_path / "some", 10).scratch(11)(4, torch.int64)
    mapped[:] = 5
    assert mapped.tolist() == [5] * 4
    assert not (tmp_path / "none").exists()
