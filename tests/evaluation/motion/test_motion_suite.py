"""The whole evaluation of motion: what it says of every model, by what it chooses, and what its figures are given."""

import json
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from motion_examples import concatenate, make_clip
from motions import make_motion
from moving_fakes import failing, lively, steady

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.base.files import save_arrays
from addressed_dynamics.base.processes import OrderedMap
from addressed_dynamics.episodes.layout import JOINTS, OUTPUT
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.evaluation.motion import suite
from addressed_dynamics.evaluation.motion.baselines import mean_outputs
from addressed_dynamics.evaluation.motion.candidates import MotionCandidate, reference_candidates
from addressed_dynamics.evaluation.motion.closed_loop.commands import Script, Segment, script
from addressed_dynamics.evaluation.motion.closed_loop.run import Trace, start_pose
from addressed_dynamics.evaluation.motion.one_step import CHUNK_ROWS
from addressed_dynamics.evaluation.motion.suite import (
    SHOWN_JOINTS,
    ClosedLoopPlan,
    MotionData,
    best_model,
    evaluate_motion,
    evaluate_motion_addressing,
    motion_arrays,
    shown_candidates,
    stretch,
)
from addressed_dynamics.features.motion.features import fit_motion_features
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.modes import MODES
from addressed_dynamics.simulators.motion import MotionModel
from addressed_dynamics.simulators.motion_controller import Pose
from addressed_dynamics.simulators.motion_predictor import MotionPredictor
from addressed_dynamics.sources.motion.params import MotionFeatureParams

TRAIN = make_motion(48)
DATA = MotionData(
    TRAIN,
    make_motion(24, seed=1),
    {"test": make_motion(30, clips=("run",), seed=2), "rows": make_motion(5, clips=("walk",), seed=3)},
)
POSE = start_pose(TRAIN)
PLAN = ClosedLoopPlan(3, 2, 2.0, script([Segment(1.0), Segment(2.0, stick=1.0)]))


def candidate(group: str, seed: int | None, predictor: MotionPredictor) -> MotionCandidate:
    return MotionCandidate(group, seed, f"about {group}", 7, predictor)


def ensemble(seed: int) -> list[MotionCandidate]:
    return [candidate(f"ensemble/{mode}", seed, lively(POSE, number)) for number, mode in enumerate(MODES)]


CANDIDATES = [
    *ensemble(0),
    *ensemble(1),
    candidate("phase_functioned", 0, steady(POSE, forward=2.5, phase=0.03)),
    candidate("same_size", 0, steady(POSE)),
    *reference_candidates(TRAIN, DATA.validation, None),
]


def results_of(scores: dict[str, Sequence[tuple[float, float]]]) -> dict[str, Any]:
    """Results of an ensemble with scores on the validation scripts and on the test script, for each mode and seed."""
    return {
        f"ensemble/{mode}/seed-{seed}": {
            "group": f"ensemble/{mode}",
            "seed": seed,
            "closed_loop": {"validation_score": validation, "score": test},
        }
        for mode, seeds in scores.items()
        for seed, (validation, test) in enumerate(seeds)
    }


def longest_run(motion: Motion, steps: int) -> list[tuple[str, int]]:
    """The first longest run of consecutive frames, found frame by frame."""
    runs: list[list[tuple[str, int]]] = []
    for place in zip(motion.clip.tolist(), motion.frame.tolist(), strict=True):
        if runs and runs[-1][-1] == place:
            continue
        if runs and runs[-1][-1] == (place[0], place[1] - 1):
            runs[-1].append(place)
        else:
            runs.append([place])
    return max(runs, key=len)[:steps]


@pytest.fixture(scope="module")
def evaluated() -> tuple[dict[str, Any], dict[str, Any]]:
    return evaluate_motion(CANDIDATES, DATA, PLAN, cores=1)


def test_every_candidate_is_measured_on_every_split_and_in_the_closed_loop(
    evaluated: tuple[dict[str, Any], dict[str, Any]],
) -> None:
    report, traces = evaluated
    names = [each.name for each in CANDIDATES]
    assert list(report["candidates"]) == list(traces) == names
    for each in CANDIDATES:
        result = report["candidates"][each.name]
        assert (result["group"], result["seed"], result["label"]) == (each.group, each.seed, each.label)
        assert result["parameters"] == each.parameters
        assert result["multiply_adds"] == each.multiply_adds
        assert {split: errors["rows"] for split, errors in result["one_step"].items()} == {"test": 30, "rows": 5}
        assert result["closed_loop"]["run"]["seconds"] == 3.0
        assert 0.0 <= result["closed_loop"]["score"] <= 1.0
    assert report["delivered"]["mode"] in MODES
    assert json.loads(json.dumps(report, allow_nan=False))["delivered"] == report["delivered"]


def test_equal_models_get_equal_scores_whatever_stands_beside_them(
    evaluated: tuple[dict[str, Any], dict[str, Any]],
) -> None:
    report, _ = evaluated
    alone, _ = evaluate_motion(ensemble(1), DATA, PLAN, cores=1)
    for mode in MODES:
        together = [report["candidates"][f"ensemble/{mode}/seed-{seed}"]["closed_loop"] for seed in (0, 1)]
        assert together[0]["score"] == pytest.approx(together[1]["score"], abs=1e-6)
        own = alone["candidates"][f"ensemble/{mode}/seed-1"]["closed_loop"]
        assert own["validation_score"] == pytest.approx(together[0]["validation_score"], abs=1e-3)


def test_closed_loops_run_by_networks_and_all_in_one_pool(monkeypatch: pytest.MonkeyPatch) -> None:
    pools, loops = list[int](), list[list[str]]()
    original, pool = suite.closed_loop, suite.worker_processes

    def loop(predictors: dict[str, MotionPredictor], scripts: Sequence[Script], start: Pose) -> dict[str, Trace]:
        loops.append(list(predictors))
        return original(predictors, scripts, start)

    def processes(count: int) -> AbstractContextManager[OrderedMap]:
        pools.append(count)
        return pool(1)

    monkeypatch.setattr(suite, "closed_loop", loop)
    monkeypatch.setattr(suite, "worker_processes", processes)
    single = candidate("same_size", 0, steady(POSE, forward=1.0))
    references = [candidate(name, None, steady(POSE)) for name in ("mean", "persistence")]
    evaluate_motion([*ensemble(0), *ensemble(1), single, *references], DATA, PLAN, cores=64)
    networks = [[each.name for each in ensemble(seed)] for seed in (0, 1)] + [["same_size/seed-0"]]
    assert loops == [*networks, ["mean", "persistence"], *networks]
    assert pools == [len(loops)]


def test_the_mode_is_chosen_by_the_validation_scripts_not_by_the_test() -> None:
    best_on_test = {mode: [(0.1, 0.9), (0.1, 0.9)] for mode in MODES}
    assert best_model(results_of({**best_on_test, "blend": [(0.5, 0.0), (0.2, 0.0)]})) == (0, "blend")


def test_the_best_seed_in_its_best_mode_is_delivered() -> None:
    poor = {mode: [(0.0, 0.0), (0.0, 0.0)] for mode in MODES}
    scores = {**poor, "argmax": [(0.5, 0.0), (0.6, 0.0)], "mixture": [(0.1, 0.0), (0.7, 0.0)]}
    assert best_model(results_of(scores)) == (1, "mixture")


def test_figures_show_the_delivered_ensemble_and_one_of_each_network_that_was_trained_or_published() -> None:
    candidates = [
        *CANDIDATES,
        candidate("phase_functioned", 1, steady(POSE)),
        candidate("released", None, steady(POSE)),
    ]
    shown = [each.name for each in shown_candidates(candidates, 0, "mixture")]
    assert shown == ["ensemble/mixture/seed-0", "phase_functioned/seed-0", "same_size/seed-0", "released"]


def test_a_model_whose_closed_loop_fails_is_judged_as_dead_and_the_others_as_ever(
    evaluated: tuple[dict[str, Any], dict[str, Any]],
) -> None:
    report, _ = evaluated
    # One step ahead, which is asked after the closed loops, a model that answers nothing is damaged.
    dead = candidate("same_size", 0, failing(20, np.inf, steady(POSE, forward=2.5)))
    with pytest.raises(EvaluationError, match=r"'same_size/seed-0' on the frames of 'test': .*not finite"):
        evaluate_motion([*ensemble(0), dead], DATA, PLAN, cores=1)
    dead = candidate("same_size", 0, failing(20, 1e30, steady(POSE, forward=2.5)))
    found, traces = evaluate_motion([*ensemble(0), dead], DATA, PLAN, cores=1)
    own = found["candidates"]["same_size/seed-0"]["closed_loop"]
    assert own["score"] == own["validation_score"] == 0.0
    assert own["run"]["lived_seconds"] == pytest.approx(20 / 60)
    assert own["run"]["alive"] is False
    assert not np.isnan(traces["same_size/seed-0"].joint_position).any()
    json.dumps(found, allow_nan=False)
    assert found["delivered"]["mode"] == report["delivered"]["mode"]


def test_a_frozen_model_is_worth_nothing_where_it_should_move() -> None:
    walk = ClosedLoopPlan(3, 1, 2.0, script([Segment(3.0, stick=1.0)]))
    frozen = candidate("same_size", 0, mean_outputs(TRAIN.y.mean(axis=0)))
    report, _ = evaluate_motion([*ensemble(0), frozen], DATA, walk, cores=1)
    own = report["candidates"]["same_size/seed-0"]["closed_loop"]
    assert own["run"]["lived_seconds"] == 3.0
    assert own["run"]["alive"] is False
    assert own["score"] == 0.0
    json.dumps(report, allow_nan=False)


def test_a_split_without_frames_is_refused_with_its_name() -> None:
    data = MotionData(TRAIN, TRAIN, {"test": TRAIN, "cycles": TRAIN.select(slice(0))})
    with pytest.raises(EvaluationError, match=r"on the frames of 'cycles': there are no frames"):
        evaluate_motion(ensemble(0), data, PLAN, cores=1)


@settings(max_examples=100)
@given(
    shape=st.lists(st.lists(st.integers(2, 6), min_size=1, max_size=3), min_size=1, max_size=3),
    first_frames=st.lists(st.integers(0, 12), min_size=3, max_size=3),
    steps=st.integers(1, 12),
    kept=st.integers(0, 2**32 - 1),
    share=st.sampled_from([0.5, 0.8, 1.0]),
)
def test_a_stretch_is_the_longest_run_of_consecutive_frames_of_one_clip(
    shape: list[list[int]], first_frames: list[int], steps: int, kept: int, share: float
) -> None:
    whole = concatenate(
        [make_clip(f"clip_{n}", lengths, first_frame=first_frames[n]) for n, lengths in enumerate(shape)]
    )
    chosen = np.random.default_rng(kept).random(len(whole)) < share
    chosen[-1] = True
    motion = whole.select(chosen)
    rows = stretch(motion, steps)
    places = list(zip(motion.clip[rows].tolist(), motion.frame[rows].tolist(), strict=True))
    assert places == longest_run(motion, steps)
    assert (np.diff(motion.frame[rows]) == 1).all()
    assert len(set(motion.clip[rows].tolist())) == 1


def test_clips_whose_frames_would_go_on_from_one_to_the_next_are_not_joined() -> None:
    motion = concatenate([make_clip("a", [4]), make_clip("b", [5], first_frame=4)])
    assert motion.clip[stretch(motion, 100)].tolist() == ["b"] * 5


def test_the_arrays_hold_paths_of_joints_and_closed_loops_of_what_is_shown(
    evaluated: tuple[dict[str, Any], dict[str, Any]], tmp_path: Path
) -> None:
    _, traces = evaluated
    shown = shown_candidates(CANDIDATES, 0, "argmax")
    arrays = motion_arrays(shown, traces, DATA)
    test = DATA.held_out["test"]
    rows = stretch(test, 1000)
    assert {name for name in arrays if name.startswith("frames.")} == {
        "frames.true", *(f"frames.{each.name}" for each in shown)
    }  # fmt: skip
    for index, name in enumerate(SHOWN_JOINTS):
        joint = test.y[rows][:, OUTPUT.joint_position].reshape(-1, len(JOINTS), 3)[:, JOINTS.index(name)]
        np.testing.assert_array_equal(arrays["frames.true"][:, index], joint)
    for each in shown:
        assert arrays[f"frames.{each.name}"].shape == (len(rows), len(SHOWN_JOINTS), 3)
        loop = {key.removeprefix(f"loop.{each.name}."): value for key, value in arrays.items() if each.name in key}
        np.testing.assert_array_equal(loop["joint_position"], traces[each.name].joint_position[0])
        assert loop["root_position"].shape == (180, 2)
        assert {len(loop[name]) for name in ("speed", "commanded_speed", "limb_speed", "bone_drift", "living")} == {179}
        assert "lived" not in loop
    save_arrays(tmp_path / "arrays.npz", arrays)
    with np.load(tmp_path / "arrays.npz", allow_pickle=False) as saved:
        assert set(saved) == set(arrays)
        assert all(np.isfinite(saved[name]).all() for name in saved)


def test_no_model_is_given_a_phase_of_one_for_the_figures(evaluated: tuple[dict[str, Any], dict[str, Any]]) -> None:
    phases: list[torch.Tensor] = []

    def predict(x: torch.Tensor, phase: torch.Tensor) -> torch.Tensor:
        phases.append(phase)
        return torch.zeros(len(x), OUTPUT.width)

    motion_arrays([candidate("same_size", 0, predict)], evaluated[1], DATA)
    assert phases[0].max() < 1.0


@pytest.mark.parametrize("loss", ["mae", "mse"])
def test_members_are_compared_by_the_loss_of_normalised_targets_chunk_by_chunk(loss: str) -> None:
    features = fit_motion_features(TRAIN, MotionFeatureParams(target="change"))
    generator = torch.Generator().manual_seed(0)
    model = MotionModel(
        features,
        StackedMLP(3, (342, 8, 311), "elu", generator).requires_grad_(False),
        StackedMLP(1, (342, 8, 3), "elu", generator).requires_grad_(False),
    )
    motion = make_motion(CHUNK_ROWS + 3, clips=("walk",))
    found = evaluate_motion_addressing(model, motion, loss)
    samples = features.samples(motion)
    error = (model.networks(samples.x) - samples.y).double()
    losses = (error.abs() if loss == "mae" else error**2).mean(dim=2)
    assert found["specialisation"]["samples"] == len(motion)
    assert found["specialisation"]["mean_loss"]["all"] == pytest.approx(losses.mean(dim=1).tolist(), rel=1e-4)
    assert sum(found["specialisation"]["addressed"]) == len(motion)
    assert found["phase_use"][0]["gait"] == "all"
    json.dumps(found, allow_nan=False)
