"""How rollouts of Acrobot run beside the truth: their angles and energy against the horizon."""

from __future__ import annotations

from collections.abc import Mapping

from addressed_dynamics.evaluation.transitions.physics import ROUNDING, TRUTH, TWIN
from addressed_dynamics.evaluation.transitions.records import RolloutPhysics
from addressed_dynamics.reporting.common.blocks import Chart, Line, View
from addressed_dynamics.reporting.common.charts import MOST_SHOWN, numbers, places_of
from addressed_dynamics.reporting.common.figures.style import ACTION, FAINT, model_style
from addressed_dynamics.reporting.common.figures.style import TRUTH as TRUTH_COLOUR
from addressed_dynamics.reporting.common.numbers import scientific
from addressed_dynamics.reporting.common.reading import Columns
from addressed_dynamics.reporting.transitions.figures.episodes import first_of_each
from addressed_dynamics.reporting.transitions.rollout_tables import group_title

OWN = "ensemble/argmax"
"""The model whose spread over rollouts is shown."""
_QUANTITIES = {
    "angle_1_error": ("first angle", "error of the first angle, rad", (TWIN, ROUNDING)),
    "angle_2_error": ("second angle", "error of the second angle, rad", (TWIN, ROUNDING)),
    "energy_error": ("energy", "difference from the true energy, J", (TWIN, ROUNDING)),
    "energy_drift": ("energy since the start", "difference from the energy at the start, J", (TRUTH,)),
}
"""Title and label of each quantity, and what stands beside the models."""
_STYLES = {
    TRUTH: Line("recording", TRUTH_COLOUR, (), style="thick"),
    ROUNDING: Line("true simulator, recorded start", FAINT, (), style="dashed"),
    TWIN: Line("two true simulations", ACTION, (), style="dashed"),
}
"""Title and style of what stands beside the models."""


def angles_and_energy(horizon: Mapping[str, Mapping[str, Columns]], physics: RolloutPhysics) -> Chart:
    """Return the errors of both angles and of the energy against the horizon, for each group of rollouts."""
    groups = [group for group in horizon if group != "all"] or list(horizon)
    views = tuple(
        _view(horizon[group], "all" if group == "all" else group_title(group), quantity, physics)
        for group in groups
        for quantity in _QUANTITIES
    )
    caption = (
        "Angles and energy in free-running rollouts, median over rollouts. Two true simulations: how far they come "
        f"apart that start {scientific(physics.apart, 1)} rad apart, under the same actions. True simulator: how far "
        "it comes from the recording because the log keeps the start in single precision: no model can be expected to "
        f"stay below it. The thin line is the error of {physics.angle_limit:g} rad at which a model counts as lost. "
        "Energy since the start: torque changes it rightly, so a model should follow the recording there; without "
        "torque both should stay low."
    )
    alternative = "Errors of the angles and of the energy against the time since the true state, for all models"
    return Chart("physics", caption, alternative, "seconds since the true state", views, ("Rollouts", "Error of"))


def _view(models: Mapping[str, Columns], group: str, quantity: str, physics: RolloutPhysics) -> View:
    title, label, beside = _QUANTITIES[quantity]
    shown = first_of_each(models)
    steps = models[next(iter(shown))]["horizon"]
    kept = places_of(steps)
    lines = []
    for name, columns in shown.items():
        named, colour = model_style(name, shown)
        middle = numbers(columns[f"{quantity}_p50"][kept].tolist())
        lines.append(Line(named, colour, middle, shown=name == OWN))
    for count, name in enumerate(each for each in beside if each in models):
        style = _STYLES[name]
        middle = numbers(models[name][f"{quantity}_p50"][kept].tolist())
        lines.insert(1 + count, Line(style.name, style.colour, middle, style=style.style, shown=count < MOST_SHOWN - 1))
    places = tuple((steps[kept] * physics.step_seconds).tolist())
    level = physics.angle_limit if quantity.startswith("angle") else None
    return View((group, title), label, places, tuple(lines), level=level)
