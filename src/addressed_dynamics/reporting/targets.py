"""What the paper reports, as targets, and whether the delivered model reaches them."""

from __future__ import annotations

from dataclasses import dataclass

from addressed_dynamics.reporting.numbers import as_printed, listed, scientific, significant
from addressed_dynamics.reporting.paper import PaperFigures
from addressed_dynamics.reporting.records import Evaluation, MemberResult


@dataclass(frozen=True)
class Target:
    """Something to be reached, and what was."""

    name: str
    """What is measured."""
    wanted: str
    """Bound with its origin."""
    found: str
    """What was measured."""
    met: bool | None
    """Whether it was reached; None if it could not be measured."""


def judge_targets(evaluation: Evaluation, paper: PaperFigures) -> tuple[Target, ...]:
    """Hold the delivered model against what the paper reports."""
    table = evaluation.table
    selected = [member.selected for member in table.members if member.selected is not None]
    ratios = [ratio for member in table.members if (ratio := separation(member)) is not None]
    complete = len(selected) == len(table.members)
    worst, smallest = max(selected, default=None), min(ratios, default=None)
    targets = [
        Target(
            "Selected MSE of the worst subnetwork, one step ahead",
            f"at most {scientific(paper.selected_at_most)}, the paper's worst",
            scientific(worst) if complete else f"{scientific(worst)}; a subnetwork is never selected",
            worst is not None and worst <= paper.selected_at_most and complete,
        ),
        Target(
            "Not-selected over selected MSE, smallest of the subnetworks",
            f"at least {as_printed(paper.separation_at_least)} (the paper: {_paper_separation(paper)})",
            "not to be measured" if smallest is None or not complete else significant(smallest),
            smallest >= paper.separation_at_least if smallest is not None and complete else None,
        ),
        Target(
            "Misclassified points per thousand, all subnetworks",
            f"at most {as_printed(paper.misclassified_at_most)}, the paper's worst",
            significant(table.misclassified_per_thousand),
            table.misclassified_per_thousand <= paper.misclassified_at_most,
        ),
    ]
    if evaluation.own.rollouts is not None:
        for name, figure in paper.rollouts.items():
            group = getattr(evaluation.own.rollouts, figure.group)
            spread = group.mse.get(name) if group else None
            number = group.episodes if group else 0
            which = (
                f"all {number:,} rollouts" if figure.group == "all" else f"the {number:,} rollouts without wall contact"
            )
            targets.append(
                Target(
                    f"Rollout MSE of the {name}, median of {which}",
                    f"at most {scientific(figure.mse, 4)}, the paper's",
                    "not to be measured" if spread is None else scientific(spread.median, 4),
                    None if spread is None else spread.median <= figure.mse,
                )
            )
    return tuple(targets)


def separation(member: MemberResult) -> float | None:
    """Return how many times its loss on its own samples a member's loss on the other samples is."""
    return member.not_selected / member.selected if member.selected and member.not_selected is not None else None


def _paper_separation(paper: PaperFigures) -> str:
    ratios = [network.not_selected / network.selected for network in paper.networks]
    return listed([significant(ratio, 4) for ratio in ratios])
