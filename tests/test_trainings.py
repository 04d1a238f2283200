"""What the stages of trainings write beside the networks."""

import json
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import pytest
from learning import ENSEMBLE, drive

from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.transitions import kind
from addressed_dynamics.sources.transitions.params import ExperimentParams, FeatureParams
from pipeline import trainings
from pipeline.trainings import Stage, train_ensembles


class NoRun:
    """A run that nobody looks at."""

    def log(self, *_: object, **__: object) -> None:
        """Leave out what is logged."""

    log_dataset = log_output = log


def test_the_figures_of_a_training_count_what_is_too_short_for_the_history(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
    data = kind.load_training_data(tmp_path, sections, FeatureParams(target="change", history=4))
    train_ensembles(Stage("train_ensemble", "car", tmp_path / "params.yaml", 1), data, ENSEMBLE, {"ensemble": {}})
    found = json.loads((tmp_path / "data" / "figures" / "car" / "ensemble" / "ensemble.json").read_text())
    assert set(found) == {"seed-0", "dropped"}
    assert found["dropped"] == {"train": {"episodes": 2, "rows": 3}, "validation": {"episodes": 1, "rows": 3}}
