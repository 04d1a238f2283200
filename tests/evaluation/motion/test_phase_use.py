import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.episodes.layout import GAITS
from addressed_dynamics.evaluation.motion.phase_use import PHASE_BINS, PhaseUse, phase_use

WALK, JOG = GAITS.index("walk"), GAITS.index("jog")


def measured(chosen: np.ndarray, phase: np.ndarray, gait: np.ndarray | None = None, members: int = 4) -> PhaseUse:
    gait = np.full(len(chosen), WALK) if gait is None else gait
    return phase_use(chosen, phase, gait, members, np.random.default_rng(0))[0]


def random_phases(rows: int) -> np.ndarray:
    return np.random.default_rng(1).random(rows)


def test_members_that_share_out_the_cycle_in_quarters_are_decided_by_the_phase() -> None:
    phase = random_phases(4000)
    use = measured((4 * phase).astype(np.int64), phase)
    assert use.information_share == pytest.approx(1.0)
    assert use.choice_bits == pytest.approx(2.0, abs=0.01)
    assert use.chance_share < 0.02
    assert [round(each.once_phase, 1) for each in use.concentration] == [0.1, 0.4, 0.6, 0.9]
    # Phases spread evenly over a quarter of the cycle: sin(pi/4) / (pi/4).
    assert [each.once for each in use.concentration] == pytest.approx([0.9] * 4, abs=0.01)


def test_a_member_of_both_steps_is_concentrated_at_twice_the_frequency_only() -> None:
    phase = random_phases(4000)
    use = measured((8 * phase).astype(np.int64) % 4, phase)
    assert max(each.once for each in use.concentration) < 0.05
    assert min(each.twice for each in use.concentration) > 0.85
    assert [each.twice_phase for each in use.concentration] == pytest.approx([1 / 16, 3 / 16, 5 / 16, 7 / 16], abs=0.01)


def test_members_chosen_regardless_of_the_phase_tell_no_more_of_it_than_chance() -> None:
    chosen = np.random.default_rng(2).integers(0, 4, 4000)
    use = measured(chosen, random_phases(4000))
    assert use.information_share < use.chance_share_p95 * 1.2
    assert use.information_share == pytest.approx(use.chance_share, abs=0.004)


def test_one_member_that_always_serves_tells_nothing() -> None:
    use = measured(np.full(100, 2), random_phases(100))
    assert (use.choice_bits, use.information_share, use.chance_share) == (0.0, 0.0, 0.0)
    assert [each.member for each in use.concentration] == [2]


def test_members_that_share_out_the_gaits_and_not_the_phase_do_not_count_as_using_it() -> None:
    # In each gait the phases are other ones, so that over all rows together the member would tell the phase.
    phase = np.concatenate([random_phases(2000) / 2, random_phases(2000) / 2 + 0.5])
    gait = np.repeat([WALK, JOG], 2000)
    everything, *gaits = phase_use((gait == JOG).astype(np.int64), phase, gait, 2, np.random.default_rng(0))
    assert everything.information_bits == 0.0
    assert [(use.gait, use.rows) for use in gaits] == [("walk", 2000), ("jog", 2000)]


@given(st.integers(0, 1000), st.integers(1, 5))
@settings(max_examples=25, deadline=None)
def test_information_agrees_with_the_sum_over_all_pairs(seed: int, members: int) -> None:
    generator = np.random.default_rng(seed)
    chosen, phase = generator.integers(0, members, 60), generator.random(60)
    use = measured(chosen, phase, members=members)
    bins = [int(value * PHASE_BINS) for value in phase]
    expected = 0.0
    for member in range(members):
        for interval in range(PHASE_BINS):
            both = np.mean([m == member and b == interval for m, b in zip(chosen, bins, strict=True)])
            if both:
                expected += both * np.log2(both / (np.mean(chosen == member) * np.mean(np.array(bins) == interval)))
    assert use.information_bits == pytest.approx(expected, abs=1e-9)
    assert np.array(use.counts).sum() == 60


def test_the_end_of_a_cycle_counts_as_its_beginning() -> None:
    use = measured(np.array([0, 1]), np.array([0.0, 1.0]))
    assert use.counts[0][0] == use.counts[1][0] == 1


def test_the_measures_can_be_written_as_json_and_drawn() -> None:
    use = measured(np.array([0, 1, 1]), np.array([0.1, 0.5, 0.9]))
    assert json.loads(json.dumps(dataclasses.asdict(use), allow_nan=False))["rows"] == 3
    share = use.arrays()["member_share"]
    assert share.shape == (4, PHASE_BINS)
    assert share.sum() == 3


@pytest.mark.parametrize(
    ("chosen", "phase", "gait", "complaint"),
    [
        ([], [], [], "at least one row"),
        ([0, 1], [0.5], [1, 1], "2, 1 and 2"),
        ([4], [0.5], [1], "members should be from 0 to 3"),
        ([0], [1.5], [1], "phases should be from 0 to 1"),
        ([0], [float("nan")], [1], "phases should be from 0 to 1"),
        ([0], [0.5], [6], "gaits should be from 0 to 5"),
    ],
)
def test_rows_that_make_no_sense_are_refused(
    chosen: list[int], phase: list[float], gait: list[int], complaint: str
) -> None:
    with pytest.raises(EvaluationError, match=complaint):
        measured(np.array(chosen, np.int64), np.array(phase), np.array(gait, np.int64))
