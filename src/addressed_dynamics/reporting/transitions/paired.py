"""The table of errors in multiples of the addressed ensemble's, on the same held-out episodes."""

from __future__ import annotations

from addressed_dynamics.evaluation.common.bootstrap import COVERAGE, DRAWS, FEWEST_EPISODES
from addressed_dynamics.evaluation.transitions.records import Evaluation, RatioResult
from addressed_dynamics.reporting.common.blocks import Column, Row, Table
from addressed_dynamics.reporting.common.numbers import MISSING, percent, significant
from addressed_dynamics.reporting.transitions.rollout_tables import row_kind


def paired_table(evaluation: Evaluation) -> Table | None:
    """Return how many times the addressed ensemble's errors each candidate's are; None if nothing is known of it."""
    known = {
        name: (candidate, candidate.beside_ensemble)
        for name, candidate in evaluation.candidates.items()
        if candidate.beside_ensemble is not None
    }
    if not known:
        return None
    columns = (
        Column("Model", numeric=False),
        Column("mean", "one step, times the ensemble's"),
        Column(_INTERVAL, "one step, times the ensemble's"),
        Column("median", "rollouts, times the ensemble's"),
        Column(_INTERVAL, "rollouts, times the ensemble's"),
    )
    rows = [
        Row((candidate.label, *_cells(beside.one_step), *_cells(beside.rollouts)), row_kind(name))
        for name, (candidate, beside) in known.items()
    ]
    caption = (
        f"Errors in multiples of the addressed ensemble's, on the same held-out episodes: one step ahead the mean "
        f"{evaluation.loss.upper()} of states scaled to [0, 1], in rollouts the median over rollouts of the mean "
        f"squared error of all dimensions, in ranges. The intervals hold {_INTERVAL} of {DRAWS:,} draws of as many "
        f"episodes ({evaluation.test.episodes:,} one step ahead), the same for both models: an interval with 1 in it "
        "says that other episodes could turn the comparison round. They do not tell how a training from another seed "
        f"would differ. With fewer than {FEWEST_EPISODES} episodes there is none."
    )
    return Table(caption, columns, tuple(rows))


_INTERVAL = percent(COVERAGE, 0)


def _cells(ratio: RatioResult | None) -> tuple[str, str]:
    if ratio is None:
        return MISSING, MISSING
    return significant(ratio.value), f"{significant(ratio.low)} – {significant(ratio.high)}"
