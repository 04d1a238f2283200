"""MotionModel: its modes, its files, and what it refuses."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from motions import make_motion

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.files import write_json
from addressed_dynamics.features.motion.features import MotionFeatures, fit_motion_features
from addressed_dynamics.networks.files import SavedNetwork, save_network
from addressed_dynamics.networks.spline import catmull_rom
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.delivery import Choice, Delivered, write_delivered
from addressed_dynamics.simulators.modes import MODES
from addressed_dynamics.simulators.motion import MOTION_MODES, MotionMode, MotionModel
from addressed_dynamics.sources.motion.params import MotionFeatureParams

MOTION = make_motion(rows=24)
X = torch.from_numpy(MOTION.x)
FEATURES = fit_motion_features(MOTION, MotionFeatureParams(target="change"))


def stack(members: int, *widths: int, seed: int = 0) -> StackedMLP:
    return StackedMLP(members, widths, "elu", torch.Generator().manual_seed(seed)).requires_grad_(False)


def addressed(mode: MotionMode = "argmax") -> MotionModel:
    return MotionModel(FEATURES, stack(3, 342, 8, 311), stack(1, 342, 8, 3, seed=1), mode=mode)


def phased() -> MotionModel:
    return MotionModel(FEATURES, stack(4, 342, 8, 311), mode="phase")


def test_argmax_gives_the_prediction_of_the_member_that_is_addressed() -> None:
    model = addressed()
    chosen = model.member_predictions(X)[model.address(X), torch.arange(len(X))]
    torch.testing.assert_close(model.predict(X), chosen)


def test_a_mixture_is_the_weighted_mean_of_the_members_predictions() -> None:
    model = addressed()
    mean = torch.einsum("rm,mro->ro", model.probabilities(X), model.member_predictions(X))
    torch.testing.assert_close(model.predict(X, "mixture"), mean, atol=1e-4, rtol=1e-4)


def test_sampling_follows_the_probabilities_and_repeats_with_the_generator() -> None:
    model = addressed()
    first, second = (model.predict(X, "sample", generator=torch.Generator().manual_seed(3)) for _ in range(2))
    assert torch.equal(first, second)
    assert not torch.equal(first, model.predict(X, "sample", generator=torch.Generator().manual_seed(4)))


def test_a_blend_of_equal_members_is_that_member() -> None:
    networks = stack(3, 342, 8, 311)
    for parameter in networks.parameters():
        parameter[1:] = parameter[:1]
    model = MotionModel(FEATURES, networks, stack(1, 342, 8, 3))
    torch.testing.assert_close(model.predict(X, "blend"), model.predict(X), atol=1e-4, rtol=1e-4)


def test_a_phase_functioned_model_follows_the_phase() -> None:
    model, phase = phased(), torch.linspace(0, 1, len(X))
    output = model.networks.forward_blended(FEATURES.encode(X), catmull_rom(phase))
    torch.testing.assert_close(model.predict(X, phase=phase), FEATURES.decode(output, X))
    assert not torch.allclose(model.predict(X, phase=phase), model.predict(X, phase=phase + 0.3))


def test_arrays_give_arrays_and_one_network_needs_no_addressing() -> None:
    model = MotionModel(FEATURES, stack(1, 342, 8, 311))
    predicted = model.predict(MOTION.x)
    assert isinstance(predicted, np.ndarray)
    np.testing.assert_array_equal(predicted, model.predict(X).numpy())


def test_a_predictor_takes_inputs_and_phases() -> None:
    phase = torch.linspace(0, 1, len(X))
    assert torch.equal(phased().predictor()(X, phase), phased().predict(X, phase=phase))
    assert torch.equal(addressed().predictor("mixture")(X, phase), addressed().predict(X, "mixture"))


@pytest.mark.parametrize("model", [addressed("blend"), phased(), MotionModel(FEATURES, stack(1, 342, 8, 311))])
def test_a_saved_model_predicts_as_before(model: MotionModel, tmp_path: Path) -> None:
    model.save(tmp_path / "model", {"seed": 0})
    loaded = MotionModel.load(tmp_path / "model")
    phase = torch.linspace(0, 1, len(X))
    assert loaded.mode == model.mode
    assert torch.equal(loaded.predict(X, phase=phase), model.predict(X, phase=phase))


@pytest.mark.parametrize(("build", "match"), [
    (lambda f: MotionModel(f, stack(3, 342, 8, 311)), "3 members need an addressing network .* is missing"),
    (lambda f: MotionModel(f, stack(3, 342, 8, 311), stack(1, 342, 2)), "is one from 342 to 2"),
    (lambda f: MotionModel(f, stack(1, 5, 8, 311)), "map 5 inputs to 311 outputs"),
    (lambda f: MotionModel(f, stack(3, 342, 8, 311), mode="phase"), "has 4 control points"),
])  # fmt: skip
def test_networks_that_do_not_fit_are_refused(build: Callable[[MotionFeatures], object], match: str) -> None:
    with pytest.raises(ModelError, match=match):
        build(FEATURES)


@pytest.mark.parametrize(("mode", "phase", "match"), [
    (None, None, "there is none"),
    (None, torch.zeros(3), r"they have shape \(3,\)"),
    ("argmax", torch.zeros(48), "has no mode 'argmax'"),
])  # fmt: skip
def test_a_phase_functioned_model_asks_for_phases(mode: MotionMode | None, phase: torch.Tensor, match: str) -> None:
    with pytest.raises(ModelError, match=match):
        phased().predict(X, mode, phase=phase)


def test_a_mode_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ModelError, match=", ".join(MOTION_MODES)):
        addressed().predict(X, "guess")  # type: ignore[call-overload] # that is the point


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="no such model folder"):
        MotionModel.load(tmp_path / "nothing")


def test_features_of_the_model_are_those_it_was_saved_with(tmp_path: Path) -> None:
    addressed().save(tmp_path / "model", {})
    loaded = MotionModel.load(tmp_path / "model")
    assert isinstance(loaded.features, MotionFeatures)
    assert loaded.features == FEATURES


def test_a_folder_of_models_gives_the_seed_and_the_mode_that_evaluation_delivered(tmp_path: Path) -> None:
    for seed in (0, 2):
        model = MotionModel(FEATURES, stack(3, 342, 8, 311, seed=seed), stack(1, 342, 8, 3, seed=seed))
        assert model.addressing is not None
        save_network(tmp_path / "ensemble" / f"seed-{seed}", SavedNetwork(model.networks, FEATURES, {}))
        save_network(tmp_path / "addressing" / f"seed-{seed}" / "plain", SavedNetwork(model.addressing, FEATURES, {}))
    index = {"format": 1, "delivered": {"0": "plain", "2": "plain"}, "variants": ["plain"]}
    write_json(tmp_path / "addressing" / "addressing.json", index)
    write_delivered(tmp_path, Delivered(2, None, "mixture"))
    loaded = MotionModel.load(tmp_path)
    assert loaded.mode == "mixture"
    assert torch.equal(loaded.networks.weights[0], stack(3, 342, 8, 311, seed=2).weights[0])
    assert MotionModel.load(tmp_path, seed=0).mode == "argmax"
    assert MotionModel.load(tmp_path, mode="blend").mode == "blend"
    said = repr(MotionModel.load(tmp_path))
    assert said.startswith("MotionModel(candidate ensemble, seed 2, variant plain; mode mixture; inputs trajectory_pos")


def test_what_is_recommended_is_loaded_by_that_name(tmp_path: Path) -> None:
    model = addressed()
    assert model.addressing is not None
    save_network(tmp_path / "ensemble" / "seed-0", SavedNetwork(model.networks, FEATURES, {}))
    save_network(tmp_path / "addressing" / "seed-0" / "plain", SavedNetwork(model.addressing, FEATURES, {}))
    index = {"format": 1, "delivered": {"0": "plain"}, "variants": ["plain"]}
    write_json(tmp_path / "addressing" / "addressing.json", index)
    phased().save(tmp_path / "baselines" / "phase_functioned" / "seed-3", {})
    write_json(tmp_path / "baselines" / "baselines.json", {"format": 1, "trained": ["phase_functioned/seed-3"]})
    for best, mode in ((Choice("phase_functioned", 3, None, None), "phase"),
                       (Choice("ensemble", 0, None, "blend"), "blend")):  # fmt: skip
        write_delivered(tmp_path, Delivered(0, None, "mixture", best))
        recommended = MotionModel.load(tmp_path, candidate="recommended")
        assert recommended.mode == mode
        assert str(recommended.origin).startswith(f"candidate {best.candidate}, seed {best.seed}")
        assert MotionModel.load(tmp_path).mode == "mixture"


def test_a_saved_model_is_loaded_in_any_mode_that_it_knows(tmp_path: Path) -> None:
    addressed("mixture").save(tmp_path / "addressed", {})
    for mode in MODES:
        loaded = MotionModel.load(tmp_path / "addressed", mode=mode)
        assert torch.equal(loaded.predict(X[:2], generator=torch.Generator().manual_seed(0)),
                           addressed(mode).predict(X[:2], generator=torch.Generator().manual_seed(0)))  # fmt: skip
    assert MotionModel.load(tmp_path / "addressed").mode == "mixture"
    phased().save(tmp_path / "phased", {})
    assert MotionModel.load(tmp_path / "phased", mode="phase").mode == "phase"
    MotionModel(FEATURES, stack(1, 342, 8, 311)).save(tmp_path / "single", {})
    refused = [("addressed", "phase", "a model of mode 'mixture' has no mode 'phase'"),
               ("addressed", "guess", "no addressing mode 'guess' .modes: argmax, .*, phase"),
               ("phased", "argmax", "a model of mode 'phase' has no mode 'argmax'"),
               ("single", "mixture", "a single network, which has no modes")]  # fmt: skip
    for name, asked, match in refused:
        with pytest.raises(ModelError, match=match):
            MotionModel.load(tmp_path / name, mode=asked)  # type: ignore[arg-type] # that is the point


def test_a_saved_model_leaves_no_candidate_seed_or_variant_to_choose(tmp_path: Path) -> None:
    addressed().save(tmp_path / "model", {})
    with pytest.raises(ModelError, match="this is one saved model, of which no candidate or seed can be chosen"):
        MotionModel.load(tmp_path / "model", candidate="relu_512", seed=3)
    with pytest.raises(ModelError, match="of which no variant can be chosen"):
        MotionModel.load(tmp_path / "model", variant="plain")


def test_motion_models_that_name_their_runs_are_said_to_be_of_an_earlier_version(tmp_path: Path) -> None:
    save_network(tmp_path / "ensemble" / "seed-0", SavedNetwork(addressed().networks, FEATURES, {}))
    write_json(tmp_path / "ensemble" / "seed-0" / "mlflow_run.json", {"run_id": "1"})
    with pytest.raises(ModelError, match=r"^[^\n]*an earlier version [^\n]*, or load one by its 'seed'$"):
        MotionModel.load(tmp_path)


def test_one_frame_is_answered_without_the_axis_of_a_batch() -> None:
    model, frame = addressed("mixture"), X[1]
    for given, kind in ((frame, torch.Tensor), (frame.numpy(), np.ndarray), (frame.tolist(), np.ndarray)):
        found = (
            model.predict(given),
            model.member_predictions(given),
            model.probabilities(given),
            model.address(given),
        )
        batch = (model.predict(X), model.member_predictions(X), model.probabilities(X), model.address(X))
        rows = (batch[0][1], batch[1][:, 1], batch[2][1], batch[3][1])
        for one, row in zip(found, rows, strict=True):
            assert isinstance(one, kind)
            assert one.shape == row.shape
            np.testing.assert_allclose(np.asarray(one), row.numpy(), rtol=1e-4, atol=1e-3)


def test_a_closed_loop_that_has_left_all_bounds_goes_on() -> None:
    lost = torch.full((2, 342), torch.nan)
    for mode in MODES:
        assert addressed().predictor(mode)(lost, torch.zeros(2)).isnan().all()


def test_lists_and_one_frame_are_taken_too_and_a_model_says_what_it_is() -> None:
    model, expected = addressed("mixture"), addressed("mixture").predict(X)
    np.testing.assert_allclose(model.predict(X.tolist()), expected.numpy(), rtol=1e-6)
    np.testing.assert_allclose(model.predict(MOTION.x[1]), expected[1].numpy(), rtol=1e-4, atol=1e-4)
    np.testing.assert_array_equal(model.address(MOTION.x), model.address(X).numpy())
    assert repr(model).startswith("MotionModel(mode mixture; inputs trajectory_position_x, ")
    assert repr(model).endswith("; 3 x (342, 8, 311), addressing (342, 8, 3); 19,400 parameters)")
