"""All candidates in one table: what each costs, its error of a step, and how long its rollouts hold."""

from __future__ import annotations

from collections.abc import Mapping

from addressed_dynamics.evaluation.transitions.horizons import LOST_PERCENT
from addressed_dynamics.evaluation.transitions.records import CandidateResult, Evaluation
from addressed_dynamics.reporting.common.blocks import Column, Row, Table
from addressed_dynamics.reporting.common.candidates import Effort, effort_of
from addressed_dynamics.reporting.common.numbers import MISSING, count, significant
from addressed_dynamics.reporting.transitions.rollout_tables import row_kind
from addressed_dynamics.reporting.transitions.tables import HINDSIGHT, NOISE_FLOOR, noise_words

COLUMNS = (
    Column("Model", numeric=False),
    Column("parameters"),
    Column("multiply-adds a step"),
    Column("updates"),
    Column("error one step, %"),
    Column("horizon, s"),
)


def overview_table(evaluation: Evaluation, efforts: Mapping[str, Effort]) -> Table | None:
    """Return costs, error and horizon of all candidates, and the noise floor; None for results of earlier versions.

    `efforts`: as `tables.one_step_table` has them.
    """
    if evaluation.own.one_step.percent is None:
        return None
    rows = [
        Row((each.label, *_cells(each, effort_of(efforts, name))), row_kind(name))
        for name, each in evaluation.candidates.items()
    ]
    words = ""
    if floor := evaluation.noise_floor:
        rows.append(Row((NOISE_FLOOR, *[MISSING] * 3, significant(floor.percent, 2), MISSING), "reference"))
        words = f" {noise_words(floor)}"
    caption = (
        f"All candidates, on the same {evaluation.test.transitions:,} held-out transitions and the same free-running "
        "rollouts. Single networks were trained on the same samples, for as many updates and with the optimiser of the "
        "ensemble, and with its activation unless they say otherwise. Error: root mean square over the dimensions of "
        f"the state, in % of the range. Horizon: the time until it reaches {LOST_PERCENT:g} % in the median rollout; "
        "what cannot be rolled out has none. Parameters and multiply-adds include the addressing network where one is "
        f"used. {HINDSIGHT}{words}"
    )
    return Table(caption, COLUMNS, tuple(rows))


def _cells(candidate: CandidateResult, effort: Effort | None) -> tuple[str, ...]:
    costs = (candidate.parameters, candidate.multiply_adds, effort.updates if effort else None)
    return (
        *(MISSING if each is None else count(each) for each in costs),
        significant(candidate.one_step.percent, 2),
        _horizon(candidate),
    )


def _horizon(candidate: CandidateResult) -> str:
    horizon = candidate.rollouts.horizon if candidate.rollouts else None
    if horizon is None:
        return MISSING
    return significant(horizon.seconds) if horizon.lost else f"> {significant(horizon.seconds)}"
