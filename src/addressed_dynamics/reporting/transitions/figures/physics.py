"""How rollouts of Acrobot run beside the truth: their angles and energy against the horizon."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from matplotlib.axes import Axes

from addressed_dynamics.evaluation.transitions.physics import ROUNDING, TRUTH, TWIN
from addressed_dynamics.evaluation.transitions.records import RolloutPhysics
from addressed_dynamics.reporting.common.blocks import Figure, Panel
from addressed_dynamics.reporting.common.figures.style import FAINT, INK, logarithmic, model_style, panel, positive
from addressed_dynamics.reporting.common.numbers import scientific
from addressed_dynamics.reporting.common.reading import Columns
from addressed_dynamics.reporting.transitions.figures.episodes import first_of_each
from addressed_dynamics.reporting.transitions.rollout_tables import group_title

_QUANTITIES = {
    "angle_1_error": ("error of the first angle, rad", (ROUNDING, TWIN)),
    "angle_2_error": ("error of the second angle, rad", (ROUNDING, TWIN)),
    "energy_error": ("difference from the true energy, J", (ROUNDING, TWIN)),
    "energy_drift": ("difference from the energy at the start, J", (TRUTH,)),
}
"""Label of each quantity, and what stands beside the models."""
_STYLES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    TRUTH: ("recording", {"color": "#bdbdbd", "linewidth": 4.0, "zorder": 1}),
    ROUNDING: ("true simulator, recorded start", {"color": FAINT, "linestyle": "--", "zorder": 6}),
    TWIN: ("two true simulations", {"color": "#d55e00", "linestyle": ":", "linewidth": 2.0, "zorder": 6}),
}
"""Title and style of what stands beside the models."""


def angles_and_energy(horizon: Mapping[str, Mapping[str, Columns]], physics: RolloutPhysics) -> Figure:
    """Draw the errors of both angles and of the energy against the horizon, for each group of rollouts."""
    groups = [group for group in horizon if group != "all"] or list(horizon)
    panels = tuple(
        _panel(f"{quantity.replace('_', '-')}-{index}", horizon[group], group, quantity, physics)
        for index, group in enumerate(groups)
        for quantity in _QUANTITIES
    )
    caption = (
        "Angles and energy in free-running rollouts: median over rollouts (line) and 10th to 90th percentile (band, "
        "for the ensemble). Dotted: how far two true simulations come apart that start "
        f"{scientific(physics.apart, 1)} rad apart, under the same actions. Dashed: how far one true simulation comes "
        "from the recording because the log keeps the start in single precision: no model can be expected to stay "
        "below it. "
        f"The thin line is the error of {physics.angle_limit:g} rad at which a model counts as lost. The last picture "
        "of each group shows the change of a rollout's own energy since its start, with that of the recording in grey: "
        "torque changes it rightly, so a model should follow the grey line there; without torque both should stay low."
    )
    return Figure(caption, panels)


def _panel(name: str, models: Mapping[str, Columns], group: str, quantity: str, physics: RolloutPhysics) -> Panel:
    label, beside = _QUANTITIES[quantity]
    where = "" if group == "all" else f", rollouts from {group_title(group)}"

    def draw(axes: Axes) -> None:
        shown = first_of_each(models)
        for model, columns in shown.items():
            title, colour = model_style(model, shown)
            own = model == "ensemble/argmax"
            line = partial(axes.plot, columns["horizon"] * physics.step_seconds)
            line(positive(columns[f"{quantity}_p50"]), color=colour, label=title, linewidth=1.8 if own else 1.1,
                 zorder=3 + own)  # fmt: skip
            if own:
                low, high = (positive(columns[f"{quantity}_{share}"]) for share in ("p10", "p90"))
                seconds = columns["horizon"] * physics.step_seconds
                axes.fill_between(seconds, low, high, color=colour, alpha=0.13, linewidth=0)
        for simulation in beside:
            columns = models[simulation]
            title, style = _STYLES[simulation]
            seconds = columns["horizon"] * physics.step_seconds
            axes.plot(seconds, positive(columns[f"{quantity}_p50"]), label=title, **style)
        if quantity.startswith("angle"):
            axes.axhline(physics.angle_limit, color=INK, linewidth=0.6)
        axes.set(xlabel="seconds since the true state", ylabel=label, xlim=(0, None))
        if group != "all":
            axes.set_title(group_title(group))
        logarithmic(axes, "y")
        axes.figure.legend(loc="outside lower center", ncols=2)

    alternative = f"{label[0].upper()}{label[1:]}, against the time since the true state{where}, for all models"
    return panel(name, alternative, draw, size=(4.6, 4.2))
