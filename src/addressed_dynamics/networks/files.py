"""A network's folder: weights.safetensors and config.json. No pickles: loading runs no code."""

import json
import reprlib
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic

import safetensors.torch
from safetensors import SafetensorError

from addressed_dynamics.base.errors import ModelError, ParamsError
from addressed_dynamics.base.files import atomic_path, write_json
from addressed_dynamics.base.kinds import supplied
from addressed_dynamics.features.common.training_data import AnyFeatures, Features
from addressed_dynamics.networks.stacked import ACTIVATIONS, StackedMLP

FORMAT = 1
"""Version of the folder's layout."""


@dataclass(frozen=True)
class SavedNetwork(Generic[Features]):
    """A stack of networks with all that is needed to use it."""

    stack: StackedMLP
    """The networks."""
    features: Features
    """What their inputs and outputs mean."""
    notes: dict[str, Any]
    """Where they come from: params, hash of the data, seed, and so on; JSON-compatible."""


def save_network(folder: Path, network: SavedNetwork[Features]) -> None:
    """Write `network` into `folder`, which appears whole or not at all."""
    stack = network.stack
    config = {
        "format": FORMAT,
        "package_version": version("addressed-dynamics"),
        "architecture": {
            "members": stack.members,
            "widths": list(stack.widths),
            "activation": stack.activation,
            "shared": stack.shared,
            "linear": bool(len(stack.linear)),
        },
        "features": network.features.to_json(),
        "notes": network.notes,
    }
    with atomic_path(folder) as temporary:
        temporary.mkdir(parents=True)
        tensors = {name: tensor.detach().contiguous().clone() for name, tensor in stack.state_dict().items()}
        safetensors.torch.save_file(tensors, temporary / "weights.safetensors")
        write_json(temporary / "config.json", config)


def load_network(folder: Path, form: type[Features]) -> SavedNetwork[Features]:
    """Read what `save_network` wrote of a model with features of the class `form`.

    Raises:
        ModelError: a file is missing or damaged, is of another format, or the weights do not fit the architecture; or
            the network models another kind of data.
    """
    network = load_any_network(folder)
    if not isinstance(network.features, form):
        found, wanted = (_module_kind(each) for each in (type(network.features), form))
        message = f"{folder}: a model of {found}, but one of {wanted} was expected"
        raise ModelError(message)
    return SavedNetwork(network.stack, network.features, network.notes)


def load_any_network(folder: Path) -> SavedNetwork[Any]:
    """Read what `save_network` wrote, whatever it models.

    Raises:
        ModelError: as in `load_network`.
    """
    config = _read_config(folder / "config.json")
    try:
        architecture = config["architecture"]
        widths = tuple(int(width) for width in architecture["widths"])
        activation = str(architecture["activation"])
        if activation not in ACTIVATIONS:
            message = f"unknown activation '{activation}'"
            raise ValueError(message)
        # Models of earlier versions have neither shared layers nor linear parts, and do not say so.
        shared, linear = int(architecture.get("shared", 0)), bool(architecture.get("linear", False))
        stack = StackedMLP(int(architecture["members"]), widths, activation, shared=shared, linear=linear)  # type: ignore[arg-type] # checked above
        features, notes = _features(config["features"]), dict(config["notes"])
    except (KeyError, TypeError, ValueError, ModelError) as error:
        message = f"{folder / 'config.json'}: incomplete or malformed ({error}); train the model again"
        raise ModelError(message) from error
    weights = folder / "weights.safetensors"
    try:
        tensors = safetensors.torch.load_file(weights)
    except FileNotFoundError as error:
        message = f"{weights}: missing; 'dvc checkout' or 'dvc repro' brings it back"
        raise ModelError(message) from error
    except (OSError, SafetensorError) as error:
        message = f"{weights}: damaged ({error}); 'dvc checkout --force' or 'dvc repro' brings it back"
        raise ModelError(message) from error
    expected = {name: tuple(tensor.shape) for name, tensor in stack.state_dict().items()}
    found = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    for name in sorted(expected.keys() | found.keys()):
        if expected.get(name) != found.get(name):
            message = (
                f"{weights}: tensor '{name}' should have shape {expected.get(name)} by config.json, "
                f"but has {found.get(name)}; the two files are not of one model"
            )
            raise ModelError(message)
    stack.load_state_dict(tensors)
    return SavedNetwork(stack.requires_grad_(False), features, notes)


def addressed_folders(folder: Path, seed: int | None, variant: str | None) -> tuple[Path, Path]:
    """Return the folders of an ensemble and of its addressing network in a folder of models.

    Args:
        folder: what the training stages wrote.
        seed: which of the trained seeds; None for the first, which is the one delivered.
        variant: which addressing network; None for the one delivered.

    Raises:
        ModelError: the index is missing or damaged, or the seed or variant was not trained.
    """
    index = read_index(folder / "addressing", "addressing.json")
    try:
        delivered: dict[str, str] = dict(index["delivered"])
        variants: list[str] = list(index["variants"])
    except (KeyError, TypeError, ValueError) as error:
        message = f"{folder / 'addressing' / 'addressing.json'}: incomplete or malformed; run train_addressing again"
        raise ModelError(message) from error
    chosen_seed = next(iter(delivered)) if seed is None else str(seed)
    if chosen_seed not in delivered:
        message = f"{folder}: seed {seed} was not trained (seeds there: {', '.join(delivered)})"
        raise ModelError(message)
    chosen_variant = variant or delivered[chosen_seed]
    if chosen_variant not in variants:
        message = f"{folder}: there is no addressing variant '{variant}' (variants there: {', '.join(variants)})"
        raise ModelError(message)
    return folder / "ensemble" / f"seed-{chosen_seed}", folder / "addressing" / f"seed-{chosen_seed}" / chosen_variant


def read_index(folder: Path, name: str) -> dict[str, Any]:
    """Read the JSON file `name` of a model folder.

    Raises:
        ModelError: it is missing or is not JSON.
    """
    return _read_config(folder / name)


def _features(value: Any) -> AnyFeatures:
    # Features of transitions do not name their kind.
    kind = value.get("kind", "transitions") if isinstance(value, dict) else "transitions"
    try:
        form: Any = supplied("features", str(kind)).FEATURES
    except ParamsError as error:
        message = f"unknown kind of features '{kind}'"
        raise ValueError(message) from error
    features: AnyFeatures = form.from_json(value)
    return features


def _module_kind(form: type) -> str:
    return form.__module__.split(".")[-2]


def _read_config(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        message = f"{path}: missing, so this is not a whole model folder; 'dvc checkout' or 'dvc repro' brings it back"
        raise ModelError(message) from error
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        message = f"{path}: damaged ({error}); 'dvc checkout --force' or 'dvc repro' brings it back"
        raise ModelError(message) from error
    if not isinstance(value, dict) or value.get("format", FORMAT) != FORMAT:
        found = f"is of format {value['format']!r}" if isinstance(value, dict) else f"holds {reprlib.repr(value)}"
        message = f"{path}: format {FORMAT} expected, but it {found}; 'dvc repro' makes it anew, of this version"
        raise ModelError(message)
    return value
