"""Training on samples in files: the same bytes as in memory."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from learning import ENSEMBLE, drive, sail

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.base.params.training import AddressingTraining, EnsembleSection
from addressed_dynamics.episodes.parquet import (
    FOLDER,
    TransitionStream,
    TransitionTable,
    load_transitions,
    table_writer,
)
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.common.spool import Mapped, Spool, beside
from addressed_dynamics.features.common.training_data import TrainingData
from addressed_dynamics.features.transitions import kind, spec
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.sources.transitions.params import ExperimentParams, FeatureSection
from addressed_dynamics.training import clustering, epochs, staging
from addressed_dynamics.training.addressing import train_addressing
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.ensemble import Binning, evaluate_profiles, train_ensemble
from addressed_dynamics.training.epochs import Epoch

WORLD = drive((20, 3, 31, 1, 40))


def write(folder: Path, split: str, *worlds: Transitions, rows: int = 7) -> None:
    """Write tables whose row groups end wherever they do."""
    for number, world in enumerate(worlds):
        path = folder / FOLDER / split / f"log-{number}.parquet"
        code = np.full(len(world), ("train", "validation", "test").index(split), np.int8)
        with table_writer(path, world.spec, row_group_rows=rows) as add:
            add(TransitionTable(world, code, "made"))


@pytest.fixture
def tables(tmp_path: Path) -> Path:
    later = drive((9, 26), seed=3)
    write(tmp_path, "train", WORLD, replace(later, episode=later.episode + 100))
    write(tmp_path, "validation", drive((15,) * 4, seed=1))
    return tmp_path


def load(tables: Path, memory: int, history: int | str, horizon: int = 1) -> TrainingData[FeatureSpec]:
    sections = ExperimentParams.model_construct(ensemble=EnsembleSection(horizon=horizon))
    features = FeatureSection.model_validate({"target": "change", "history": history})
    return kind.load_training_data(tables, sections, features, spool=Spool(tables / "spools", memory))


def weights(epoch: Epoch) -> list[bytes]:
    return [parameter.detach().numpy().tobytes() for parameter in epoch.network.parameters()]


def trained(
    data: TrainingData[FeatureSpec], binning: Binning, checkpoint: Checkpoint | None = None, **update: Any
) -> list[Any]:
    """Weights and metrics of an ensemble and of what addresses it."""
    params = ENSEMBLE.model_copy(update={"epochs": 3, "cluster_epochs": 3, **update})
    *_, last = train_ensemble(
        data.train, data.validation, params, seed=0, loss_unit=1.0, binning=binning, checkpoint=checkpoint
    )
    profiles = [
        evaluate_profiles(last.network, part, "mse", make=beside(part, "profiles"))
        for part in (data.train, data.validation)
    ]
    settings = AddressingTraining(hidden=(8,), epochs=2, tie_share=0.5)
    *_, addressing = train_addressing(
        data.train, profiles[0], data.validation, profiles[1], settings, seed=0, variant="cost_sensitive"
    )
    return [weights(last), last.metrics, weights(addressing), addressing.metrics]


@pytest.mark.parametrize(
    ("history", "binning", "update", "cache"),
    [
        (1, "equal", {"shares": 2}, 0),
        (3, "equal", {"overlap": 0.3, "cluster_epochs": 2}, 0),
        (1, "lowest_loss", {}, 0),
        (3, "random", {}, 0),
        (1, "equal", {}, 2**40),
        (2, "equal", {"horizon": 3}, 2**40),
        (1, "equal", {"temperature": 1.0, "horizon": 2}, 2**40),
    ],
)
def test_in_memory_and_in_files_the_same_bytes_are_trained(
    tables: Path, monkeypatch: pytest.MonkeyPatch, history: int, binning: Binning, update: dict[str, Any], cache: int
) -> None:
    # So small that every loop over blocks has several.
    monkeypatch.setattr(clustering, "ROWS_ON_CPU", 16)
    monkeypatch.setattr(epochs, "BLOCK_ROWS", 16)
    # Without a cache, samples are laid out in the order of the epoch.
    monkeypatch.setattr(staging, "free_memory", lambda: cache)
    monkeypatch.setattr(staging, "STRETCH", 40)
    monkeypatch.setattr(staging, "READ_ROWS", 16)
    laid_out, write_samples = list[Samples](), staging._Staged._write

    def noted(self: Any, samples: Samples) -> None:
        laid_out.append(samples)
        write_samples(self, samples)

    monkeypatch.setattr(staging._Staged, "_write", noted)
    in_memory, in_files = (load(tables, each, history, update.get("horizon", 1)) for each in (2**40, 0))
    assert isinstance(in_files.train.y, Mapped)
    assert not isinstance(in_memory.train.y, Mapped)
    assert in_files.features == in_memory.features
    assert in_files.fingerprint == in_memory.fingerprint
    assert in_files.dropped == in_memory.dropped
    assert trained(in_files, binning, **update) == trained(in_memory, binning, **update)
    assert bool(laid_out) == (not cache)
    in_files.discard()
    assert list((tables / "spools").iterdir()) == []


def test_a_training_that_was_cut_off_finds_its_samples_again(tables: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = load(tables, 0, 3)
    checkpoint = Checkpoint(tables / "kept.safetensors")
    params = ENSEMBLE.model_copy(update={"epochs": 3, "cluster_epochs": 3})
    next(train_ensemble(data.train, data.validation, params, seed=0, loss_unit=1.0, checkpoint=checkpoint))

    def written_again(*_: object, **__: object) -> None:
        raise AssertionError

    with monkeypatch.context() as patch:
        patch.setattr(kind, "write_samples", written_again)
        again = load(tables, 0, 3)
    assert trained(again, "equal", checkpoint) == trained(load(tables, 2**40, 3), "equal")


def test_how_many_frames_are_given_is_chosen_alike(tables: Path) -> None:
    in_memory, in_files = (load(tables, each, "auto") for each in (2**40, 0))
    assert in_files.choices == in_memory.choices
    assert in_files.choices["history"].tried
    assert len(list((tables / "spools").iterdir())) == 2


@pytest.mark.parametrize("cuts", [(1,), (5, 6, 50), (20, 23, 54, 55)])
def test_statistics_do_not_depend_on_the_parts_that_transitions_come_in(
    monkeypatch: pytest.MonkeyPatch, cuts: tuple[int, ...]
) -> None:
    monkeypatch.setattr(spec, "STATISTICS_ROWS", 16)
    for world in (WORLD, sail((30, 65))):
        bounds = [0, *cuts, len(world)]
        parts = [world.select(slice(*each)) for each in pairwise(bounds)]
        params = FeatureSection(history=1).with_history(2)
        assert fit_features(parts, params) == fit_features(world, params)
        features = fit_features(world, params)
        assert features.samples(parts).fingerprint() == features.samples(world).fingerprint()


def test_a_stream_is_what_the_tables_hold(tables: Path) -> None:
    stream = TransitionStream(tables, "train")
    parts = [*stream]
    assert len(parts) > 5
    whole, expected = Transitions.concatenate(parts), load_transitions(tables, "train")
    assert all(np.array_equal(getattr(whole, name), getattr(expected, name)) for name in ("episode", "observation"))
    assert stream.rows == len(expected)


def test_a_stream_with_a_broken_episode_or_one_that_comes_twice_is_refused(tmp_path: Path) -> None:
    world = drive((20,))
    write(tmp_path / "twice", "train", world, drive((5,), seed=1))
    with pytest.raises(TableError, match="episode 0"):
        [*TransitionStream(tmp_path / "twice", "train")]
    folder = tmp_path / "gap" / FOLDER / "train"
    code = np.zeros(7, np.int8)
    with table_writer(folder / "log.parquet", world.spec, row_group_rows=7) as add:
        add(TransitionTable(world.select(slice(7)), code, "made"))
        add(TransitionTable(world.select(slice(8, 15)), code, "made"))
    with pytest.raises(TableError, match="is not followed by the next step of its episode"):
        [*TransitionStream(tmp_path / "gap", "train")]
