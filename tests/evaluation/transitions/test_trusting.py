"""Whose trust is calibrated, where it is written, and what it is found to be worth on other episodes."""

import json
from dataclasses import replace

import numpy as np
import pytest
from trusted_models import drifting, linear_model, trusted_model, write_models

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.evaluation.transitions.candidates import Candidate, origin_of, predictor_of
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.trust_records import TrustRecord
from addressed_dynamics.evaluation.transitions.trusting import (
    WINDOW,
    Pair,
    half_widths,
    judge_trust,
    pair_of,
    window_starts,
)
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts, replay_recorded
from addressed_dynamics.networks.files import SavedNetwork, save_network
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.calibrated import write_trust
from addressed_dynamics.simulators.delivery import Choice, Origin
from addressed_dynamics.simulators.trusted import TrustFile, find_trust
from addressed_dynamics.sources.transitions.params import RecordedRollouts, ShiftParams


def candidates() -> list[Candidate]:
    model, partner, _ = trusted_model()
    named = {
        "persistence/seed-0": model, "total_parameters/seed-0": model, "total_parameters/seed-1": partner,
        "same_size/seed-0": partner,
    }  # fmt: skip
    first = AddressedDynamics(model.features, model.ensemble, origin=Origin("ensemble", 0, "plain"))
    own = Candidate("ensemble/argmax", "ensemble", 1, predictor_of(first, "argmax"), first, "argmax")
    hindsight = replace(own, name="ensemble/mean", model=None)
    others = [Candidate(name, name, 1, predictor_of(each, "argmax"), each, "argmax") for name, each in named.items()]
    return [own, hindsight, *others]


def test_a_model_is_held_against_the_same_from_another_seed_else_against_the_ensemble():
    assert [str(origin) for each in candidates() if (origin := origin_of(each))] == [
        "candidate ensemble, seed 0, variant plain", "candidate persistence, seed 0",
        "candidate total_parameters, seed 0", "candidate total_parameters, seed 1", "candidate same_size, seed 0",
    ]  # fmt: skip

    def partner(candidate: str, variant: str | None = None) -> Origin:
        pair = pair_of(candidates(), Choice(candidate, 0, variant, "argmax"))
        assert pair is not None
        return pair.partner_origin

    assert partner("total_parameters") == Origin("total_parameters", 1)
    assert partner("same_size") == Origin("ensemble", 0, "plain")
    assert partner("persistence") == Origin("ensemble", 0, "plain")
    # References say nothing of what the data leave open.
    assert partner("ensemble", "plain").candidate == "total_parameters"
    alone = [each for each in candidates() if each.name in ("ensemble/argmax", "persistence/seed-0")]
    assert pair_of(alone, Choice("ensemble", 0, "plain", "argmax")) is None


def test_trust_is_judged_on_test_episodes_and_under_shifts():
    model, partner, trust = trusted_model()
    own, other = Origin("total_parameters", 0), Origin("total_parameters", 1)
    pair = Pair(model, own, partner, other)
    points = {name: Points.of(drifting(60, seed), model.features) for name, seed in (("validation", 1), ("test", 5))}
    shifts = {"far": drifting(20, 6, scale=30.0), "strong": drifting(20, 7, gain=1.5)}
    kinds = [
        ShiftParams.model_validate(
            {"name": name, "kind": kind, "environment": {"id": "any"}, "behaviour": {"kind": "constant", "action": 0}},
            strict=False,
        )
        for name, kind in (("far", "starts"), ("strong", "mechanics"))
    ]
    errors = {"model": np.array([0.1, 0.5]), "persistence": np.array([0.2, 0.4])}
    record, arrays = judge_trust(pair, trust, points, shifts, kinds, errors)
    read = TrustRecord.model_validate(record)
    assert read.model == "candidate total_parameters, seed 0"
    one_step = next(each for each in read.coverage if (each.steps, each.asked) == (1, 0.9))
    assert one_step.of_all == pytest.approx(0.9, abs=0.03)
    assert one_step.points == len(points["test"])
    assert {each.steps for each in read.coverage} == {1, 10}
    assert read.shifts["strong"].auroc["surprise"] > 0.9
    assert read.shifts["strong"].auroc["trust"] < read.shifts["strong"].auroc["surprise"]
    assert read.shifts["strong"].positive_share > 0.5
    assert "margin" not in read.shifts["far"].auroc
    assert read.break_even_steps == read.compared_steps == 2
    assert 0 <= read.trusted_steps <= read.rollout_steps == 30
    assert read.risk[-1].coverage == 1.0
    assert len(read.places) == 5
    assert list(read.places[0].state) == ["position", "speed"]
    assert arrays["trust_map"].shape == (24, 24)
    assert np.nanmax(arrays["trust_map"]) <= 1.0


@pytest.mark.parametrize(("kind", "length", "shifted"), [("mechanics", WINDOW - 1, 40), ("mechanics", 40, 6)])
def test_episodes_that_are_too_short_for_windows_judge_no_changed_mechanics(kind, length, shifted):
    model, partner, trust = trusted_model()
    pair = Pair(model, Origin("total_parameters", 0), partner, Origin("total_parameters", 1))
    points = {
        name: Points.of(drifting(10, seed, length=length), model.features)
        for name, seed in (("validation", 1), ("test", 5))
    }
    shift = ShiftParams.model_construct(name="other", kind=kind)
    record, _ = judge_trust(pair, trust, points, {"other": drifting(3, 7, length=shifted)}, [shift], {})
    found = TrustRecord.model_validate(record).shifts["other"]
    assert found.positive_share is None
    assert set(found.auroc.values()) == {None}


def test_windows_are_within_episodes_one_after_the_other():
    points = Points.of(drifting(3, 0, length=2 * WINDOW + 5), trusted_model()[0].features)
    length = 2 * WINDOW + 5
    assert window_starts(points).tolist() == [start + each for start in (0, length, 2 * length) for each in (0, WINDOW)]
    assert window_starts(Points.of(drifting(3, 0, length=WINDOW - 1), points.features)).tolist() == []


def replayed(length: int, history: int = 1) -> TrueRollouts:
    test = drifting(25, 5, length=length)
    params = RecordedRollouts(kind="recorded", episodes=25, steps=length - history + 1)
    return replay_recorded(params, test, history, dict.fromkeys(range(25), "alone"))


@pytest.mark.parametrize("history", [1, 3])
def test_intervals_beside_rollouts_are_those_that_a_user_is_given_as_far_as_validation_episodes_reach(history):
    model, partner, trust = trusted_model(history)
    pair = Pair(model, Origin("total_parameters", 0), partner, Origin("total_parameters", 1))
    truth, validation = replayed(40, history), Points.of(drifting(40, 1), model.features)
    half = half_widths(pair, trust, truth, validation)
    history_states, actions, _ = truth.given
    given = model.rollout(history_states, actions, with_trust=True, coverage=0.9)
    # Up to 30 steps are calibrated.
    np.testing.assert_allclose(half[:, :30], ((given.high - given.low) / 2)[:, :30], rtol=2e-3)
    assert np.isinf(half[:, 30:]).all()
    few = np.concatenate([np.arange(19 * 40), *(np.arange(start, start + 7) for start in range(19 * 40, 1600, 40))])
    shorter = half_widths(pair, trust, truth, Points.of(drifting(40, 1).select(few), model.features))
    np.testing.assert_array_equal(shorter[:, : 8 - history], half[:, : 8 - history])
    # Nineteen episodes last longer, which is one too few.
    assert np.isinf(shorter[:, 8 - history :]).all()


def test_the_horizon_of_trust_ends_where_only_a_few_validation_episodes_go_on():
    model, partner, trust = trusted_model()
    pair = Pair(model, Origin("total_parameters", 0), partner, Origin("total_parameters", 1))
    calm = replace(trust, multiples=1e-3 * trust.multiples)
    whole = drifting(40, 1)
    few = np.concatenate([np.arange(19 * 40), *(np.arange(start, start + 7) for start in range(19 * 40, 1600, 40))])
    steps = []
    for validation in (whole, whole.select(few)):
        points = {name: Points.of(each, model.features) for name, each in
                  (("validation", validation), ("test", drifting(60, 5)))}  # fmt: skip
        record, _ = judge_trust(pair, calm, points, {}, [], {})
        steps.append((record["trusted_steps"], record["rollout_steps"]))
    assert steps == [(30, 30), (7, 7)]


def test_too_few_validation_errors_for_an_interval_give_none():
    model, partner, trust = trusted_model()
    pair = Pair(model, Origin("total_parameters", 0), partner, Origin("total_parameters", 1))
    narrow = replace(trust, coverages=(0.2, 0.5), multiples=trust.multiples[:, :2])
    assert half_widths(pair, narrow, replayed(10), Points.of(drifting(40, 1), model.features)) is None


def test_trust_is_read_as_it_was_write_models(tmp_path):
    model, _, _ = trusted_model()
    loaded = AddressedDynamics.load(write_models(tmp_path), candidate="total_parameters")
    test = drifting(5, 3)
    for name in ("trust", "interval"):
        expected, found = (getattr(each, name)(test.observation, test.action) for each in (model, loaded))
        assert np.array_equal(expected, found)
    given = (test.observation, test.action, test.next_observation)
    assert np.array_equal(model.surprise(*given), loaded.surprise(*given))


def test_errors_say_for_which_models_there_is_trust(tmp_path):
    folder, model = write_models(tmp_path), trusted_model()[0]
    other = AddressedDynamics.load(folder, candidate="total_parameters", seed=1)
    with pytest.raises(ModelError, match=r"total_parameters, seed 1, mode argmax: there is one for candidate"):
        other.trust(np.zeros(2), np.zeros(1))
    own = AddressedDynamics.load(folder / "baselines" / "total_parameters" / "seed-0")
    with pytest.raises(ModelError, match=r"seed-0: the trust in a model is not beside it .* load the model from there"):
        own.trust(np.zeros(2), np.zeros(1))
    write_trust(folder, [], "calibration needs at least 2 validation episodes")
    with pytest.raises(ModelError, match="needs at least 2 validation episodes"):
        AddressedDynamics.load(folder, candidate="total_parameters").trust(np.zeros(2), np.zeros(1))
    with pytest.raises(ModelError, match=r"trust: missing, so nobody knows.*dvc repro evaluate@nowhere"):
        find_trust(TrustFile(tmp_path / "nowhere", Origin("ensemble", 0), "argmax"), model)


@pytest.mark.parametrize("number", [0, 1])
def test_trust_in_models_that_were_trained_anew_since_is_refused(tmp_path, number):
    folder, model = write_models(tmp_path), trusted_model()[0]
    other = SavedNetwork(linear_model(model.features, drifting(10, 9)).ensemble, model.features, {})
    save_network(folder / "baselines" / "total_parameters" / f"seed-{number}" / "network", other)
    with pytest.raises(ModelError, match="calibrated for another model"):
        AddressedDynamics.load(folder, candidate="total_parameters").trust(np.zeros(2), np.zeros(1))


def test_trust_that_names_no_model_to_compare_with_is_one_line(tmp_path):
    folder = write_models(tmp_path)
    (place,) = (folder / "trust").glob("*/trust.json")
    place.write_text(json.dumps(json.loads(place.read_text()) | {"partner": {"which": 1}}))
    with pytest.raises(ModelError, match=r"incomplete or malformed .*'which'"):
        AddressedDynamics.load(folder, candidate="total_parameters").trust(np.zeros(2), np.zeros(1))


@pytest.mark.parametrize("name", ["trust.json", "trust.safetensors"])
def test_damaged_trust_is_one_line(tmp_path, name):
    folder = write_models(tmp_path)
    (place,) = (each for each in (folder / "trust").iterdir() if each.is_dir())
    (place / name).write_bytes(b"{}")
    with pytest.raises(ModelError, match=str(place)) as caught:
        AddressedDynamics.load(folder, candidate="total_parameters").trust(np.zeros(2), np.zeros(1))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("scale", "kind", "bad"), [(0.01, "starts", "worst"), (1.0, "starts", "validation")])
def test_bad_predictions_are_told_from_good_ones_where_none_is_as_bad_as_in_validation(scale, kind, bad):
    model, partner, trust = trusted_model()
    pair = Pair(model, Origin("total_parameters", 0), partner, Origin("total_parameters", 1))
    validation, test = drifting(60, 1), drifting(20, 5)
    # A hundredth of the noise: no error is above the 99th percentile of validation errors.
    told = model.predict(test.observation, test.action)
    test.next_observation[:] = told + scale * (test.next_observation - told)
    points = {"validation": Points.of(validation, model.features), "test": Points.of(test, model.features)}
    shift = ShiftParams.model_validate(
        {"name": "same", "kind": kind, "environment": {"id": "any"}, "behaviour": {"kind": "constant", "action": 0}},
        strict=False,
    )
    record, _ = judge_trust(pair, trust, points, {"same": test}, [shift], {"model": np.ones(2)})
    found = TrustRecord.model_validate(record).shifts["same"]
    assert found.bad == bad
    assert all(area is not None and 0 <= area <= 1 for area in found.auroc.values())
    assert (found.positive_share == 0.0) == (bad == "worst")
