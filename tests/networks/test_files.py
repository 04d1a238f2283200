import json
from pathlib import Path
from typing import Any

import pytest
import safetensors.torch
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import drive, untrained_model

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.networks.files import SavedNetwork, load_network, read_index, save_network
from addressed_dynamics.networks.stacked import StackedMLP

NOTES = {"params": {"seed": 3}, "training": "seed-3"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A saved network."""
    model = untrained_model(drive())
    save_network(tmp_path / "network", SavedNetwork(model.ensemble, model.features, NOTES))
    return tmp_path / "network"


def rewrite_config(folder: Path, *keys: str, value: Any) -> None:
    config = json.loads((folder / "config.json").read_text())
    section = config
    for key in keys[:-1]:
        section = section[key]
    section[keys[-1]] = value
    (folder / "config.json").write_text(json.dumps(config))


def refusal(folder: Path) -> str:
    """The one line with which a network is refused."""
    with pytest.raises(ModelError) as caught:
        load_network(folder, FeatureSpec)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_is_saved_is_loaded_bit_for_bit(folder: Path) -> None:
    model, loaded = untrained_model(drive()), load_network(folder, FeatureSpec)
    assert (loaded.features, loaded.notes) == (model.features, NOTES)
    assert (loaded.stack.widths, loaded.stack.activation) == (model.ensemble.widths, model.ensemble.activation)
    for found, expected in zip(loaded.stack.parameters(), model.ensemble.parameters(), strict=True):
        assert torch.equal(found, expected)
        assert not found.requires_grad


def test_heads_on_a_trunk_are_loaded_as_they_were_saved(folder: Path) -> None:
    stack = StackedMLP(3, (5, 8, 4, 1), "tanh", torch.Generator().manual_seed(0), shared=2)
    save_network(folder, SavedNetwork(stack, load_network(folder, FeatureSpec).features, {}))
    loaded = load_network(folder, FeatureSpec).stack
    assert (loaded.members, loaded.widths, loaded.shared) == (3, (5, 8, 4, 1), 2)
    x = torch.randn(6, 5)
    assert torch.equal(loaded(x), stack(x))


def test_a_linear_part_is_loaded_as_it_was_saved(folder: Path) -> None:
    stack = StackedMLP(3, (5, 8, 2), "tanh", torch.Generator().manual_seed(0), linear=True)
    torch.nn.init.normal_(stack.linear[0])
    save_network(folder, SavedNetwork(stack, load_network(folder, FeatureSpec).features, {}))
    loaded, x = load_network(folder, FeatureSpec).stack, torch.randn(6, 5)
    assert torch.equal(loaded.linear[0], stack.linear[0])
    assert torch.equal(loaded(x), stack(x))


def test_a_network_of_an_earlier_version_has_no_shared_layers_and_no_linear_part(folder: Path) -> None:
    config = json.loads((folder / "config.json").read_text())
    del config["architecture"]["shared"], config["architecture"]["linear"]
    (folder / "config.json").write_text(json.dumps(config))
    stack = load_network(folder, FeatureSpec).stack
    assert stack.shared == 0
    assert not len(stack.linear)


def test_the_same_network_makes_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    save_network(tmp_path / "again", load_network(folder, FeatureSpec))
    for name in ("weights.safetensors", "config.json"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes()


def test_a_network_replaces_an_earlier_one_and_leaves_nothing_beside_it(folder: Path) -> None:
    other = untrained_model(drive(), seed=1)
    save_network(folder, SavedNetwork(other.ensemble, other.features, {}))
    assert load_network(folder, FeatureSpec).notes == {}
    assert [path.name for path in folder.parent.iterdir()] == ["network"]
    assert sorted(path.name for path in folder.iterdir()) == ["config.json", "weights.safetensors"]


@pytest.mark.parametrize("name", ["weights.safetensors", "config.json"])
def test_a_missing_file_is_named_with_what_brings_it_back(folder: Path, name: str) -> None:
    (folder / name).unlink()
    message = refusal(folder)
    assert message.startswith(f"{folder / name}: missing")
    assert "dvc" in message


@pytest.mark.parametrize("name", ["weights.safetensors", "config.json"])
@pytest.mark.parametrize("share", [0.0, 0.4, 0.99])
def test_a_truncated_file_is_refused(folder: Path, name: str, share: float) -> None:
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content[: int(len(content) * share)])
    assert refusal(folder).startswith(f"{folder / name}: damaged")


@settings(max_examples=40)
@given(st.data())
def test_a_changed_byte_in_the_header_of_the_weights_is_refused_or_harmless(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("model") / "network"
    model = untrained_model(drive((5,)))
    save_network(folder, SavedNetwork(model.ensemble, model.features, {}))
    content = bytearray((folder / "weights.safetensors").read_bytes())
    header = 8 + int.from_bytes(content[:8], "little")
    content[data.draw(st.integers(0, header - 1))] = data.draw(st.integers(0, 255))
    (folder / "weights.safetensors").write_bytes(content)
    try:
        loaded = load_network(folder, FeatureSpec)
    except ModelError as error:
        assert "\n" not in str(error)  # noqa: PT017 - most flips of a byte are refused, a few are harmless
    else:
        found = {name: tuple(tensor.shape) for name, tensor in loaded.stack.state_dict().items()}
        assert found == {name: tuple(tensor.shape) for name, tensor in model.ensemble.state_dict().items()}


def test_weights_of_another_shape_are_refused_with_both_shapes(folder: Path) -> None:
    rewrite_config(folder, "architecture", "widths", value=[5, 16, 9, 2])
    message = refusal(folder)
    assert "(3, 1, 9)" in message
    assert "(3, 1, 8)" in message
    assert "not of one model" in message


@pytest.mark.parametrize("change", ["missing", "extra"])
def test_tensors_that_are_missing_or_too_many_are_refused(folder: Path, change: str) -> None:
    tensors = safetensors.torch.load_file(folder / "weights.safetensors")
    if change == "missing":
        del tensors["biases.1"]
    else:
        tensors["biases.9"] = torch.zeros(1)
    safetensors.torch.save_file(tensors, folder / "weights.safetensors")
    assert f"tensor 'biases.{1 if change == 'missing' else 9}'" in refusal(folder)


@pytest.mark.parametrize(
    ("keys", "value"),
    [
        (("architecture",), {}),
        (("architecture", "widths"), 5),
        (("architecture", "widths"), ["wide"]),
        (("architecture", "widths"), [5]),
        (("architecture", "members"), 0),
        (("architecture", "activation"), "sine"),
        (("architecture", "shared"), 9),
        (("architecture", "shared"), "some"),
        (("features",), None),
        (("features", "spaces", "action"), {"kind": "discrete"}),
        (("features", "scale"), [1.0, 1.0, 1.0]),
        (("notes",), 7),
    ],
)
def test_a_config_that_describes_no_network_is_refused(folder: Path, keys: tuple[str, ...], value: Any) -> None:
    rewrite_config(folder, *keys, value=value)
    message = refusal(folder)
    assert message.startswith(f"{folder / 'config.json'}: incomplete or malformed")
    assert "train the model again" in message


@pytest.mark.parametrize("value", [0, 2, "1"])
def test_a_folder_of_another_format_is_refused(folder: Path, value: Any) -> None:
    rewrite_config(folder, "format", value=value)
    assert f"format 1 expected, but it is of format {value!r}; " in refusal(folder)


@pytest.mark.parametrize("text", ["[1, 2]", '"model"', "3"])
def test_json_that_is_no_config_is_refused(folder: Path, text: str) -> None:
    (folder / "config.json").write_text(text)
    assert "format 1 expected, but it holds " in refusal(folder)


def test_a_folder_in_the_place_of_a_file_is_refused(folder: Path) -> None:
    (folder / "weights.safetensors").unlink()
    (folder / "weights.safetensors").mkdir()
    assert refusal(folder).startswith(f"{folder / 'weights.safetensors'}: damaged")


def test_an_index_is_read_and_a_missing_one_is_refused(tmp_path: Path) -> None:
    (tmp_path / "some.json").write_text('{"format": 1, "seeds": [0]}')
    assert read_index(tmp_path, "some.json")["seeds"] == [0]
    with pytest.raises(ModelError, match="not a whole model folder"):
        read_index(tmp_path, "other.json")
