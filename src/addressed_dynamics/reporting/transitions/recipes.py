"""The default recipe and the paper's beside each other: their settings, and what came of each."""

from __future__ import annotations

from statistics import mean

from addressed_dynamics.evaluation.common.records import Specialisation, Specialisations
from addressed_dynamics.evaluation.transitions.records import (
    CandidateResult,
    DimensionResult,
    Evaluation,
    OneStepResult,
    Recipe,
    RolloutResult,
)
from addressed_dynamics.reporting.common.blocks import Column, Row, Table
from addressed_dynamics.reporting.common.numbers import MISSING, percent, scientific
from addressed_dynamics.reporting.transitions.comparison import beats, compare, details
from addressed_dynamics.reporting.transitions.rollout_tables import median_mse, seconds
from addressed_dynamics.reporting.transitions.settings import SETTINGS
from addressed_dynamics.sources.transitions.params import AngleParams

TITLES = {"default_recipe": "the default recipe", "paper_recipe": "the paper's recipe"}
"""What a reader should see for the recipe that was not chosen, by the name of its baseline."""


def recipes_table(evaluation: Evaluation, own: Recipe) -> Table | None:
    """Return the two recipes side by side, the default first; None if only one was trained.

    Args:
        evaluation: what was measured.
        own: the recipe of the ensemble.
    """
    other = evaluation.other_recipe
    if other is None:
        return None
    theirs = evaluation.baseline(other.name)[0]
    ours = f"{_own_title(other.name)}, chosen"
    columns = {
        ours: _settings(own, other.recipe) | _figures(evaluation, evaluation.own, evaluation.specialisation, own),
        TITLES[other.name]: _settings(other.recipe, own) | _figures(evaluation, theirs, other.specialisation, own),
    }
    titles = list(columns) if other.name == "paper_recipe" else list(reversed(columns))
    rows = tuple(Row((name, *(columns[title][name] for title in titles))) for name in columns[ours])
    variant = evaluation.delivered.variant.replace("_", "-")
    caption = (
        f"Both recipes from one seed each, first where their settings differ, then what came of them on the same "
        f"{evaluation.test.transitions:,} held-out transitions and in the same rollouts. Agreement: share of the "
        f"points whose selected network has the lowest loss. The ensemble with the chosen recipe has {variant} "
        "addressing, the other plain addressing."
    )
    return Table(caption, (Column("", numeric=False), *(Column(title, numeric=False) for title in titles)), rows)


def recipes_finding(evaluation: Evaluation) -> str | None:
    """Say which of the two recipes is the better one, and in what; None if only one was trained."""
    other = evaluation.other_recipe
    if other is None:
        return None
    comparisons = compare(evaluation.own_seeds, evaluation.baseline(other.name))
    own, theirs = evaluation.specialisation, other.specialisation
    return (
        f"{_own_title(other.name).capitalize()} {beats(comparisons)} {TITLES[other.name]}: {details(comparisons)}. "
        f"The selected subnetwork has the lowest loss for {percent(own.train.agreement)} of the training points and "
        f"{percent(own.test.agreement)} of the held-out ones, against {percent(theirs.train.agreement)} and "
        f"{percent(theirs.test.agreement)}; the least used one serves {percent(_smallest_share(own.test))} of the "
        f"held-out points, against {percent(_smallest_share(theirs.test))}."
    )


def _own_title(other: str) -> str:
    return next(title for name, title in TITLES.items() if name != other)


def _settings(recipe: Recipe, beside: Recipe) -> dict[str, str]:
    return {name: say(recipe) or MISSING for name, say in SETTINGS.items() if say(recipe) != say(beside)}


def _figures(
    evaluation: Evaluation, candidate: CandidateResult, shares: Specialisations, delivered: Recipe
) -> dict[str, str]:
    figures = {
        "agreement on training points": percent(shares.train.agreement),
        "agreement on held-out points": percent(shares.test.agreement),
        "held-out points of the least used network": percent(_smallest_share(shares.test)),
        f"one step, {evaluation.loss.upper()} of scaled states": scientific(candidate.one_step.scaled.mean),
        **_one_step(candidate.one_step, delivered.features.angles),
    }
    if candidate.rollouts:
        figures |= _rollouts(evaluation, candidate.rollouts)
    return figures


def _one_step(one_step: OneStepResult, angles: tuple[AngleParams, ...]) -> dict[str, str]:
    """Return the errors of cosines and sines, of angles and of their velocities together, and of all other dimensions.

    Together: means over the dimensions.
    """
    velocities = [angle.velocity for angle in angles if angle.velocity is not None]
    groups = {
        "cosines and sines": [name for angle in angles for name in (angle.cosine, angle.sine)],
        "angles": [angle.name for angle in angles],
        "velocities of angles": velocities,
    }
    together = {name for names in groups.values() for name in names}
    groups |= {each.name: [each.name] for each in one_step.dimensions if each.name not in together}
    figures = dict[str, str]()
    for title, names in groups.items():
        if names:
            figures |= _errors(title, one_step.named(names))
    return figures


def _errors(title: str, found: list[DimensionResult]) -> dict[str, str]:
    unit = found[0].unit
    absolute, square = (f" in {unit}", f" in ({unit})²" if "/" in unit else f" in {unit}²") if unit else ("", "")
    return {
        f"one step, MAE of {title}{absolute}": scientific(mean(each.absolute.mean for each in found)),
        f"one step, MSE of {title}{square}": scientific(mean(each.squared.mean for each in found)),
    }


def _rollouts(evaluation: Evaluation, rollouts: RolloutResult) -> dict[str, str]:
    figures = {f"rollouts, median MSE of {name}": median_mse(rollouts.all, name) for name in rollouts.all.mse}
    physics = evaluation.rollouts.physics
    if physics and rollouts.all.physics:
        end = evaluation.rollouts.steps * physics.step_seconds
        lost = rollouts.all.physics.lost_seconds
        limit = f"an angle is off by {physics.angle_limit:g} rad"
        figures[f"rollouts, median time until {limit}, in s"] = seconds(lost.median, end)
    return figures


def _smallest_share(shares: Specialisation) -> float:
    return min(shares.addressed) / shares.samples
