"""What is delivered, packed into a folder of its own and served as a function of a table with named columns."""

from pathlib import Path

import numpy as np
import polars
import pytest
from learned_worlds import WORLDS
from learning import drive, sail, untrained_model
from motions import make_motion
from packed_models import write_addressed, write_trusted
from trusted_models import drifting

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.versions import tree_digest
from addressed_dynamics.episodes.parquet import TransitionTable, write_table
from addressed_dynamics.features.motion.features import fit_motion_features
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators import serving_motion
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.modes import Mode
from addressed_dynamics.simulators.motion import MotionMode, MotionModel
from addressed_dynamics.simulators.packing import pack, packed
from addressed_dynamics.simulators.serving_transitions import load_served
from addressed_dynamics.sources.motion.params import MotionFeatureParams
from addressed_dynamics.sources.motion.tables import INPUTS, OUTPUTS


def motion_model(mode: MotionMode) -> MotionModel:
    features = fit_motion_features(make_motion(rows=24), MotionFeatureParams(target="change"))
    networks = StackedMLP(4, (342, 8, 311), "elu").requires_grad_(requires_grad=False)
    addressing = None if mode == "phase" else StackedMLP(1, (342, 8, 4), "elu").requires_grad_(requires_grad=False)
    return MotionModel(features, networks, addressing, mode=mode)


def test_what_is_packed_is_what_is_delivered_with_the_model_that_its_trust_is_held_against(tmp_path: Path) -> None:
    models = write_trusted(tmp_path / "models")
    pack(models, tmp_path / "packed")
    data = drifting(2, 5)
    given = (data.observation, data.action)
    whole, part = (AddressedDynamics.load(folder) for folder in (models, tmp_path / "packed"))
    assert part.origin == whole.origin
    np.testing.assert_array_equal(part.predict(*given), whole.predict(*given))
    np.testing.assert_array_equal(part.interval(*given), whole.interval(*given))
    np.testing.assert_array_equal(part.trust(*given), whole.trust(*given))


def test_nothing_but_the_delivered_model_is_packed(tmp_path: Path) -> None:
    models = write_addressed(tmp_path / "models", *(untrained_model(drive(), seed=seed) for seed in (0, 1)))
    pack(models, tmp_path / "packed")
    assert sorted(
        each.relative_to(tmp_path / "packed").as_posix() for each in tmp_path.rglob("packed/*/*/weights*")
    ) == ["ensemble/seed-0/weights.safetensors"]
    assert [each.name for each in (tmp_path / "packed" / "addressing" / "seed-0").iterdir()] == ["plain"]
    with pytest.raises(ModelError, match="seed 1 was not trained"):
        AddressedDynamics.load(tmp_path / "packed", seed=1)


def test_the_same_model_is_packed_into_the_same_bytes_and_another_mode_into_others(tmp_path: Path) -> None:
    model = untrained_model(drive())
    folders = [tmp_path / name for name in ("first", "second", "mixture")]
    for folder in folders:
        if folder.name == "mixture":
            model.mode = "mixture"
        pack(write_addressed(folder / "models", model), folder / "packed")
    first, second, mixture = (tree_digest(folder / "packed") for folder in folders)
    assert first == second
    assert first != mixture


def test_a_folder_of_models_without_a_delivered_one_is_not_packed(tmp_path: Path) -> None:
    models = write_addressed(tmp_path / "models", untrained_model(drive()))
    (models / "delivered.json").unlink()
    with pytest.raises(ModelError, match="nobody knows which of the models is delivered"):
        pack(models, tmp_path / "packed")
    assert not (tmp_path / "packed").exists()


@pytest.mark.parametrize("mode", ["argmax", "mixture"])
@pytest.mark.parametrize("history", [1, 3])
@pytest.mark.parametrize("world", WORLDS)
def test_a_table_of_frames_is_answered_with_what_the_model_predicts(
    tmp_path: Path, world: str, history: int, mode: Mode
) -> None:
    data, model = WORLDS[world](), untrained_model(WORLDS[world](), history=history)
    model.mode = mode
    served = packed(write_addressed(tmp_path / "models", model), load_served, tmp_path / "packed")
    rows = np.arange(5)[:, None] + np.arange(history) if history > 1 else np.arange(5)
    exogenous = data.exogenous[rows] if data.spec.exogenous else None
    expected = model.predict(data.observation[rows], data.action[rows], exogenous=exogenous)
    table = {}
    for back in range(history):
        end = f".{-back}" if back else ""
        at = np.arange(5) + history - 1 - back
        table |= {
            f"observation.{each.name}{end}": data.observation[at, n] for n, each in enumerate(data.spec.observation)
        }
        table |= {f"exogenous.{each.name}{end}": data.exogenous[at, n] for n, each in enumerate(data.spec.exogenous)}
        if data.action.ndim == 1:
            table[f"action{end}"] = data.action[at]
        else:
            names = [each.name for each in data.spec.action.dimensions]  # type: ignore[union-attr]
            table |= {f"action.{name}{end}": data.action[at, n] for n, name in enumerate(names)}
    assert set(table) == {each.name for each in served.inputs}
    found = served.predict(table)
    assert list(found) == [f"next_observation.{each.name}" for each in data.spec.observation]
    np.testing.assert_allclose(found.to_numpy(), expected, rtol=1e-5, atol=1e-6)
    assert np.isfinite(served.predict(served.example()).to_numpy()).all()


def test_a_parquet_table_of_transitions_is_a_table_of_inputs(tmp_path: Path) -> None:
    data, model = sail(), untrained_model(sail())
    write_table(
        tmp_path / "boat.parquet", TransitionTable(data, np.zeros(len(data), np.int8), "all"), row_group_rows=100
    )
    served = load_served(write_addressed(tmp_path / "models", model))
    frame = polars.read_parquet(tmp_path / "boat.parquet")
    found = served.predict(frame)
    expected = model.predict(data.observation, data.action, exogenous=data.exogenous)
    np.testing.assert_allclose(found.to_numpy(), expected, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("history", [1, 2])
def test_a_model_with_a_trust_answers_with_intervals_of_the_coverage_that_was_asked_for(
    tmp_path: Path, history: int
) -> None:
    served = load_served(write_trusted(tmp_path / "models", history))
    given = served.example()
    narrow, wide = (served.predict(given, {"coverage": share}) for share in (0.5, 0.9))
    assert list(narrow) == [each.name for each in served.outputs]
    for name in ("next_observation.position", "next_observation.speed"):
        assert (wide[f"{name}.low"] < narrow[f"{name}.low"]).all()
        assert (narrow[f"{name}.low"] < narrow[name]).all()
        assert (narrow[name] < narrow[f"{name}.high"]).all()
        assert (narrow[f"{name}.high"] < wide[f"{name}.high"]).all()
    assert narrow["trust"].between(0, 1).all()
    assert served.predict(given).equals(wide)
    if history == 1:
        state = np.stack([given["observation.position"], given["observation.speed"]], axis=1)
        low, _ = served.model.interval(state, given["action.thrust"][:, None], 0.5)
        np.testing.assert_allclose(narrow["next_observation.position.low"], low[:, 0], rtol=1e-6)


@pytest.mark.parametrize("mode", ["mixture", "phase"])
def test_frames_of_motion_are_answered_by_the_names_of_the_tables(tmp_path: Path, mode: MotionMode) -> None:
    model, frames = motion_model(mode), make_motion(rows=6, clips=("walk",))
    if mode == "phase":
        model.save(tmp_path / "models", {})
    else:
        write_addressed(tmp_path / "models", model)
    served = serving_motion.load_served(tmp_path / "models")
    found = served.predict(dict(zip(INPUTS, frames.x.T, strict=True)) | {"phase": frames.phase})
    assert tuple(found) == OUTPUTS
    expected = model.predict(frames.x, phase=frames.phase if mode == "phase" else None)
    np.testing.assert_allclose(found.to_numpy(), expected, rtol=1e-4, atol=1e-4)
    assert served.predict(served.example()).shape == (2, 311)


@pytest.mark.parametrize(
    ("change", "params", "message"),
    [
        ({"action": None}, {}, "column 'action' is missing; this model needs 3"),
        ({"action": [0, 7]}, {}, "should lie in 0..2"),
        ({"action": [0.5, 1.0]}, {}, "numbers of actions, which are whole"),
        ({"observation.velocity": ["slow", "fast"]}, {}, "column 'observation.velocity' should hold numbers"),
        ({"observation.velocity": [0.0, np.nan]}, {}, "should be finite"),
        ({}, {"coverage": 0.9}, "no setting 'coverage'"),
    ],
)  # fmt: skip
def test_a_row_that_the_model_cannot_take_is_one_clear_line(
    tmp_path: Path, change: dict[str, list[object] | None], params: dict[str, float], message: str
) -> None:
    served = load_served(write_addressed(tmp_path / "models", untrained_model(drive())))
    table = {name: change.get(name, values) for name, values in served.example().items()}
    with pytest.raises(ModelError, match=message) as failed:
        served.predict({name: values for name, values in table.items() if values is not None}, params)
    assert "\n" not in str(failed.value)
