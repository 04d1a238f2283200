"""What the paper reports, as targets, and whether the addressed ensemble reaches them."""

from __future__ import annotations

from statistics import mean

from addressed_dynamics.evaluation.transitions.records import AddressingResult, Evaluation, MemberResult
from addressed_dynamics.reporting.common.numbers import (
    as_printed,
    listed,
    percent,
    power_of_ten,
    scientific,
    significant,
)
from addressed_dynamics.reporting.common.targets import Target
from addressed_dynamics.reporting.transitions.paper import AngleFigures, PaperFigures, TableTargets


def judge_targets(evaluation: Evaluation, paper: PaperFigures, *, transitions: int) -> tuple[Target, ...]:
    """Hold the addressed ensemble against what the paper reports.

    Args:
        evaluation: what was measured.
        paper: what the paper reports on the experiment.
        transitions: how many were recorded, which decides what can be asked for.
    """
    targets: list[Target] = []
    if paper.table is not None:
        targets += _table_targets(evaluation.table, paper, paper.table)
    if paper.angles is not None:
        targets += _angle_targets(evaluation, paper, paper.angles, transitions)
    return (*targets, *_rollout_targets(evaluation, paper))


def targets_caption(paper: PaperFigures | None, transitions: int) -> str:
    """Return what the table of targets shows, with so many recorded transitions."""
    if paper is None or paper.angles is None:
        return (
            "What the paper reports, as targets for the addressed ensemble on held-out episodes. The paper gives one "
            "rollout figure for each dimension; that of the velocity is held against rollouts without wall contact, "
            "because a contact one step late costs more than a whole rollout without one."
        )
    return (
        "Targets for the addressed ensemble on held-out episodes, beside what the paper reports. The paper does not "
        "say whether its errors are squared or absolute; both are given (MSE, MAE). "
        f"{_scale(paper.angles, transitions)}"
    )


def _scale(angles: AngleFigures, transitions: int) -> str:
    if transitions >= angles.transitions:
        return f"With {transitions:,} recorded transitions, these are the targets of the paper's scale."
    return (
        f"With {transitions:,} recorded transitions, where the paper has {angles.transitions:,}, the targets are those "
        "of the quick scale."
    )


def _table_targets(table: AddressingResult, paper: PaperFigures, wanted: TableTargets) -> list[Target]:
    selected = [member.selected for member in table.members if member.selected is not None]
    ratios = [ratio for member in table.members if (ratio := separation(member)) is not None]
    complete = len(selected) == len(table.members)
    worst, smallest = max(selected, default=None), min(ratios, default=None)
    return [
        Target(
            "Selected MSE of the worst subnetwork, one step ahead",
            f"at most {scientific(wanted.selected_at_most)}, the paper's worst",
            scientific(worst) if complete else f"{scientific(worst)}; a subnetwork is never selected",
            worst is not None and worst <= wanted.selected_at_most and complete,
        ),
        Target(
            "Not-selected over selected MSE, smallest of the subnetworks",
            f"at least {as_printed(wanted.separation_at_least)} (the paper: {_paper_separation(paper)})",
            "not to be measured" if smallest is None or not complete else significant(smallest),
            smallest >= wanted.separation_at_least if smallest is not None and complete else None,
        ),
        Target(
            "Misclassified points per thousand, all subnetworks",
            f"at most {as_printed(wanted.misclassified_at_most)}, the paper's worst",
            significant(table.misclassified_per_thousand),
            table.misclassified_per_thousand <= wanted.misclassified_at_most,
        ),
    ]


def _angle_targets(evaluation: Evaluation, paper: PaperFigures, angles: AngleFigures, transitions: int) -> list[Target]:
    table, wanted = evaluation.table, angles.targets(transitions)
    one_step = evaluation.own.one_step
    directions, velocities = one_step.named(angles.direction_names), one_step.named(angles.velocity_names)
    square, absolute = (mean([getattr(each, kind).mean for each in directions]) for kind in ("squared", "absolute"))
    fastest = max(velocities, key=lambda each: each.absolute.mean)
    least = min(member.share for member in table.members)
    reported = "" if paper.agreement is None else f" (the paper: {percent(paper.agreement)}, on training points)"
    return [
        Target(
            "Selected subnetwork has the lowest loss",
            f"over {percent(wanted.agreement_above, 0)}{reported}",
            percent(table.agreement),
            table.agreement > wanted.agreement_above,
        ),
        Target(
            "MSE of cosines and sines, one step ahead",
            f"at most {scientific(wanted.direction_mse_at_most, 1)} "
            f"(the paper: about {power_of_ten(angles.direction_error)})",
            f"{scientific(square)} (MAE {scientific(absolute)})",
            square <= wanted.direction_mse_at_most,
        ),
        Target(
            "MAE of the worse velocity in rad/s, one step ahead",
            f"at most {scientific(angles.velocity_mae_at_most, 1)} "
            f"(the paper: about {power_of_ten(angles.velocity_error)})",
            f"{scientific(fastest.absolute.mean)} (MSE {scientific(fastest.squared.mean)})",
            fastest.absolute.mean <= angles.velocity_mae_at_most,
        ),
        Target(
            "Points that the least used subnetwork serves",
            f"at least {percent(angles.share_at_least, 0)}",
            percent(least),
            least >= angles.share_at_least,
        ),
    ]


def _rollout_targets(evaluation: Evaluation, paper: PaperFigures) -> list[Target]:
    if evaluation.own.rollouts is None:
        return []
    targets = []
    for name, figure in paper.rollouts.items():
        group = evaluation.own.rollouts.groups.get(figure.group)
        spread = group.mse.get(name) if group else None
        number = group.number if group else 0
        which = f"all {number:,} rollouts" if figure.group == "all" else f"the {number:,} rollouts without wall contact"
        targets.append(
            Target(
                f"Rollout MSE of the {name}, median of {which}",
                f"at most {scientific(figure.mse, 4)}, the paper's",
                "not to be measured" if spread is None else scientific(spread.median, 4),
                spread.median <= figure.mse if spread and group and group.tells else None,
            )
        )
    return targets


def separation(member: MemberResult) -> float | None:
    """Return how many times its loss on its own samples a member's loss on the other samples is."""
    return member.not_selected / member.selected if member.selected and member.not_selected is not None else None


def _paper_separation(paper: PaperFigures) -> str:
    ratios = [network.not_selected / network.selected for network in paper.networks]
    return listed([significant(ratio, 4) for ratio in ratios])
