"""Which member serves which samples: loss profiles, and maps of the state space."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm

from addressed_dynamics.episodes.bounds import display_range
from addressed_dynamics.episodes.transitions import Dimension, DiscreteAction, SpaceSpec
from addressed_dynamics.features.transitions.spec import Angle
from addressed_dynamics.reporting.common.blocks import Figure, Panel
from addressed_dynamics.reporting.common.figures.style import (
    HALF,
    THIRD,
    member_colour,
    member_legend,
    panel,
    positive,
    thinned,
    with_unit,
)
from addressed_dynamics.reporting.transitions.results import Arrays

MOST_POINTS = 6000
"""Points in a scatter plot."""
CELLS = 40
"""Cells along a side of a map."""


def loss_profiles(arrays: Arrays, *, cited: str = "") -> Figure | None:
    """Draw the loss profile of every sample before and after training (Fig. 2 of the paper); None for one member.

    With more than two members, those of a small ensemble of two if one was trained, else the two that are selected
    most often.

    Args:
        arrays: what was measured.
        cited: where in the paper there is such a figure, in brackets; empty for experiments that are not its.
    """
    members = len(arrays.profile)
    if members < 2:
        return None
    pair = _Pair.of_small_ensemble(arrays) if members > 2 else None
    pair = pair or _Pair.of_addressed(arrays)
    first, second = pair.members
    rows = thinned(len(pair.colour), MOST_POINTS)
    profiles = {"before": pair.untrained, "after": pair.trained}
    everything = positive(np.concatenate([profile.ravel() for profile in profiles.values()]))
    low, high = np.quantile(everything, 0.002), everything.max() * 2

    def draw(axes: Axes, profile: Float[np.ndarray, "2 sample"], title: str) -> None:
        # Members are drawn point by point in the samples' order, so that none covers the other as a whole. The
        # lowest losses are drawn at the edge.
        colours = [member_colour(k) for k in pair.colour[rows]]
        x, y = profile[:, rows].clip(min=low)
        axes.plot([low, high], [low, high], color="#bbbbbb", linewidth=0.8, zorder=1)
        axes.scatter(x, y, c=colours, s=3, alpha=0.45, linewidths=0, zorder=2)
        axes.set(xscale="log", yscale="log", xlim=(low, high), ylim=(low, high), title=title)
        axes.set(xlabel=f"loss under network {first + 1}", ylabel=f"loss under network {second + 1}")
        axes.set_aspect("equal")
        member_legend(axes, sorted(set(pair.colour.tolist())), loc="upper left", title=pair.legend)

    panels = tuple(
        panel(
            f"loss-profiles-{when}",
            f"Losses of test samples under two networks {when} training, coloured by network ({pair.legend})",
            partial(draw, profile=profile, title=f"{when} training"),
            size=(4.6, 4.4),
        )
        for when, profile in profiles.items()
    )
    caption = (
        f"Loss profiles{cited}{pair.origin}. Each point is one of {len(rows):,} test transitions; its "
        f"coordinates are its losses (of states scaled to [0, 1]) under networks {first + 1} and {second + 1}, its "
        f"colour is {pair.meaning}. On the grey line both serve it equally well; the further from it, the more the "
        "choice matters."
    )
    return Figure(caption, panels)


@dataclass(frozen=True)
class _Pair:
    """The two members whose losses are coordinates."""

    members: tuple[int, int]
    trained: Float[np.ndarray, "2 sample"]
    untrained: Float[np.ndarray, "2 sample"]
    colour: Int[np.ndarray, " sample"]
    """Member whose colour each sample has."""
    legend: str
    meaning: str
    """What the colour says, for the caption."""
    origin: str
    """What the caption says of the ensemble."""

    @staticmethod
    def of_addressed(arrays: Arrays) -> _Pair:
        """Return the members that the ensemble selects most often."""
        popularity = np.bincount(arrays.chosen, minlength=len(arrays.profile))
        first, second = sorted(np.argsort(-popularity, kind="stable")[:2].tolist())
        both = [first, second]
        meaning = "the network that the addressing network selects after training"
        return _Pair(
            (first, second),
            arrays.profile[both],
            arrays.profile_untrained[both],
            arrays.chosen,
            "selected",
            meaning,
            "",
        )

    @staticmethod
    def of_small_ensemble(arrays: Arrays) -> _Pair | None:
        """Return the ensemble of two that was trained for this figure; None if there is none."""
        trained, untrained = arrays.pair_profile, arrays.pair_profile_untrained
        if trained is None or untrained is None:
            return None
        origin = f" of an ensemble of two, which was trained for this figure beside that of {len(arrays.profile)}"
        meaning = "the network with the lower loss after training"
        return _Pair((0, 1), trained, untrained, trained.argmin(axis=0), "lower loss", meaning, origin)


def state_maps(arrays: Arrays, spaces: SpaceSpec, angles: Sequence[Angle] = ()) -> Figure | None:
    """Draw where in a plane each member is selected, and how large the error is.

    The plane is that of the first two angles, and without them that of the first two dimensions: cosine and sine of
    one angle would make a mere circle. One pair of maps for each discrete action. None if the state has one dimension.
    """
    if len(spaces.observation) < 2:
        return None
    places, dimensions = _places(arrays, spaces, angles)
    losses = positive(arrays.profile[arrays.chosen, np.arange(len(arrays.chosen))])
    parts = list(_by_action(arrays, spaces))
    plane = _Plane.of(places, dimensions)
    grids = [plane.cells(places[rows]) for _, rows in parts]
    means = [_cell_means(losses[rows], cells) for (_, rows), cells in zip(parts, grids, strict=True)]
    low, high = (reduce([np.nanquantile(mean, share) for mean in means]) for reduce, share in ((min, 0.01), (max, 1.0)))
    members = len(arrays.profile)
    size = THIRD if len(parts) > 2 else HALF
    chosen_panels, error_panels = list[Panel](), list[Panel]()
    for index, ((title, rows), cells, mean) in enumerate(zip(parts, grids, means, strict=True)):
        majority = _cell_majority(arrays.chosen[rows], cells, members)

        def draw_chosen(
            axes: Axes, image: Float[np.ndarray, "y x"] = majority, title: str = f"selected, {title}"
        ) -> None:
            colours = ListedColormap([member_colour(k) for k in range(members)])
            plane.draw(axes, image, cmap=colours, vmin=-0.5, vmax=members - 0.5)
            axes.set_title(title)

        def draw_error(axes: Axes, image: Float[np.ndarray, "y x"] = mean, title: str = f"error, {title}") -> None:
            norm = LogNorm(low, max(high, low * 1.01))
            mesh = plane.draw(axes, image, cmap="viridis", norm=norm)
            axes.figure.colorbar(mesh, ax=axes, orientation="horizontal", aspect=30, pad=0.02).outline.set_visible(
                False
            )
            axes.set_title(title)

        seen = f"over {dimensions[0].name} and {dimensions[1].name}, {title}"
        chosen_panels.append(
            panel(f"map-selected-{index}", f"Map of the selected network {seen}", draw_chosen, size=size)
        )
        tall = (size[0], size[1] + 0.35)
        error_panels.append(panel(f"map-error-{index}", f"Map of the error {seen}", draw_error, size=tall))
    names = ", ".join(f"{_COLOUR_NAMES[k % len(_COLOUR_NAMES)]} network {k + 1}" for k in range(members))
    each = ", one map for each action" if isinstance(spaces.action, DiscreteAction) else ""
    caption = (
        f"Where each network serves, and where the errors are: all {len(losses):,} test transitions in a grid of "
        f"{CELLS} × {CELLS} cells{each}. Selected: the network selected most often in a cell "
        f"({names}). Error: mean loss (of states scaled to [0, 1]) of the selected network, logarithmic. Blank: no "
        "test data."
    )
    return Figure(caption, (*chosen_panels, *error_panels))


_COLOUR_NAMES = ("indigo", "sand", "teal", "rose", "light blue", "wine", "green", "purple")


def _places(
    arrays: Arrays, spaces: SpaceSpec, angles: Sequence[Angle]
) -> tuple[Float[np.ndarray, "sample 2"], tuple[Dimension, ...]]:
    """Return where each sample is in the plane of the maps, and what its axes are."""
    if len(angles) < 2:
        return arrays.observation[:, :2], spaces.observation[:2]
    column = dict(zip(spaces.observation_names, arrays.observation.T, strict=True))
    shown = angles[:2]
    places = np.stack([np.arctan2(column[each.sine], column[each.cosine]) for each in shown], axis=1)
    return places, tuple(Dimension(each.name, "rad", -np.pi, np.pi) for each in shown)


def _by_action(arrays: Arrays, spaces: SpaceSpec) -> Iterator[tuple[str, Bool[np.ndarray, " sample"]]]:
    if not isinstance(spaces.action, DiscreteAction):
        yield "all actions", np.ones(len(arrays.chosen), dtype=np.bool_)
        return
    for action, name in enumerate(spaces.action.names):
        rows = arrays.action == action
        if rows.any():
            yield name.replace("_", " "), rows


@dataclass(frozen=True)
class _Plane:
    """The plane of the first two dimensions of the state, in cells."""

    dimensions: tuple[Dimension, ...]
    low: Float[np.ndarray, " 2"]
    high: Float[np.ndarray, " 2"]

    @staticmethod
    def of(states: Float[np.ndarray, "sample 2"], dimensions: tuple[Dimension, ...]) -> _Plane:
        """Span the plane between the bounds, and between the data where a bound says nothing about them."""
        low, high = display_range(dimensions, states.min(axis=0), states.max(axis=0))
        return _Plane(dimensions, low, np.where(high > low, high, low + 1.0))

    def cells(self, states: Float[np.ndarray, "row 2"]) -> tuple[Int[np.ndarray, " row"], Int[np.ndarray, " row"]]:
        """Return the cell of each state along both axes."""
        cells = ((states - self.low) / (self.high - self.low) * CELLS).clip(0, CELLS - 1).astype(np.int64)
        return cells[:, 0], cells[:, 1]

    def draw(self, axes: Axes, image: Float[np.ndarray, "y x"], **options: Any) -> Any:
        """Draw one colour a cell."""
        x, y = (np.linspace(self.low[axis], self.high[axis], CELLS + 1) for axis in (0, 1))
        axes.grid(visible=False)
        first, second = self.dimensions
        axes.set(xlabel=with_unit(first.name, first.unit), ylabel=with_unit(second.name, second.unit))
        return axes.pcolormesh(x, y, np.ma.masked_invalid(image), rasterized=True, **options)


def _cell_means(
    values: Float[np.ndarray, " row"], cells: tuple[Int[np.ndarray, " row"], Int[np.ndarray, " row"]]
) -> Float[np.ndarray, "y x"]:
    total, number = np.zeros((CELLS, CELLS)), np.zeros((CELLS, CELLS))
    np.add.at(total, cells[::-1], values)
    np.add.at(number, cells[::-1], 1.0)
    return np.divide(total, number, out=np.full_like(total, np.nan), where=number > 0)


def _cell_majority(
    chosen: Int[np.ndarray, " row"], cells: tuple[Int[np.ndarray, " row"], Int[np.ndarray, " row"]], members: int
) -> Float[np.ndarray, "y x"]:
    votes = np.zeros((members, CELLS, CELLS))
    np.add.at(votes, (chosen, cells[1], cells[0]), 1.0)
    return np.where(votes.sum(axis=0) > 0, votes.argmax(axis=0), np.nan)
