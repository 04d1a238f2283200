"""A model in a file for other runtimes predicts what it predicts, or there is no file."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from learning import drive, sail, swing, untrained_model
from motions import make_motion
from typer.testing import CliRunner

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.cli.main import app
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.motion.features import fit_motion_features
from addressed_dynamics.networks.files import SavedNetwork, save_network
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators import exporting
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.exporting import METADATA, TOLERANCE, export_model
from addressed_dynamics.simulators.modes import Mode
from addressed_dynamics.simulators.motion import MotionMode, MotionModel
from addressed_dynamics.simulators.portable import StepModule
from addressed_dynamics.sources.motion.params import MotionFeatureParams

WORLDS: dict[str, Callable[[], Transitions]] = {"car": drive, "arm": swing, "boat": sail}


def write_model(folder: Path, model: AddressedDynamics) -> Path:
    save_network(folder / "network", SavedNetwork(model.ensemble, model.features, {}))
    if model.addressing is not None:
        save_network(folder / "addressing", SavedNetwork(model.addressing, model.features, {}))
    return folder


def motion_model(mode: MotionMode) -> MotionModel:
    def stack(members: int, *widths: int, seed: int = 0) -> StackedMLP:
        return StackedMLP(members, widths, "elu", torch.Generator().manual_seed(seed)).requires_grad_(False)

    features = fit_motion_features(make_motion(rows=24), MotionFeatureParams(target="change"))
    addressing = None if mode == "phase" else stack(1, 342, 8, 4, seed=1)
    return MotionModel(features, stack(4, 342, 8, 311), addressing, mode=mode)


def onnx_session(path: Path) -> Any:
    runtime = pytest.importorskip("onnxruntime", reason="the extra 'export' is not installed")
    return runtime.InferenceSession(path, providers=["CPUExecutionProvider"])


@pytest.mark.parametrize("mode", ["argmax", "mixture", "blend"])
@pytest.mark.parametrize("history", [1, 3])
@pytest.mark.parametrize("world", WORLDS)
def test_a_program_of_torch_predicts_what_the_model_does(tmp_path: Path, world: str, history: int, mode: Mode) -> None:
    model = untrained_model(WORLDS[world](), history=history)
    done = export_model(write_model(tmp_path / "model", model), tmp_path / "step.pt2", "pt2", mode=mode)
    assert done.difference <= TOLERANCE
    extra = {METADATA: ""}
    with done.path.open("rb") as file:
        torch.export.load(file, extra_files=extra)
    said = json.loads(extra[METADATA])
    assert (said["kind"], said["mode"], said["history"]) == ("transitions", mode, history)
    assert said["spaces"] == model.features.spaces.to_json()


@pytest.mark.parametrize("history", [1, 3])
def test_onnx_runtime_predicts_what_the_model_does_for_any_batch(tmp_path: Path, history: int) -> None:
    world = drive()
    model = untrained_model(world, history=history)
    path = export_model(write_model(tmp_path / "model", model), tmp_path / "step.onnx", "onnx").path
    session = onnx_session(path)
    rows = np.arange(7)[:, None] + np.arange(history) if history > 1 else np.arange(7)
    for some in (rows, rows[:1]):
        given = {"observation": world.observation[some], "action": world.action[some]}
        (found,) = session.run(None, given)
        np.testing.assert_allclose(found, model.predict(*given.values()), rtol=1e-5, atol=1e-6)
    said = session.get_modelmeta().custom_metadata_map
    assert json.loads(said["spaces"]) == model.features.spaces.to_json()
    assert (said["kind"], said["mode"]) == ("transitions", "argmax")


def test_members_that_score_the_same_are_chosen_alike_everywhere(tmp_path: Path) -> None:
    world = drive()
    model = untrained_model(world)
    assert model.addressing is not None
    for parameter in (model.addressing.weights[-1], model.addressing.biases[-1]):
        parameter.copy_(parameter[..., :1].expand_as(parameter))
    given = {"observation": world.observation, "action": world.action}
    assert set(model.address(*given.values())) == {0}
    session = onnx_session(export_model(write_model(tmp_path / "m", model), tmp_path / "m.onnx", "onnx").path)
    (found,) = session.run(None, given)
    np.testing.assert_allclose(found, model.predict(*given.values()), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("mode", ["argmax", "mixture", "blend", "phase"])
def test_a_motion_model_is_exported_with_the_layout_of_its_columns(tmp_path: Path, mode: MotionMode) -> None:
    motion_model(mode).save(tmp_path / "model", {})
    done = export_model(tmp_path / "model", tmp_path / "step.pt2", "pt2")
    assert done.difference <= TOLERANCE
    assert done.inputs == {"x": ("B", "342"), **({"phase": ("B",)} if mode == "phase" else {})}
    extra = {METADATA: ""}
    with done.path.open("rb") as file:
        torch.export.load(file, extra_files=extra)
    layout = json.loads(extra[METADATA])["layout"]
    assert {name: sum(block["width"] for block in blocks) for name, blocks in layout.items()} == {"x": 342, "y": 311}


def test_a_step_has_the_gradient_that_differences_give() -> None:
    world = swing()
    model = untrained_model(world, members=2)
    module, small = StepModule(model), 1e-2
    state, action = (torch.from_numpy(each[:1]).requires_grad_() for each in (world.observation, world.action))
    module(state, action)[0, 1].backward()
    assert action.grad is not None
    for component in range(2):
        moved = torch.zeros_like(action).index_fill_(1, torch.tensor([component]), small)
        with torch.no_grad():
            ahead, behind = module(state, action + moved)[0, 1], module(state, action - moved)[0, 1]
        assert float(action.grad[0, component]) == pytest.approx(float(ahead - behind) / (2 * small), abs=1e-3)


def test_what_differs_from_the_model_is_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_model(tmp_path / "model", untrained_model(drive()))
    monkeypatch.setattr(exporting, "_difference", lambda *_: 1e-3)
    with pytest.raises(ModelError, match=r"step\.pt2: not written, for what was exported is off by 1\.0e-03"):
        export_model(folder, tmp_path / "step.pt2", "pt2")
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


def test_what_an_exporter_raises_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        raise RuntimeError("no such operator\nand more of it")

    folder = write_model(tmp_path / "model", untrained_model(drive()))
    monkeypatch.setattr(exporting, "_write_program", fail)
    with pytest.raises(ModelError, match=r"cannot be exported to pt2 \(no such operator\)$"):
        export_model(folder, tmp_path / "step.pt2", "pt2")
    assert not (tmp_path / "step.pt2").exists()


def test_a_full_disk_is_said_of_the_file_that_was_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_subject: Any, path: Path) -> None:
        raise OSError(28, "No space left on device", str(path))

    folder = write_model(tmp_path / "model", untrained_model(drive()))
    monkeypatch.setattr(exporting, "_write_program", full)
    with pytest.raises(ModelError, match=rf"^{tmp_path}/step\.pt2: not written \(No space left on device\)$"):
        export_model(folder, tmp_path / "step.pt2")


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_model(tmp_path / "model", untrained_model(drive()))
    monkeypatch.setattr(exporting, "find_spec", lambda name: None if name == "onnxscript" else True)
    with pytest.raises(ModelError, match=r"needs 'onnxscript': pip install 'addressed-dynamics\[export\]'"):
        export_model(folder, tmp_path / "step.onnx", "onnx")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["nowhere", "-o", "x.onnx"],
            "neither an experiment 'nowhere' nor a folder of that name (in data/models: none)",
        ),
        (["", "-o", "x.onnx"], "neither an experiment '' nor a folder"),
        (["model", "-o", "x.bin"], "x.bin: its name does not end in .onnx or .pt2; let it, or name the format: onnx"),
        (
            ["model", "-o", "x.pt2", "--format", "onnx"],
            "x.pt2: it is called as a file of format pt2, but is to be of onnx",
        ),
        (["model", "-o", "x.pt2", "--format", "bin"], "there is no format 'bin'; formats are onnx or pt2"),
        (["model", "-o", "none/x.pt2"], "none/x.pt2: there is no folder none; make it"),
        (
            ["model", "-o", "model", "--format", "pt2"],
            "model: this is a folder; name a file in it, for instance model/mo",
        ),
        (["model", "-o", ""], ".: this is a folder"),
        (["model", "-o", "/proc/x.pt2"], "/proc/x.pt2: it cannot be written (No such file or directory)"),
        (["model", "-o", "x.pt2", "--mode", "sample"], "is no function; take another mode (argmax, mixture, blend)"),
        (["model", "-o", "x.pt2", "--mode", "average"], "there is no addressing mode 'average'"),
        (["model", "-o", "x.pt2", "--candidate", "linear"], "this is one saved model"),
    ],
)
def test_what_cannot_be_exported_is_said(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_model(tmp_path / "model", untrained_model(drive()))
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["export", *arguments])
    assert isinstance(result.exception, ModelError)
    assert said in str(result.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


def test_the_command_says_what_the_file_takes_and_how_close_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_model(tmp_path / "data" / "models" / "boat", untrained_model(sail()))
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["export", "boat", "-o", "boat.pt2"])
    assert result.exit_code == 0, result.output
    assert "boat.pt2: observation (B, 2), action (B, 1), exogenous (B, 1); B is the batch" in result.output
    assert "for 1,000 inputs it differs from predict by at most" in result.output
