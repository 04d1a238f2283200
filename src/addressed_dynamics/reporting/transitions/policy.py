"""The report's section on a policy that was learned in the model: what it is worth there and in truth."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.policies.records import LOW_TRUST, Estimate, PolicyFigures, Score
from addressed_dynamics.reporting.common.blocks import Block, Chart, Column, Figure, Fold, Line, Row, Table, Text, View
from addressed_dynamics.reporting.common.charts import numbers
from addressed_dynamics.reporting.common.figures.style import OWN, REACHED, panel, with_unit
from addressed_dynamics.reporting.common.numbers import MISSING, percent, significant
from addressed_dynamics.reporting.common.targets import Target, target_table
from addressed_dynamics.reporting.transitions.figures.trust import map_dimensions
from addressed_dynamics.reporting.transitions.policy_results import PolicyResult

TITLE = "A policy trained in the model"
CELLS = 40
"""Of the map, in each direction."""


def policy_blocks(result: PolicyResult | None, features: FeatureSpec) -> tuple[Block, ...]:
    """Return what is known of the policy; nothing if there is none."""
    if result is None:
        return ()
    figures = result.figures
    field = _map(result, features)
    target = _target(figures)
    return (
        Text(tuple(_sentences(figures))),
        _table(figures),
        *((target_table((target,), "What is asked of the policy in the true environment."),) if target else ()),
        *((field,) if field else ()),
        Fold("While it was learned", (_curve(result),)),
    )


def _sentences(figures: PolicyFigures) -> list[str]:
    learned = "the delivered model" if figures.candidate is None else f"the model “{figures.candidate}”"
    hold = "" if figures.hold == 1 else f" of {figures.hold} steps each"
    chosen = (
        f"A DQN made {figures.decisions:,} decisions{hold} in {figures.copies} copies of {learned}, from recorded "
        f"starts. Its policy is kept as it was after {figures.kept_decisions:,}, where its return inside the model was "
        "the highest; nothing true had a part in that choice."
    )
    if figures.truth is None or figures.beside is None or figures.gap is None:
        return [chosen, "There is no true environment at hand: the returns are the model's word, and not held against "
                "anything."]  # fmt: skip
    gap = figures.gap
    size = percent(abs(gap.value) / abs(figures.truth.returns.value)) if figures.truth.returns.value else MISSING
    chance = "no more than" if gap.low <= 0 <= gap.high else "more than"
    words = [
        chosen,
        f"In the true environment it earns {_estimate(figures.truth.returns)}, and in the model from the same first "
        f"states {_estimate(figures.beside.returns)}: the gap is {_estimate(gap)}, {size} of the return, {chance} "
        "chance explains.",
    ]
    if figures.trust is None:
        words.append("Where it leaves what the model knows is not known: the trust of this model was not calibrated.")
    else:
        low = figures.trust
        stays = low.low <= LOW_TRUST
        where = "it stays where the model knows its way" if stays else "it goes where the model knows less"
        words.append(
            f"Of the {low.decisions:,} decisions of these true episodes, {percent(low.low)} have a trust below "
            f"{LOW_TRUST:g}, where data like the recording would have {percent(LOW_TRUST, 0)}: {where}. "
            f"{percent(low.episodes_low, 0)} of the episodes have more than a tenth of such."
        )
    return words


def _table(figures: PolicyFigures) -> Table:
    columns = (
        Column("Learned", numeric=False),
        Column("played", numeric=False),
        Column("return"),
        Column("", numeric=False),
        Column("steps"),
        Column("ended in the task"),
        Column("", numeric=False),
    )
    where = "in the model" if figures.truth is None else "in truth"
    rows: list[tuple[str, str, Score | None, str]] = [
        ("in the model", "in the model, recorded starts", figures.model, ""),
        ("in the model", "in the model, true starts", figures.beside, ""),
        ("in the model", "in truth", figures.truth, "own"),
        ("in truth, as many steps", "in truth", figures.true_learner, "reference"),
        ("from recorded transitions alone", where, figures.offline, "reference"),
    ]
    caption = (
        f"Means of {figures.model.episodes} episodes of at most {figures.episode_steps:,} steps with their 95\u202f% "
        f"intervals, under the reward that {figures.reward} says. Learned in truth: the same learner, chosen by true "
        f"returns. From recorded transitions alone: its replay buffer holds the {figures.offline_decisions:,} "
        "decisions of the training transitions and no more, for as many gradient steps; the last policy is kept."
    )
    return Table(caption, columns, tuple(_row(*each) for each in rows if each[2] is not None))


def _row(learned: str, played: str, score: Score | None, kind: str) -> Row:
    assert score is not None
    ended = score.ended
    return Row(
        (
            learned,
            played,
            significant(score.returns.value),
            _interval(score.returns),
            significant(score.steps),
            percent(ended.value, 0),
            f"{percent(ended.low, 0)} to {percent(ended.high, 0)}",
        ),
        kind,
    )


def _target(figures: PolicyFigures) -> Target | None:
    if figures.least_ended is None or figures.truth is None:
        return None
    ended = figures.truth.ended.value
    name = f"True episodes that end inside the task, of {figures.truth.episodes}"
    wanted = f"at least {percent(figures.least_ended, 0)}"
    return Target(name, wanted, percent(ended, 0), ended >= figures.least_ended)


def _curve(result: PolicyResult) -> Chart:
    names = {"model": ("learned and scored in the model", OWN), "truth": ("learned and scored in truth", REACHED)}
    known = [(name, result.curves[name]) for name in names if name in result.curves]
    places = tuple(float(each) for each in known[0][1]["decisions"])
    lines = tuple(Line(*names[name], numbers(columns["return"])) for name, columns in known)
    caption = (
        "Mean return of the greedy policy at each check while it was learned: of the one that is kept inside "
        "the model, and of the same learner in the true environment, there."
    )
    alternative = "Mean return against the decisions made, of both learners"
    view = View((), "mean return", places, lines, logarithmic=False)
    return Chart("policy-learning", caption, alternative, "decisions", (view,))


def _map(result: PolicyResult, features: FeatureSpec) -> Figure | None:
    """Draw the mean trust along the true episodes over two dimensions of the state; None without trust."""
    state, trust = result.state, result.trust
    if state is None or trust is None:
        return None
    known = ~np.isnan(trust)
    points = features.plane(state[known])
    if points is None or not known.any():
        return None
    first, second = map_dimensions(features)

    def draw(axes: Axes) -> None:
        axes.grid(visible=False)
        across, up = points.T
        mesh = axes.hexbin(
            across, up, trust[known], gridsize=CELLS, reduce_C_function=np.mean, cmap="viridis", vmin=0, vmax=1
        )
        low = trust[known] < LOW_TRUST
        axes.plot(*points[low].T, ".", color="#d55e00", markersize=2)
        axes.figure.colorbar(mesh, ax=axes, label="trust").outline.set_visible(False)
        axes.set(xlabel=with_unit(first.name, first.unit), ylabel=with_unit(second.name, second.unit))

    caption = (
        "Where the policy goes in truth, and what the model knows there: mean trust at the decisions of the true "
        f"episodes. Orange: those with a trust below {LOW_TRUST:g}."
    )
    alternative = f"Map of the mean trust along the true episodes over {first.name} and {second.name}"
    return Figure(caption, (panel("policy-trust", alternative, draw),))


def _estimate(estimate: Estimate) -> str:
    return f"{significant(estimate.value)} ({_interval(estimate)})"


def _interval(estimate: Estimate) -> str:
    return f"{significant(estimate.low)} to {significant(estimate.high)}" if estimate.low < estimate.high else MISSING
