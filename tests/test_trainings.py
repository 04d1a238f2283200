"""What the stages of trainings write beside the networks."""

import json
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import pytest
from learning import ENSEMBLE, drive

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.common.training_data import TrainingData
from addressed_dynamics.features.transitions import kind
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.sources.transitions.params import ExperimentParams, FeatureParams
from pipeline import trainings
from pipeline.trainings import Stage, train_ensembles


class NoRun:
    """A run that nobody looks at."""

    def log(self, *_: object, **__: object) -> None:
        """Leave out what is logged."""

    log_dataset = log_output = log


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TrainingData[FeatureSpec]:
    """What a training may see, of episodes of which some are too short for the history; MLflow sees nothing."""
    tables = {"train": drive((30, 2, 1)), "validation": drive((3, 10), seed=1)}

    class Stream(list[Transitions]):
        def __init__(self, _: Path, split: str) -> None:
            super().__init__([tables[split]])
            self.split = split

    def run(**_: object) -> AbstractContextManager[NoRun]:
        return nullcontext(NoRun())

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(kind, "TransitionStream", Stream)
    monkeypatch.setattr(trainings.tracking, "run", run)
    sections = ExperimentParams.model_construct(ensemble=ENSEMBLE)
    return kind.load_training_data(tmp_path, sections, FeatureParams(target="change", history=4))


def test_the_figures_of_a_training_count_what_is_too_short_for_the_history(
    tmp_path: Path, data: TrainingData[FeatureSpec]
) -> None:
    train_ensembles(Stage("train_ensemble", "car", tmp_path / "params.yaml", 1), data, ENSEMBLE, {"ensemble": {}})
    found = json.loads((tmp_path / "data" / "figures" / "car" / "ensemble" / "ensemble.json").read_text())
    assert set(found) == {"seed-0", "dropped"}
    assert found["dropped"] == {"train": {"episodes": 2, "rows": 3}, "validation": {"episodes": 1, "rows": 3}}


def test_more_members_than_samples_are_refused_before_they_are_timed(
    tmp_path: Path, data: TrainingData[FeatureSpec], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(trainings, "seconds_per_update")  # it would make up as many samples as there are members
    params = ENSEMBLE.with_members(len(data.train) + 1)
    with pytest.raises(TrainingError, match=f"has {len(data.train)} and .*, or have fewer 'ensemble.members'"):
        train_ensembles(Stage("train_ensemble", "car", tmp_path / "params.yaml", 1), data, params, {"ensemble": {}})
    assert not (tmp_path / "data").exists()
