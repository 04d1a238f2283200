"""The spline of phase-functioned networks, and the released network in both of its forms."""

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from motions import make_motion
from pfnn_data import PFNN_DATA, needs_pfnn_data

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.features.motion.features import MotionFeatures
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.networks.files import load_network, save_network
from addressed_dynamics.networks.spline import catmull_rom
from addressed_dynamics.simulators.released import RELEASED_WIDTHS, load_released

PHASES = torch.linspace(-1.5, 2.5, 801, dtype=torch.float64)


def test_at_a_control_point_the_spline_is_that_point() -> None:
    torch.testing.assert_close(catmull_rom(torch.tensor([0.0, 0.25, 0.5, 0.75])), torch.eye(4))


def test_coefficients_add_up_to_one() -> None:
    torch.testing.assert_close(catmull_rom(PHASES).sum(dim=1), torch.ones(len(PHASES), dtype=torch.float64))


def test_the_spline_has_the_period_of_the_phase() -> None:
    torch.testing.assert_close(catmull_rom(PHASES), catmull_rom(PHASES + 1.0))


def test_a_quarter_of_a_cycle_later_the_control_points_have_moved_on_by_one() -> None:
    torch.testing.assert_close(catmull_rom(PHASES + 0.25), catmull_rom(PHASES).roll(1, dims=1))


def test_the_spline_and_its_slope_are_continuous_where_it_meets_a_control_point() -> None:
    step = 1e-6
    at = torch.tensor([0.0, 0.25, 0.5, 0.75], dtype=torch.float64)
    before, here, after = catmull_rom(at - step), catmull_rom(at), catmull_rom(at + step)
    torch.testing.assert_close((here - before) / step, (after - here) / step, atol=1e-3, rtol=0)
    # Halfway between the neighbours, as Catmull-Rom splines have it; the interval is a quarter.
    torch.testing.assert_close(
        (after - before) / (2 * step), 2 * (here.roll(1, 1) - here.roll(-1, 1)), atol=1e-3, rtol=0
    )


def write_control_points(path: Path, **changes: np.ndarray) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(0)
    arrays = {}
    for layer, (inputs, outputs) in enumerate(pairwise(RELEASED_WIDTHS)):
        arrays[f"W{layer}"] = generator.normal(size=(4, outputs, inputs), scale=0.05).astype(np.float32)
        arrays[f"b{layer}"] = generator.normal(size=(4, outputs)).astype(np.float32)
    np.savez(path, **{**arrays, **changes})
    for name, width in {"Xmean": 342, "Xstd": 342, "Ymean": 311, "Ystd": 311}.items():
        generator.uniform(0.5, 1.5, width).astype("<f4").tofile(path.parent / f"{name}.bin")
    return arrays


def write_phases(folder: Path, arrays: dict[str, np.ndarray]) -> None:
    mix = catmull_rom(torch.arange(50, dtype=torch.float64) / 50).numpy()
    for name, points in arrays.items():
        for index, values in enumerate(np.tensordot(mix, points, axes=1).astype("<f4")):
            values.tofile(folder / f"{name}_{index:03d}.bin")


def test_control_points_are_recovered_from_the_weights_at_fifty_phases(tmp_path: Path) -> None:
    arrays = write_control_points(tmp_path / "points.npz")
    write_phases(tmp_path, arrays)
    from_points, from_phases = load_released(tmp_path / "points.npz"), load_released(tmp_path)
    assert from_points.features == from_phases.features
    for name, tensor in from_points.stack.state_dict().items():
        torch.testing.assert_close(from_phases.stack.state_dict()[name], tensor, atol=1e-5, rtol=1e-5)


def test_the_network_at_a_phase_is_the_one_with_the_weights_of_that_phase(tmp_path: Path) -> None:
    arrays = write_control_points(tmp_path / "points.npz")
    network = load_released(tmp_path / "points.npz")
    x, phase = torch.from_numpy(make_motion().x[:5]), torch.tensor([0.0, 0.1, 0.33, 0.7, 0.99])
    hidden = network.features.encode(x)
    output = network.stack.forward_blended(hidden, catmull_rom(phase))
    for row, mix in enumerate(catmull_rom(phase).numpy()):
        value = hidden[row].numpy()
        for layer in range(3):
            weight, bias = (np.tensordot(mix, arrays[f"{kind}{layer}"], axes=1) for kind in "Wb")
            value = weight @ value + bias
            value = np.where(value > 0, value, np.expm1(np.minimum(value, 0))) if layer < 2 else value
        np.testing.assert_allclose(output[row].numpy(), value, rtol=1e-3, atol=1e-3)


def test_a_saved_network_of_motion_is_loaded_with_its_features(tmp_path: Path) -> None:
    write_control_points(tmp_path / "points.npz")
    network = load_released(tmp_path / "points.npz")
    save_network(tmp_path / "network", network)
    loaded = load_network(tmp_path / "network", MotionFeatures)
    assert loaded.features == network.features
    assert torch.equal(loaded.stack.weights[2], network.stack.weights[2])


def test_a_network_of_motion_is_not_taken_for_one_of_an_environment(tmp_path: Path) -> None:
    write_control_points(tmp_path / "points.npz")
    save_network(tmp_path / "network", load_released(tmp_path / "points.npz"))
    with pytest.raises(ModelError, match="a model of motion, but one of transitions was expected"):
        load_network(tmp_path / "network", FeatureSpec)


def test_features_of_an_unknown_kind_are_refused(tmp_path: Path) -> None:
    write_control_points(tmp_path / "points.npz")
    save_network(tmp_path / "network", load_released(tmp_path / "points.npz"))
    config = json.loads((tmp_path / "network" / "config.json").read_text())
    config["features"]["kind"] = "sound"
    (tmp_path / "network" / "config.json").write_text(json.dumps(config))
    with pytest.raises(ModelError, match="unknown kind of features 'sound'"):
        load_network(tmp_path / "network", MotionFeatures)


def test_control_points_of_another_shape_are_refused(tmp_path: Path) -> None:
    write_control_points(tmp_path / "points.npz", W1=np.zeros((4, 3, 3), np.float32))
    with pytest.raises(ModelError, match=r"'W1' should have shape \(4, 512, 512\), but is \(4, 3, 3\)"):
        load_released(tmp_path / "points.npz")


def test_pickled_control_points_are_refused(tmp_path: Path) -> None:
    write_control_points(tmp_path / "points.npz", W1=np.array([object()], dtype=object))
    with pytest.raises(ModelError, match=r"not an \.npz file of control points"):
        load_released(tmp_path / "points.npz")


@pytest.mark.parametrize(("damage", "match"), [
    (lambda path: path.unlink(), "missing or unreadable"),
    (lambda path: path.write_bytes(path.read_bytes()[:-3]), "should hold 311 float32 values, but has 1241 bytes"),
    (lambda path: np.full(311, np.nan, "<f4").tofile(path), "not finite"),
])  # fmt: skip
def test_damaged_statistics_are_refused(tmp_path: Path, damage: Callable[[Path], object], match: str) -> None:
    write_control_points(tmp_path / "points.npz")
    damage(tmp_path / "Ystd.bin")
    with pytest.raises(ModelError, match=match):
        load_released(tmp_path / "points.npz")


@needs_pfnn_data
def test_the_released_network_has_its_known_error_on_the_clips_it_was_trained_on() -> None:
    network = load_released(PFNN_DATA / "released_control_points.npz")
    with np.load(PFNN_DATA / "database_flat.npz") as data:
        x, y, phase = (torch.from_numpy(data[name]) for name in ("Xun", "Yun", "Pun"))
    predicted = network.features.decode(
        network.stack.forward_blended(network.features.encode(x), catmull_rom(phase)), x
    )
    error = (predicted - y).abs()
    assert float(error.mean()) == pytest.approx(0.54, abs=0.03)
    normalised = error / torch.tensor(network.features.target_deviation)
    assert float(normalised.mean()) == pytest.approx(0.19, abs=0.02)
