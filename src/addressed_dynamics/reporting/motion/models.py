"""How the models of motion are called and coloured, and which of them stand in figures."""

from __future__ import annotations

from collections.abc import Iterable

from addressed_dynamics.evaluation.motion.records import ENSEMBLE, MotionEvaluation
from addressed_dynamics.reporting.common.figures.style import FAINT
from addressed_dynamics.reporting.common.figures.style import OWN as OWN_COLOUR

OWN = "addressed ensemble"
"""Title of the delivered model."""
MODELS = {
    "phase_functioned": ("PFNN, trained here", "#5a5a5a"),
    "released": ("PFNN, as published", "#1b7f79"),
    "total_parameters": ("one large network", "#b3468c"),
    "learned_blend": ("parameters mixed by a gate", "#e6a000"),
    "same_size": ("one network, as large as a member", "#66a61e"),
    "paper_recipe": ("ensemble, the paper's recipe", "#7b3294"),
    "default_recipe": ("ensemble, the default recipe", "#7b3294"),
    "ridge": ("ridge regression", "#8a7a00"),
    "persistence": ("persistence and velocity", "#b07d62"),
    "mean": ("mean of the training frames", FAINT),
}
"""Title and colour of each model but ours, by its group."""
MAIN = ("phase_functioned", "released", "total_parameters", "learned_blend")
"""What stands beside ours in figures, if it was evaluated."""
UNTRAINED = ("mean", "persistence", "ridge")
"""References that need no training by epochs."""
CLOSEST = "total_parameters"
"""What tells whether several networks are of use: one of as many parameters as members and addressing together."""


def model_style(group: str) -> tuple[str, str]:
    """Return title and colour of a model by its group."""
    if group.startswith(f"{ENSEMBLE}/"):
        return OWN, OWN_COLOUR
    return MODELS.get(group, (group.replace("_", " "), FAINT))


def main_models(evaluation: MotionEvaluation, among: Iterable[str] | None = None) -> dict[str, str]:
    """Return the names of the models that figures show, by their groups; ours is the first.

    Args:
        evaluation: what was measured.
        among: names that there are data of; None for all candidates.
    """
    known = set(evaluation.candidates if among is None else among)
    shown = {evaluation.own_group: evaluation.own_name}
    for group in MAIN:
        candidates = evaluation.models.get(group, [])
        seeds = {each.seed for each in candidates}
        # Beside ours stands the model of the same seed, if there is one.
        seed = evaluation.delivered.seed if evaluation.delivered.seed in seeds else next(iter(seeds), None)
        name = group if seed is None else f"{group}/seed-{seed}"
        if candidates and name in known:
            shown[group] = name
    return {group: name for group, name in shown.items() if name in known}
