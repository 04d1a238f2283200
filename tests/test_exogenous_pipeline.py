"""Exogenous inputs through all stages: from a CSV file with a column of them to the report."""

import json
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import polars
import pytest
import torch
from example_params import EXAMPLE, write_params
from learning import BOAT, sail

from addressed_dynamics import AddressedDynamics, tracking
from addressed_dynamics.envs import LEARNED
from addressed_dynamics.episodes.parquet import load_transitions
from addressed_dynamics.simulators.serving import Served
from pipeline import convert, evaluate, import_data, report, train_addressing, train_baselines, train_ensemble
from pipeline.stage import Call

STAGES = (import_data, convert, train_ensemble, train_addressing, train_baselines, evaluate, report)
WORLD = sail((30,) * 12, seed=4)
SOURCE = {
    "kind": "csv",
    "files": ["boat.csv"],
    "observation": {"position": {"field": "x", "unit": "m"}, "speed": {"field": "v", "unit": "m/s"}},
    "action": {"continuous": {"thrust": {"field": "thrust", "unit": "N", "low": -1.0, "high": 1.0}}},
    "exogenous": {"wind": {"field": "wind", "unit": "m/s", "low": -2.0, "high": 2.0}},
    "reward": None,
    "rate_hz": 10.0,
    "episode": {"by": "column", "column": "voyage"},
    "min_length": 2,
}


class NoRun:
    """A run that nobody looks at."""

    def log(self, *_: object, **__: object) -> None:
        """Leave out what is logged."""

    log_dataset = log_output = log_artifact = log_arrays = conclude = log

    def register(self, name: str, pack: Callable[[Path], Served], **_: object) -> None:
        """Check that the example is one: two frames of two states, an action and the wind."""
        served = pack(Path("packed") / name)
        example = served.example()
        assert len(example) == 8
        assert list(served.predict(example))[:2] == ["next_observation.position", "next_observation.speed"]


def section() -> dict[str, Any]:
    """The section of an experiment that is over in seconds, with one network beside the ensemble."""
    tiny = {key: value for key, value in EXAMPLE.items() if key not in ("record", "paper")}
    optimiser = EXAMPLE["ensemble"]["optimiser"] | {"learning_rate": 0.01}
    return tiny | {
        "title": "A boat in the wind",
        "source": SOURCE,
        "features": {"target": "change", "history": 2},
        "ensemble": tiny["ensemble"] | {"seeds": [0], "epochs": 40, "cluster_epochs": 1, "optimiser": optimiser},
        "baselines": tiny["baselines"] | {"train": ["total_parameters"], "single_networks": {}},
        "evaluation": {"rollouts": {"kind": "recorded", "episodes": 4, "steps": 10, "seed": 0}},
    }


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which all stages have run."""
    folder = tmp_path_factory.mktemp("boat")
    before, after = (each.reshape(12, 30, 2) for each in (WORLD.observation, WORLD.next_observation))
    states = np.concatenate([before, after[:, -1:]], axis=1)
    # The last row of a voyage has a state alone: no step begins in it.
    columns = {
        name: np.concatenate([values.reshape(12, 30), np.full((12, 1), 9.0)], axis=1)
        for name, values in {"thrust": WORLD.action, "wind": WORLD.exogenous}.items()
    }
    table = {"voyage": np.repeat(np.arange(12), 31), "x": states[..., 0].ravel(), "v": states[..., 1].ravel()}
    polars.DataFrame(table | {name: values.ravel() for name, values in columns.items()}).write_csv(folder / "boat.csv")
    threads = torch.get_num_threads()
    with pytest.MonkeyPatch.context() as patch:
        try:
            run_stages(folder, patch)
        finally:
            # Stages have a process of their own, in which they set what the tests after these must not find.
            torch.set_num_threads(threads)
            torch.set_flush_denormal(False)
    return folder


def run_stages(folder: Path, patch: pytest.MonkeyPatch) -> None:
    def run(**_: object) -> AbstractContextManager[NoRun]:
        return nullcontext(NoRun())

    patch.chdir(folder)
    patch.setattr(tracking, "run", run)
    patch.setenv("ADDRESSED_DYNAMICS_PROCESSES", "1")
    params = write_params(folder / "params.yaml", boat=section())
    for stage in STAGES:
        stage.main(Call("boat", params, "transitions", Path("data/raw/boat")))


def test_the_wind_of_a_step_stands_beside_its_action_in_the_tables(finished: Path) -> None:
    found = load_transitions(finished / "data" / "tables" / "boat")
    assert found.spec.exogenous == BOAT.exogenous
    np.testing.assert_array_equal(found.exogenous, WORLD.exogenous)
    np.testing.assert_array_equal(found.action, WORLD.action)
    np.testing.assert_array_equal(found.next_observation, WORLD.next_observation)


def test_the_delivered_model_predicts_with_the_wind_better_than_with_that_of_another_step(finished: Path) -> None:
    model = AddressedDynamics.load(finished / "data" / "models" / "boat")
    rows = np.arange(28)[:, None] + np.arange(2)
    given = (WORLD.observation[rows], WORLD.action[rows])
    wind, after = WORLD.exogenous[rows], WORLD.next_observation[rows[:, 1]]
    right, wrong = (
        np.abs(model.predict(*given, exogenous=each) - after)[:, 1].mean() for each in (wind, np.roll(wind, 1, axis=0))
    )
    assert right < wrong / 3


def test_the_model_is_an_environment_in_which_the_wind_of_a_training_voyage_blows(finished: Path) -> None:
    train = load_transitions(finished / "data/tables/boat", split="train")
    model = AddressedDynamics.load(finished / "data/models/boat")
    env = gymnasium.make(LEARNED, model=finished / "data/models/boat")
    state, info = env.reset(seed=0)
    row = int(np.flatnonzero((train.episode == info["episode"]) & (train.step == info["step"]))[0])
    np.testing.assert_array_equal(state, train.observation[row])
    after = env.step(train.action[row])[0]
    rows = slice(row - 1, row + 1)
    expected = model.predict(train.observation[rows], train.action[rows], exogenous=train.exogenous[rows])
    np.testing.assert_array_equal(after, expected)


def test_the_evaluation_replays_the_recorded_wind(finished: Path) -> None:
    folder = finished / "data" / "evaluation" / "boat"
    assert json.loads((folder / "evaluation.json").read_text())["rollouts"]["exogenous"] == ["wind"]
    arrays, model = (
        np.load(folder / "arrays.npz"),
        AddressedDynamics.load(finished / "data" / "models" / "boat", candidate="ensemble"),
    )
    # One rollout, found again in the recording by its actions.
    true, actions = arrays["rollout_true"][0], arrays["rollout_actions"][0]
    start = next(row for row in range(len(WORLD)) if (WORLD.action[row : row + 10] == actions).all())
    before = slice(start - 1, start + 10)
    frames = WORLD.observation[start - 1 : start + 1]
    rolled = model.rollout(frames, WORLD.action[before], exogenous=WORLD.exogenous[before])
    np.testing.assert_allclose(arrays["rollout_predicted"][0, 1:], rolled, atol=1e-5)
    np.testing.assert_array_equal(true[1:], WORLD.next_observation[start : start + 10])
    assert arrays["exogenous"].shape == (len(arrays["observation"]), 1)


def test_the_report_lists_the_wind_and_says_what_becomes_of_it(finished: Path) -> None:
    text = (finished / "data" / "reports" / "boat" / "report.md").read_text(encoding="utf-8")
    assert "exogenous: known, not predicted" in text
    assert "wind: known, not predicted; every frame holds them" in text
    assert "under the actions and the exogenous inputs (wind) recorded there" in text
