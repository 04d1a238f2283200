"""A model as one file for other runtimes: ONNX, or a program of torch.export. What is written is run and compared."""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor, nn

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.files import atomic_path, why_not_file
from addressed_dynamics.episodes.layout import INPUT, OUTPUT
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.networks.files import load_any_network
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.delivery import find_parts
from addressed_dynamics.simulators.modes import MODES, no_mode
from addressed_dynamics.simulators.motion import MOTION_MODES, MotionModel
from addressed_dynamics.simulators.portable import StepModule
from addressed_dynamics.simulators.portable_motion import MotionModule

FORMATS = ("onnx", "pt2")
METADATA = "addressed_dynamics.json"
"""What a .pt2 file calls what is known of the model; in ONNX it is in the metadata, a key for each part."""
TOLERANCE = 1e-6
"""Share of the range by which what was exported may differ from `predict`."""
CHECKED_ROWS = 1000
TRACED_ROWS = 2
"""With one row a tracer would take the size of the batch for a constant."""


@dataclass(frozen=True)
class Exported:
    """A file that was written, and what became of it when it was run."""

    path: Path
    inputs: dict[str, tuple[str, ...]]
    """Shape of each input; `B` is the batch."""
    rows: int
    """Inputs, drawn like the training data, for which it was compared with `predict`."""
    difference: float
    """The largest, as a share of the range of its dimension."""


@dataclass(frozen=True)
class _Subject:
    """A model of any kind, as what is exported."""

    module: nn.Module
    inputs: dict[str, Tensor]
    """`CHECKED_ROWS` of each input."""
    expected: Float32[np.ndarray, "row output"]
    """What `predict` says of them."""
    scale: Float32[np.ndarray, " output"]
    """Range of each output."""
    metadata: dict[str, Any]


def export_model(
    folder: Path,
    target: Path,
    file_format: str | None = None,
    *,
    candidate: str | None = None,
    seed: int | None = None,
    variant: str | None = None,
    mode: str | None = None,
) -> Exported:
    """Write the step of a model of any kind as one graph with a dynamic batch; it replaces a file that is there.

    The file is run, in ONNX Runtime or by PyTorch, before it gets its name: it appears only if it does as `predict`.

    Args:
        folder: an experiment's models, or one saved model.
        target: the file.
        file_format: `onnx`, or `pt2` for what `torch.export.load` reads; None for what the file's name says.
        candidate: which of the models; these four as in `AddressedDynamics.load`.
        seed: which of its seeds.
        variant: which of its addressing networks.
        mode: how it uses its members.

    Raises:
        ModelError: there is no such model, mode or format, the file's name is that of another format or it cannot be
            written, the mode draws at random, a package is missing, or what was written does not do as `predict` does.
    """
    wanted = _format(target, file_format)
    subject = _subject(folder, candidate, seed, variant, mode)
    with atomic_path(target) as temporary, _quiet():
        try:
            run = (_write_onnx if wanted == "onnx" else _write_program)(subject, temporary)
            difference = _difference(run, subject)
        except ModelError:
            raise
        except OSError as error:  # a full disk, for instance
            message = f"{target}: not written ({error.strerror or error})"
            raise ModelError(message) from error
        except Exception as error:  # exporters and runtimes raise what they like
            what = str(error).strip().partition("\n")[0] or type(error).__name__
            message = f"{target}: not written, for the model cannot be exported to {wanted} ({what})"
            raise ModelError(message) from error
        if not difference <= TOLERANCE:
            message = (
                f"{target}: not written, for what was exported is off by {difference:.1e} of the range, where "
                f"{TOLERANCE:g} is allowed; please report it with the versions of torch and onnxruntime"
            )
            raise ModelError(message)
    shapes = {name: ("B", *map(str, each.shape[1:])) for name, each in subject.inputs.items()}
    return Exported(target, shapes, CHECKED_ROWS, difference)


def _format(target: Path, wanted: str | None) -> str:
    """Return the format of a file that can be written, by what is wanted or by its name."""
    formats = " or ".join(FORMATS)
    if target.is_dir():
        message = f"{target}: this is a folder; name a file in it, for instance {target / 'model.onnx'}"
        raise ModelError(message)
    if wanted is not None and wanted not in FORMATS:
        message = f"there is no format '{wanted}'; formats are {formats}"
        raise ModelError(message)
    ending = target.suffix.lower().removeprefix(".")
    if wanted is None and ending not in FORMATS:
        message = f"{target}: its name does not end in .{' or .'.join(FORMATS)}; let it, or name the format: {formats}"
        raise ModelError(message)
    if wanted is not None and ending in FORMATS and ending != wanted:
        message = f"{target}: it is called as a file of format {ending}, but is to be of {wanted}; change one of them"
        raise ModelError(message)
    if not target.parent.is_dir():
        message = f"{target}: there is no folder {target.parent}; make it, or name a file elsewhere"
        raise ModelError(message)
    if (problem := why_not_file(target)) is not None:
        message = f"{target}: {problem}; name a file elsewhere"
        raise ModelError(message)
    return wanted or ending


def _subject(folder: Path, candidate: str | None, seed: int | None, variant: str | None, mode: str | None) -> _Subject:
    parts = find_parts(folder, candidate, seed, variant)
    if isinstance(load_any_network(parts.network).features, FeatureSpec):
        used = next((each for each in MODES if each == mode), None)
        if mode is not None and used is None:
            raise no_mode(mode, MODES)
        return _of_transitions(AddressedDynamics.of(parts, mode=used))
    of_motion = next((each for each in MOTION_MODES if each == mode), None)
    if mode is not None and of_motion is None:
        raise no_mode(mode, MOTION_MODES)
    return _of_motion(MotionModel.of(parts, mode=of_motion))


def _of_transitions(model: AddressedDynamics) -> _Subject:
    features, spaces = model.features, model.features.spaces
    module = StepModule(model)
    generator = np.random.default_rng(0)
    shape = (CHECKED_ROWS,) if features.history == 1 else (CHECKED_ROWS, features.history)
    drawn = generator.normal(features.input_mean, features.input_deviation, (*shape, features.frame_inputs))
    states, known = len(spaces.observation), len(spaces.exogenous)
    low, high = np.array([(each.low, each.high) for each in spaces.observation]).T
    inputs: dict[str, np.ndarray] = {"observation": drawn[..., :states].clip(low, high).astype(np.float32)}
    if isinstance(spaces.action, DiscreteAction):
        inputs["action"] = generator.integers(0, spaces.action.count, shape)
    else:
        inputs["action"] = drawn[..., states : features.frame_inputs - known].astype(np.float32)
    if known:
        inputs["exogenous"] = drawn[..., features.frame_inputs - known :].astype(np.float32)
    expected = model.predict(inputs["observation"], inputs["action"], exogenous=inputs.get("exogenous"))
    tensors = {name: torch.from_numpy(each) for name, each in inputs.items()}
    metadata = {"kind": "transitions", "spaces": spaces.to_json(), "history": features.history}
    scale = np.array(features.scale, np.float32)
    return _Subject(module, tensors, expected, scale, {**metadata, **_origin(model)})


def _of_motion(model: MotionModel) -> _Subject:
    module, features = MotionModule(model), model.features
    generator = np.random.default_rng(0)
    drawn = generator.normal(features.input_mean, features.input_deviation, (CHECKED_ROWS, features.inputs))
    inputs = {"x": torch.from_numpy(drawn.astype(np.float32))}
    if model.mode == "phase":
        inputs["phase"] = torch.from_numpy(generator.uniform(0.0, 1.0, CHECKED_ROWS).astype(np.float32))
    expected = model.predict(inputs["x"], phase=inputs.get("phase")).numpy()
    # What an output ranges over is not known; 99 of 100 lie within six deviations.
    scale = 6.0 * np.maximum(expected.std(axis=0), np.array(features.target_deviation, np.float32))
    layouts = {
        name: [{"name": each.name, "unit": each.unit, "width": len(each.columns)} for each in layout.blocks]
        for name, layout in {"x": INPUT, "y": OUTPUT}.items()
    }
    return _Subject(module, inputs, expected, scale, {"kind": "motion", "layout": layouts, **_origin(model)})


def _origin(model: AddressedDynamics | MotionModel) -> dict[str, Any]:
    return {
        "mode": model.mode,
        "model": None if model.origin is None else asdict(model.origin),
        "package_version": version("addressed-dynamics"),
    }


Run = Callable[[dict[str, Tensor]], np.ndarray]
"""From inputs to outputs, by the file that was written."""


def _write_onnx(subject: _Subject, target: Path) -> Run:
    for package in ("onnx", "onnxscript", "onnxruntime"):
        if find_spec(package) is None:
            message = f"to export to ONNX needs '{package}': pip install 'addressed-dynamics[export]'"
            raise ModelError(message)
    import onnxruntime

    program = torch.onnx.export(
        subject.module.eval(),
        tuple(each[:TRACED_ROWS] for each in subject.inputs.values()),
        input_names=list(subject.inputs),
        output_names=["next_observation" if subject.metadata["kind"] == "transitions" else "y"],
        dynamic_shapes=_dynamic(subject),
        dynamo=True,
        verbose=False,
    )
    assert program is not None
    for key, value in subject.metadata.items():
        program.model.metadata_props[key] = value if isinstance(value, str) else json.dumps(value)
    program.save(str(target))
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(target.read_bytes(), options, providers=["CPUExecutionProvider"])

    fixed = [each.name for each in session.get_inputs() if isinstance(each.shape[0], int)]
    if fixed:
        # The exporter says nothing of it, where torch.export.export raises.
        message = f"the size of the batch became a constant of {', '.join(fixed)}"
        raise ValueError(message)

    def run(inputs: dict[str, Tensor]) -> np.ndarray:
        found: np.ndarray = session.run(None, {name: each.numpy() for name, each in inputs.items()})[0]
        return found

    return run


def _write_program(subject: _Subject, target: Path) -> Run:
    program = torch.export.export(
        subject.module.eval(),
        tuple(each[:TRACED_ROWS] for each in subject.inputs.values()),
        dynamic_shapes=_dynamic(subject),
    )
    with target.open("wb") as file:
        torch.export.save(program, file, extra_files={METADATA: json.dumps(subject.metadata)})
    with target.open("rb") as written:
        loaded = torch.export.load(written).module()

    def run(inputs: dict[str, Tensor]) -> np.ndarray:
        with torch.no_grad():
            found: np.ndarray = loaded(*inputs.values()).numpy()
        return found

    return run


def _dynamic(subject: _Subject) -> tuple[dict[int, Any], ...]:
    batch = torch.export.Dim("batch")
    return tuple({0: batch} for _ in subject.inputs)


def _difference(run: Run, subject: _Subject) -> float:
    """Return how far a file's answers are from `predict`'s, as a share of the range; of a batch and of one row."""
    worst = 0.0
    for rows in (slice(None), slice(0, 1)):
        found = run({name: each[rows] for name, each in subject.inputs.items()})
        worst = max(worst, float((np.abs(found - subject.expected[rows]) / subject.scale).max()))
    return worst


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep exporters from talking about what is none of a user's concern."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)
