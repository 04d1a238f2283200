"""What is found wrong with data: against naive loops, by part and as a whole, with its place."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builders import CAR, car_transitions
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.episodes.coverage import CELLS, Occupancy
from addressed_dynamics.episodes.findings import MEANINGS, Finding, find, findings_to_json, refuse_useless
from addressed_dynamics.episodes.quality import Place, Quality, Tally, outlier_fences, outlier_sample
from addressed_dynamics.episodes.statistics import SAMPLE_ROWS, Sample
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, SpaceSpec, Transitions

POSITION, VELOCITY = "observation.position", "observation.velocity"
ARM = SpaceSpec(
    observation=(Dimension("angle", "rad", -np.inf, np.inf),),
    action=ContinuousAction((Dimension("torque", "N m", -2.0, 2.0),)),
    step_seconds=0.1,
)


def smooth(lengths: list[int], spec: SpaceSpec = CAR) -> Transitions:
    """Episodes without fault: waves inside the bounds on an even clock, numbered from 0."""
    parts = []
    for episode, length in enumerate(lengths):
        phase = np.arange(length + 1)[:, None] + np.array([0.3, 1.7])[: len(spec.observation)] + episode
        states = (0.05 * np.sin(phase)).astype(np.float32)
        last = np.arange(length) == length - 1
        continuous = isinstance(spec.action, ContinuousAction)
        parts.append(
            Transitions(
                spec=spec,
                episode=np.full(length, episode),
                step=np.arange(length, dtype=np.int32),
                time_ns=(np.arange(length) * spec.step_seconds * 1e9).round().astype(np.int64),
                observation=states[:-1],
                action=np.sin(phase[:-1, :1]).astype(np.float32) if continuous else np.arange(length) % 3,
                reward=np.zeros(length, dtype=np.float32),
                next_observation=states[1:],
                terminated=last,
                truncated=np.zeros(length, dtype=bool),
            )
        )
    return Transitions.concatenate(parts)


def with_state(whole: Transitions, row: int, dimension: int, value: float) -> Transitions:
    """The same with another value before step `row`, and so after the step before it."""
    before, after = whole.observation.copy(), whole.next_observation.copy()
    before[row, dimension] = value
    if row and whole.episode[row - 1] == whole.episode[row]:
        after[row - 1, dimension] = value
    return replace(whole, observation=before, next_observation=after)


def judged(whole: Transitions) -> Quality:
    return Quality.of(whole, log="a.mcap", fences=outlier_fences(whole.spec, outlier_sample(whole)))


def findings(whole: Transitions, **changes: Any) -> list[Finding]:
    cells = np.ones((len(whole.spec.observation), CELLS), dtype=bool)
    defaults = {"duplicates": Tally(0, len(whole), None), "occupancy": Occupancy(cells, None), "imported": {}}
    return find(judged(whole), whole.spec, **(defaults | changes))


def test_sound_data_has_no_findings() -> None:
    assert findings(smooth([30, 40])) == []
    assert findings(smooth([30, 40], ARM)) == []


def test_a_value_beyond_its_bounds_is_placed() -> None:
    (found,) = findings(with_state(smooth([30, 40]), 35, 1, 0.5))
    assert (found.kind, found.dimension, found.count, found.of) == ("out_of_bounds", VELOCITY, 1, 72)
    assert found.first == Place("a.mcap", episode=1, step=5, value=0.5)
    assert not found.blocking


def test_the_state_after_the_last_step_is_looked_at() -> None:
    whole = smooth([30, 40])
    after = whole.next_observation.copy()
    after[29, 0] = 0.625
    (found,) = findings(replace(whole, next_observation=after))
    assert found.first == Place("a.mcap", episode=0, step=30, value=0.625)


def test_a_bound_itself_is_within_the_bounds_although_it_is_rounded() -> None:
    assert np.float32(-1.2).item() < -1.2
    assert not judged(with_state(smooth([30]), 4, 0, -1.2)).tallies["out_of_bounds", POSITION].count


def test_a_value_far_from_all_others_is_an_outlier_without_bounds() -> None:
    (found,) = findings(with_state(smooth([30, 40], ARM), 7, 0, -5.0))
    assert (found.kind, found.dimension, found.count) == ("outlier", "observation.angle", 1)
    assert found.first == Place("a.mcap", episode=0, step=7, value=-5.0)


def test_a_rare_contact_is_no_outlier() -> None:
    still = np.zeros((40, 1), dtype=np.float32)
    whole = replace(smooth([40], ARM), observation=still, next_observation=still)
    assert not judged(with_state(whole, 20, 0, 1.0)).tallies["outlier", "observation.angle"].count


def test_actions_beyond_their_bounds_are_found() -> None:
    whole = smooth([30], ARM)
    (found,) = findings(replace(whole, action=whole.action * np.float32(2.5)))
    assert (found.kind, found.dimension) == ("out_of_bounds", "action.torque")
    assert found.count == int((abs(whole.action * np.float32(2.5)) > 2).sum())


@pytest.mark.parametrize(
    ("kind", "steps", "blocking"),
    [("jitter", 1.3, False), ("gap", 2.0, False), ("time_backwards", 0.0, True), ("time_backwards", -1.0, True)],
)
def test_an_uneven_clock_is_placed(kind: str, steps: float, blocking: bool) -> None:
    whole = smooth([30, 40])
    time = whole.time_ns.copy()
    time[35:] += round((steps - 1) * (time[35] - time[34]))
    (found,) = findings(replace(whole, time_ns=time))
    assert (found.kind, found.count, found.of, found.blocking) == (kind, 1, 68, blocking)
    assert found.first is not None
    assert (found.first.episode, found.first.step) == (1, 5)
    assert found.first.value == pytest.approx(steps * CAR.step_seconds, abs=1e-8)


def test_a_dimension_that_never_moves_is_told_once_and_blocks_if_none_does() -> None:
    whole = smooth([30, 40])
    for dimension in range(2):
        before, after = whole.observation.copy(), whole.next_observation.copy()
        before[:, dimension] = after[:, dimension] = 0.02
        whole = replace(whole, observation=before, next_observation=after)
        found = findings(whole)
        assert [each.kind for each in found] == ["stuck"] * (dimension + 1)
        assert [each.blocking for each in found] == [dimension == 1] * (dimension + 1)
    assert [each.dimension for each in found] == [POSITION, VELOCITY]


def test_a_dimension_that_is_stuck_in_a_long_episode_is_placed() -> None:
    whole = smooth([19, 20, 30])
    before, after = whole.observation.copy(), whole.next_observation.copy()
    before[:39, 0] = after[:39, 0] = 0.02
    (found,) = findings(replace(whole, observation=before, next_observation=after))
    assert (found.kind, found.dimension, found.count, found.of) == ("stuck_episode", POSITION, 1, 3)
    assert found.first is not None
    assert (found.first.episode, found.first.step) == (1, 0)


def test_an_action_that_is_never_varied_is_found() -> None:
    whole = smooth([30])
    (found,) = findings(replace(whole, action=np.ones(30, dtype=np.int64)))
    assert (found.kind, found.dimension, found.blocking) == ("stuck", "action", False)


def test_what_other_stages_counted_is_among_the_findings() -> None:
    cells = np.zeros((2, CELLS), dtype=bool)
    cells[0], cells[1, 3] = True, True
    found = findings(
        smooth([30]),
        duplicates=Tally(2, 30, Place("a.mcap", 0)),
        occupancy=Occupancy(cells, None),
        imported={"x.mcap": {"read": 7}, "y.mcap": {"dropped_not_finite": 4, "nan": 1, "late": 9, "financed": 3}},
    )
    assert [(each.kind, each.dimension, each.count) for each in found] == [
        ("duplicate", "", 2),
        ("coverage", VELOCITY, CELLS - 1),
        ("non_finite", "", 5),
    ]
    assert found[2].first == Place("y.mcap")


@given(st.lists(st.integers(1, 25), min_size=2, max_size=6), st.integers(0, 2**32 - 1), st.data())
def test_logs_judged_one_by_one_merge_into_the_judgement_of_all(lengths: list[int], seed: int, data: Any) -> None:
    whole = car_transitions(lengths, seed)
    fences = outlier_fences(whole.spec, outlier_sample(whole))
    cut = sum(lengths[: data.draw(st.integers(1, len(lengths) - 1))])
    parts = [whole.select(slice(0, cut)), whole.select(slice(cut, None))]
    first, second = (Quality.of(part, log="a.mcap", fences=fences) for part in parts)
    expected = Quality.of(whole, log="a.mcap", fences=fences)
    merged = first.merge(second)
    assert merged.ranges == expected.ranges
    for key, tally in expected.tallies.items():
        assert merged.tallies[key].count == tally.count, key
        assert merged.tallies[key].first == tally.first, key


@given(st.integers(1, 300), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0]))
def test_quantiles_of_few_rows_are_those_of_a_sorted_list(rows: int, seed: int, share: float) -> None:
    values = np.random.default_rng(seed).normal(size=(rows, 2))
    parts = [Sample.of(values[: rows // 3]), Sample.of(values[rows // 3 :])]
    (found,) = Sample.join(parts).quantiles(share)
    np.testing.assert_array_equal(found, np.quantile(values, share, axis=0, method="inverted_cdf"))


def test_samples_are_joined_at_once_and_in_their_order() -> None:
    values = np.random.default_rng(0).normal(size=(5, 7, 2))
    joined = Sample.join([Sample.of(part) for part in values])
    np.testing.assert_array_equal(joined.values, values.reshape(35, 2))
    np.testing.assert_array_equal(joined.weights, np.ones(35))


def test_quantiles_of_many_rows_weigh_each_part_by_its_rows() -> None:
    values = np.random.default_rng(0).uniform(size=(20 * SAMPLE_ROWS, 1))
    large, small = Sample.of(values), Sample.of(values[: SAMPLE_ROWS // 2] + 10)
    assert len(large.values) == SAMPLE_ROWS
    np.testing.assert_allclose(
        Sample.join([large, small]).quantiles(0.25, 0.5, 0.75)[:, 0], [0.25, 0.5, 0.75], atol=0.05
    )


def test_useless_data_is_refused_in_one_line_and_other_data_is_not() -> None:
    sound = Finding("gap", "", 3, 10, Place("a.mcap", 1, 2, 0.5), blocking=False)
    refuse_useless(Path("raw"), [sound])
    stuck = [Finding("stuck", name, 9, 9, None, blocking=True) for name in (POSITION, VELOCITY)]
    with pytest.raises(TableError) as caught:
        refuse_useless(Path("raw"), [sound, *stuck])
    assert str(caught.value) == (
        "raw: nothing can be learned from this data: observation.position: constant over the whole recording (9 of 9) "
        "and 1 more such findings; mend its source"
    )


def test_a_finding_is_a_sentence_and_json() -> None:
    finding = Finding("gap", "", 3, 10, Place("a.mcap", 1, 2, 0.5), blocking=False)
    assert finding.sentence == "gaps in time inside an episode (3 of 10; first in a.mcap, episode 1, step 2)"
    assert findings_to_json([finding]) == [
        {
            "kind": "gap",
            "dimension": "",
            "count": 3,
            "of": 10,
            "first": {"log": "a.mcap", "episode": 1, "step": 2, "value": 0.5},
            "blocking": False,
            "meaning": MEANINGS["gap"],
        }
    ]


def test_a_bound_that_float32_cannot_hold_bounds_nothing() -> None:
    wide = replace(ARM, observation=(Dimension("angle", "rad", -1e300, 1e300),))
    assert findings(smooth([30], wide)) == []


def windy(wind: np.ndarray, lengths: list[int]) -> Transitions:
    """Sound episodes with a wind that has these values."""
    whole = smooth(lengths)
    spec = replace(CAR, exogenous=(Dimension("wind", "m/s", -20.0, 20.0),))
    return replace(whole, spec=spec, exogenous=wind.astype(np.float32)[:, None])


def test_exogenous_inputs_are_judged_by_bounds_and_by_their_other_values() -> None:
    wind = np.sin(np.arange(70))
    assert findings(windy(wind, [30, 40])) == []
    wind[[35, 50]] = 25.0, 18.0
    beyond, outlier = findings(windy(wind, [30, 40]))
    assert (beyond.kind, beyond.dimension, beyond.first) == (
        "out_of_bounds", "exogenous.wind", Place("a.mcap", episode=1, step=5, value=25.0),
    )  # fmt: skip
    assert (outlier.kind, outlier.dimension, outlier.first) == (
        "outlier", "exogenous.wind", Place("a.mcap", episode=1, step=20, value=18.0),
    )  # fmt: skip


def test_an_exogenous_input_may_hold_still_in_an_episode_but_not_in_the_whole_recording() -> None:
    assert findings(windy(np.repeat([1.0, 2.0], [30, 40]), [30, 40])) == []
    (found,) = findings(windy(np.full(70, 3.0), [30, 40]))
    assert (found.kind, found.dimension, found.blocking) == ("stuck", "exogenous.wind", False)


def test_another_rate_than_the_given_one_is_a_finding_with_the_rate() -> None:
    found = findings(smooth([30]), imported={"a.csv": {}, "b.csv": {"off_rate": 1}}, other_rates={"b.csv": 18.0})
    assert [(each.kind, each.count, each.of, each.first) for each in found if each.kind == "off_rate"] == [
        ("off_rate", 1, 2, Place("b.csv", value=18.0))
    ]
