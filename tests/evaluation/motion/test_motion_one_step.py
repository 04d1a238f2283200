import dataclasses
import json

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from pfnn_data import PFNN_DATA, needs_pfnn_data
from released_network import recorded_motion, released_network

from addressed_dynamics.base.errors import EvaluationError, TrainingError
from addressed_dynamics.episodes.layout import FUTURE_OFFSETS, INPUT, JOINTS, OFFSETS, OUTPUT
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.evaluation.motion.baselines import mean_outputs, persistence_plus_velocity
from addressed_dynamics.evaluation.motion.one_step import (
    CHUNK_ROWS,
    block_deviation,
    one_step_errors,
)
from addressed_dynamics.networks.ridge import fit_ridge, moments, solve

ONES = np.ones(OUTPUT.width)


def motion_of(x: np.ndarray, y: np.ndarray) -> Motion:
    rows = len(x)
    return Motion(
        x.astype(np.float32),
        y.astype(np.float32),
        np.linspace(0.0, 1.0, rows, dtype=np.float32),
        np.full(rows, "clip"),
        np.arange(rows),
        np.zeros(rows, np.int64),
    )


def random_motion(rows: int, seed: int = 0) -> Motion:
    generator = np.random.default_rng(seed)
    return motion_of(generator.normal(size=(rows, INPUT.width)), generator.normal(size=(rows, OUTPUT.width)))


def steady_motion(speed: float, turn: float, seed: int) -> Motion:
    """One frame of a body that goes along a circle and does not move in the frame of its root, made in the world.

    Its root turns by `turn` a frame to the left, and moves by `speed` cm a frame.
    """
    generator = np.random.default_rng(seed)
    body = generator.normal(0.0, 30.0, (31, 3))
    body[0, [0, 2]] = 0.0
    ground = body[:, 2] + 1j * body[:, 0]

    def root(frame: np.ndarray | float) -> np.ndarray:
        angle = np.asarray(frame) * turn
        return np.asarray(frame) * speed if not turn else speed * (np.exp(1j * angle) - 1) / (1j * turn)

    def joints(frame: float) -> np.ndarray:
        return root(frame) + np.exp(1j * frame * turn) * ground

    def seen(points: np.ndarray, frame: float) -> np.ndarray:
        return (points - root(frame)) * np.exp(-1j * frame * turn)

    x, y = np.zeros((1, INPUT.width)), np.zeros((1, OUTPUT.width))
    for values, layout, offsets, origin in ((x, INPUT, OFFSETS, 0), (y, OUTPUT, FUTURE_OFFSETS, 1)):
        frames = origin + np.array(offsets)
        position, direction = seen(root(frames), origin), np.exp(1j * turn * (frames - origin))
        values[:, layout.trajectory_position_x], values[:, layout.trajectory_position_z] = position.imag, position.real
        values[:, layout.trajectory_direction_x], values[:, layout.trajectory_direction_z] = (
            direction.imag,
            direction.real,
        )
    for values, layout, frame in ((x, INPUT, -1), (y, OUTPUT, 0)):
        velocity = (joints(frame + 1) - joints(frame)) * np.exp(-1j * frame * turn)
        zero = np.zeros(31)
        values[:, layout.joint_position] = np.stack([ground.imag, body[:, 1], ground.real], axis=1).ravel()
        values[:, layout.joint_velocity] = np.stack([velocity.imag, zero, velocity.real], axis=1).ravel()
    step = seen(root(1), 0)
    y[:, OUTPUT.root_velocity] = [step.imag, step.real]
    y[:, OUTPUT.root_turn] = -turn
    return motion_of(x, y)


@given(st.floats(-3.0, 3.0), st.integers(0, 100))
@settings(max_examples=20, deadline=None)
def test_persistence_is_exact_for_a_body_that_goes_straight_on(speed: float, seed: int) -> None:
    motion = steady_motion(speed, 0.0, seed)
    errors = one_step_errors(persistence_plus_velocity(np.zeros(OUTPUT.width)), motion, ONES)
    assert errors.raw < 1e-4


def test_persistence_sees_turns_in_the_trajectory() -> None:
    motion = steady_motion(2.0, 0.03, 1)
    errors = {
        block.block: block.raw
        for block in one_step_errors(persistence_plus_velocity(np.zeros(OUTPUT.width)), motion, ONES).blocks
    }
    assert errors["joint_position"] < 0.01
    assert errors["root_turn"] < 1e-4
    assert max(errors["trajectory_position_x"], errors["trajectory_position_z"]) < 0.15
    assert max(errors["trajectory_direction_x"], errors["trajectory_direction_z"]) < 0.001
    # It takes velocities on unturned from their old frame to the new, where they point as far to the right.
    assert errors["joint_velocity"] < 0.06


def test_what_persistence_cannot_know_is_as_on_average() -> None:
    mean = np.arange(OUTPUT.width, dtype=np.float32)
    motion = random_motion(3)
    predicted = persistence_plus_velocity(mean)(torch.from_numpy(motion.x), torch.zeros(3)).numpy()
    for block in ("phase_change", "contact", "joint_rotation"):
        assert (predicted[:, OUTPUT[block]] == mean[OUTPUT[block]]).all()


def test_errors_agree_with_those_of_all_rows_at_once() -> None:
    motion, mean = random_motion(CHUNK_ROWS + 7), np.zeros(OUTPUT.width)
    deviation = np.linspace(0.5, 2.0, OUTPUT.width)
    errors = one_step_errors(mean_outputs(mean), motion, deviation)
    absolute = np.abs(motion.y.astype(np.float64)).mean(axis=0)
    assert errors.rows == CHUNK_ROWS + 7
    assert errors.raw == pytest.approx(absolute.mean())
    assert errors.normalised == pytest.approx((absolute / deviation).mean())
    assert [block.block for block in errors.blocks] == [block.name for block in OUTPUT.blocks]
    contact = next(block for block in errors.blocks if block.block == "contact")
    assert contact.raw == pytest.approx(absolute[OUTPUT.contact].mean())
    assert sum(block.raw * block.columns for block in errors.blocks) == pytest.approx(errors.raw * OUTPUT.width)
    hips = motion.y[:, OUTPUT.joint_position][:, :3]
    assert errors.joints[0].joint == JOINTS[0]
    assert errors.joints[0].position == pytest.approx(np.linalg.norm(hips, axis=1).mean(), rel=1e-5)
    json.dumps(dataclasses.asdict(errors), allow_nan=False)


def test_a_column_that_never_changes_has_no_infinite_error() -> None:
    errors = one_step_errors(mean_outputs(np.zeros(OUTPUT.width)), random_motion(5), np.zeros(OUTPUT.width))
    assert errors.normalised == pytest.approx(1000 * errors.raw)


def test_deviations_are_averaged_over_a_block_and_over_both_axes_of_a_trajectory() -> None:
    y = random_motion(50).y
    deviation = block_deviation(y)
    both = [*range(*OUTPUT.trajectory_position_x.indices(311)), *range(*OUTPUT.trajectory_position_z.indices(311))]
    assert deviation[both] == pytest.approx(y[:, both].std(axis=0).mean(), rel=1e-5)
    assert deviation[OUTPUT.contact] == pytest.approx(y[:, OUTPUT.contact].std(axis=0).mean(), rel=1e-5)


def test_a_model_is_never_given_a_phase_of_one() -> None:
    phases: list[torch.Tensor] = []

    def predict(x: torch.Tensor, phase: torch.Tensor) -> torch.Tensor:
        phases.append(phase)
        return torch.zeros(len(x), OUTPUT.width)

    one_step_errors(predict, random_motion(5), ONES)
    assert phases[0].tolist() == [0.0, 0.25, 0.5, 0.75, 0.0]


def test_what_cannot_be_evaluated_is_refused() -> None:
    fine = mean_outputs(np.zeros(OUTPUT.width))
    with pytest.raises(EvaluationError, match="no frames of motion"):
        one_step_errors(fine, random_motion(0), ONES)
    with pytest.raises(EvaluationError, match="311 numbers"):
        one_step_errors(fine, random_motion(2), np.ones(3))
    with pytest.raises(EvaluationError, match="not finite"):
        one_step_errors(mean_outputs(np.full(OUTPUT.width, np.nan)), random_motion(2), ONES)
    with pytest.raises(EvaluationError, match=r"shape \(2, 311\)"):
        one_step_errors(lambda x, _: x, random_motion(2), ONES)


@pytest.mark.parametrize("penalty", [1e-6, 1e-2, 1.0])
def test_ridge_regression_agrees_with_least_squares_on_rows_for_the_penalty(penalty: float) -> None:
    generator = np.random.default_rng(0)
    x = generator.normal(50.0, [1.0, 10.0, 0.01], (200, 3))
    y = x @ generator.normal(size=(3, 2)) + generator.normal(size=(200, 2))
    (ridge,) = solve(moments([(x[:70], y[:70]), (x[70:], y[70:])]), [penalty])
    scaled = (x - x.mean(0)) / x.std(0)
    rows = np.vstack([scaled, np.sqrt(penalty * len(x)) * np.eye(3)])
    weight = np.linalg.lstsq(rows, np.vstack([y - y.mean(0), np.zeros((3, 2))]), rcond=None)[0] / x.std(0)[:, None]
    expected = (x - x.mean(0)) @ weight + y.mean(0)
    assert ridge(torch.from_numpy(x).float(), torch.zeros(200)).numpy() == pytest.approx(expected, abs=1e-3)


def test_ridge_regression_takes_the_penalty_that_is_best_on_the_validation_rows() -> None:
    generator = np.random.default_rng(1)
    weight = generator.normal(size=(20, 2))
    x, y = (generator.normal(size=(25, width)) for width in (20, 2))
    train, validation = (x, x @ weight + 3 * y), generator.normal(size=(500, 20))
    ridge = fit_ridge(train, (validation, validation @ weight), penalties=[1e-6, 0.3, 1e3])
    assert ridge.penalty == 0.3


def test_inputs_that_never_change_get_no_weight() -> None:
    x = np.random.default_rng(2).normal(size=(30, 3)) * [1.0, 1e-9, 0.0] + 7.0
    (ridge,) = solve(moments([(x, x[:, :1])]), [1e-6])
    assert ridge.weight[1:].abs().max() == 0.0
    assert ridge.weight[0].item() == pytest.approx(1.0, abs=1e-4)


def test_ridge_regression_without_rows_is_refused() -> None:
    nothing = (np.zeros((0, 3)), np.zeros((0, 2)))
    with pytest.raises(TrainingError, match="at least one row"):
        moments([nothing])
    with pytest.raises(TrainingError, match="validation rows"):
        fit_ridge((np.ones((2, 3)), np.ones((2, 2))), nothing)


@needs_pfnn_data
def test_the_released_network_has_its_published_error_on_recorded_motion() -> None:
    deviation = np.fromfile(PFNN_DATA / "Ystd.bin", np.float32)
    errors = one_step_errors(released_network(PFNN_DATA), recorded_motion(PFNN_DATA), deviation)
    assert errors.raw == pytest.approx(0.55, abs=0.01)
    assert errors.normalised == pytest.approx(0.18, abs=0.01)


@needs_pfnn_data
def test_on_a_clip_held_out_persistence_beats_ridge_regression_and_that_the_mean() -> None:
    motion = recorded_motion(PFNN_DATA)
    seen = np.char.startswith(motion.clip, "LocomotionFlat04")
    train, test = motion.select(seen), motion.select(~seen)
    deviation, mean = block_deviation(train.y), train.y.mean(axis=0, dtype=np.float64)
    held_out = train.cycle % 5 == 0
    ridge = fit_ridge((train.x[~held_out], train.y[~held_out]), (train.x[held_out], train.y[held_out]))
    models = {"persistence": persistence_plus_velocity(mean), "ridge": ridge, "mean": mean_outputs(mean)}
    raw = {name: one_step_errors(model, test, deviation).raw for name, model in models.items()}
    assert raw["persistence"] == pytest.approx(0.08, abs=0.01)
    assert 0.2 < raw["ridge"] < 0.35
    assert raw["mean"] == pytest.approx(2.67, abs=0.05)
