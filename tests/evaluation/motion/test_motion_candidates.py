"""Models of motion that are compared: what is loaded from a folder of models, under which names."""

import pickle
import shutil
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
import torch
from motions import make_motion
from pfnn_data import PFNN_DATA, needs_pfnn_data

from addressed_dynamics.base.errors import ModelError, TrainingError
from addressed_dynamics.base.files import write_json
from addressed_dynamics.evaluation.motion.baselines import mean_outputs
from addressed_dynamics.evaluation.motion.candidates import (
    BASELINE_LABELS,
    MotionCandidate,
    baseline_candidates,
    ensemble_candidates,
    load_motion_ensembles,
    reference_candidates,
)
from addressed_dynamics.features.motion.features import fit_motion_features
from addressed_dynamics.networks.files import SavedNetwork, save_network
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.modes import MODES
from addressed_dynamics.simulators.motion import MotionMode, MotionModel
from addressed_dynamics.sources.motion.params import MotionFeatureParams

MOTION = make_motion(48)
X, PHASE = torch.from_numpy(MOTION.x), torch.from_numpy(MOTION.phase) % 1.0
FEATURES = fit_motion_features(MOTION, MotionFeatureParams(target="trajectory_change"))


def stack(members: int, *widths: int, seed: int = 0) -> StackedMLP:
    return StackedMLP(members, widths, "elu", torch.Generator().manual_seed(seed)).requires_grad_(False)


@pytest.fixture
def models(tmp_path: Path) -> Path:
    """A folder of models as the training stages write it: ensembles of two seeds, and two baselines."""
    for seed in (3, 1):
        save_network(
            tmp_path / "ensemble" / f"seed-{seed}", SavedNetwork(stack(2, 342, 8, 311, seed=seed), FEATURES, {})
        )
        save_network(
            tmp_path / "addressing" / f"seed-{seed}" / "plain",
            SavedNetwork(stack(1, 342, 4, 2, seed=seed + 10), FEATURES, {}),
        )
    write_json(tmp_path / "ensemble" / "ensemble.json", {"seeds": [3, 1]})
    index = {"format": 1, "delivered": {"3": "plain", "1": "plain"}, "variants": ["plain"]}
    write_json(tmp_path / "addressing" / "addressing.json", index)
    baselines: dict[str, tuple[int, MotionMode]] = {"phase_functioned": (4, "phase"), "same_size": (1, "argmax")}
    for name, (members, mode) in baselines.items():
        MotionModel(FEATURES, stack(members, 342, 8, 311), mode=mode).save(
            tmp_path / "baselines" / f"{name}/seed-3", {}
        )
    write_json(tmp_path / "baselines" / "baselines.json", {"trained": ["phase_functioned/seed-3", "same_size/seed-3"]})
    return tmp_path


def test_the_ensembles_of_all_seeds_come_in_every_mode_the_delivered_seed_first(models: Path) -> None:
    ensembles = load_motion_ensembles(models)
    assert list(ensembles) == [3, 1]
    found = ensemble_candidates(ensembles)
    assert [each.name for each in found] == [f"ensemble/{mode}/seed-{seed}" for mode in MODES for seed in (3, 1)]
    assert {each.parameters for each in found} == {2 * (343 * 8 + 9 * 311) + 343 * 4 + 5 * 2}
    addressing, member = 342 * 4 + 4 * 2, 342 * 8 + 8 * 311
    costs = {each.group: each.multiply_adds for each in found}
    assert costs["ensemble/argmax"] == costs["ensemble/sample"] == addressing + member
    assert costs["ensemble/mixture"] == addressing + 2 * member + 2 * 311
    assert costs["ensemble/blend"] == addressing + 2 * member + 2 * (8 + 311)
    assert len({each.label for each in found}) == len(MODES)


@pytest.mark.parametrize("mode", [mode for mode in MODES if mode != "sample"])
def test_a_candidate_predicts_as_its_model_does_in_its_mode(models: Path, mode: MotionMode) -> None:
    ensembles = load_motion_ensembles(models)
    (found,) = [each for each in ensemble_candidates(ensembles) if each.name == f"ensemble/{mode}/seed-1"]
    assert torch.equal(found.predictor(X, PHASE), ensembles[1].predict(X, mode))


def test_sampling_repeats_from_one_evaluation_to_the_next(models: Path) -> None:
    ensembles = load_motion_ensembles(models)
    first, again = (
        next(each for each in ensemble_candidates(ensembles) if each.group == "ensemble/sample") for _ in range(2)
    )
    predicted = first.predictor(X, PHASE)
    assert torch.equal(predicted, again.predictor(X, PHASE))
    assert not torch.equal(predicted, first.predictor(X, PHASE))


def test_baselines_have_the_names_they_were_trained_under_and_predict_in_their_own_mode(models: Path) -> None:
    found = baseline_candidates(models / "baselines", 1000)
    assert [(each.group, each.seed, each.label) for each in found] == [
        (name, 3, BASELINE_LABELS[name]) for name in ("phase_functioned", "same_size")
    ]
    pfnn = MotionModel.load(models / "baselines" / "phase_functioned" / "seed-3")
    assert torch.equal(found[0].predictor(X, PHASE), pfnn.predict(X, phase=PHASE))
    assert found[0].parameters == 4 * (343 * 8 + 9 * 311)
    assert found[0].multiply_adds == 4 * (342 * 8 + 8 * 311) + 4 * (8 + 311)
    assert found[1].multiply_adds == 342 * 8 + 8 * 311


@pytest.mark.parametrize(
    ("own", "label"),
    [
        (5700, "one network, as many parameters as members and addressing together"),
        (9000, "one network, 5,543 parameters, where members and addressing have 9,000"),
    ],
)
def test_one_network_is_called_as_large_as_the_model_only_if_it_is(models: Path, own: int, label: str) -> None:
    folder = models / "baselines"
    shutil.copytree(folder / "same_size", folder / "total_parameters")
    write_json(folder / "baselines.json", {"trained": ["total_parameters/seed-3"]})
    (found,) = baseline_candidates(folder, own)
    assert (found.parameters, found.label) == (343 * 8 + 9 * 311, label)


def test_a_folder_that_lacks_models_is_refused(models: Path) -> None:
    (models / "baselines" / "baselines.json").unlink()
    with pytest.raises(ModelError, match=r"baselines\.json: missing"):
        baseline_candidates(models / "baselines", 1000)
    (models / "addressing" / "addressing.json").unlink()
    with pytest.raises(ModelError, match=r"addressing\.json: missing"):
        load_motion_ensembles(models)


def test_references_need_no_training_and_are_the_same_for_all_seeds() -> None:
    found = reference_candidates(MOTION, make_motion(24, seed=1), None)
    assert [(each.name, each.seed) for each in found] == [("mean", None), ("persistence", None), ("ridge", None)]
    assert [each.parameters for each in found] == [311, 311, 343 * 311]
    assert [each.multiply_adds for each in found] == [None, None, 342 * 311]
    mean = mean_outputs(MOTION.y.mean(axis=0, dtype=np.float64))
    assert torch.equal(found[0].predictor(X, PHASE), mean(X, PHASE))


def test_references_without_validation_frames_are_refused() -> None:
    with pytest.raises(TrainingError, match="there are none"):
        reference_candidates(MOTION, MOTION.select(slice(0)), None)


def test_a_published_network_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="nowhere"):
        reference_candidates(MOTION, MOTION, tmp_path / "nowhere")


@needs_pfnn_data
def test_the_published_network_is_a_candidate_without_a_seed() -> None:
    released = reference_candidates(MOTION, MOTION, PFNN_DATA / "released_control_points.npz")[-1]
    assert (released.name, released.seed) == ("released", None)
    assert released.parameters == 4 * (343 * 512 + 513 * 512 + 513 * 311)
    assert torch.isfinite(released.predictor(X, PHASE)).all()


def test_a_name_holds_the_seed_if_there_is_one() -> None:
    predictor = mean_outputs(np.zeros(311))
    assert MotionCandidate("ridge", None, "", 1, predictor).name == "ridge"
    assert MotionCandidate("same_size", 5, "", 1, predictor).name == "same_size/seed-5"


def test_drawn_members_are_the_same_in_every_copy_of_a_predictor() -> None:
    model = MotionModel(FEATURES, stack(2, 342, 8, 311), stack(1, 342, 4, 2))
    sampling = next(each for each in ensemble_candidates({0: model}) if each.group == "ensemble/sample")
    copies = [deepcopy(sampling.predictor), pickle.loads(pickle.dumps(sampling.predictor))]
    first, second = (each(X, PHASE) for each in copies)
    assert torch.equal(first, second)
    assert not torch.equal(copies[0](X, PHASE), first)
