"""Does addressing divide the gait cycle among the members, though it never sees the phase?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, Int64, Shaped

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.episodes.layout import GAITS

PHASE_BINS = 24
"""Equal intervals of the phase in which members are counted."""
SHUFFLES = 200
"""How often the phases are shuffled to see what chance gives."""


@dataclass(frozen=True)
class Concentration:
    """How a member's choices lie around the gait cycle."""

    member: int
    rows: int
    once: float
    """Mean resultant length of the phases in which it is chosen: 0 spread evenly, 1 all in one phase."""
    once_phase: float
    """Phase around which they lie, in [0, 1)."""
    twice: float
    """The same at two cycles per gait cycle: 1 for two phases half a cycle apart, as left and right step are."""
    twice_phase: float
    """The earlier of these phases, in [0, 0.5)."""


@dataclass(frozen=True)
class PhaseUse:
    """What the choice of a member tells of the phase, in one gait or over all gaits."""

    gait: str
    """One of `layout.GAITS`, or `all`, where information is the mean over the gaits, weighted by their rows."""
    rows: int
    counts: tuple[tuple[int, ...], ...]
    """(member, bin): how often each member is chosen in each interval of the phase."""
    choice_bits: float
    """Entropy of the choice; 0 if one member always serves."""
    information_bits: float
    """Mutual information of member and interval of the phase."""
    information_share: float
    """The same as a share of the choice's entropy: 1 if the phase decides the member; 0 if one always serves."""
    chance_share: float
    """Mean of this share if the phases are shuffled within the gait: what chance gives so few rows."""
    chance_share_p95: float
    """Its 95th percentile. Rows follow each other in time, so being above it proves less than with independent rows."""
    concentration: tuple[Concentration, ...]
    """Of each member that is chosen at all."""

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what a figure shows: edges of the intervals, and in each the share of every member."""
        counts = np.array(self.counts, np.float64)
        return {
            "phase_edges": np.linspace(0.0, 1.0, counts.shape[1] + 1),
            "member_share": counts / np.maximum(counts.sum(axis=0), 1.0),
        }


def phase_use(
    chosen: Int64[np.ndarray, " row"],
    phase: Float[np.ndarray, " row"],
    gait: Int64[np.ndarray, " row"],
    members: int,
    generator: np.random.Generator,
) -> tuple[PhaseUse, ...]:
    """Measure over all gaits, and in every gait that occurs, how choice and phase hang together.

    Args:
        chosen: the member that serves each row.
        phase: phase of the gait cycle, in [0, 1].
        gait: index in `layout.GAITS`.
        members: how many there are.
        generator: for the shuffles.

    Raises:
        EvaluationError: there are no rows, their numbers differ, or a value is out of range.
    """
    _check(chosen, phase, gait, members)
    bins = np.minimum((phase % 1.0 * PHASE_BINS).astype(np.int64), PHASE_BINS - 1)
    groups = [np.flatnonzero(gait == index) for index in range(len(GAITS))]
    occurring = [(GAITS[index], rows) for index, rows in enumerate(groups) if len(rows)]
    # Shuffled within each gait, and averaged over them: else the gait would count as phase where their phases differ.
    chance = {
        name: np.array(
            [_information(chosen[rows], bins[generator.permutation(rows)], members) for _ in range(SHUFFLES)]
        )
        for name, rows in occurring
    }

    def of(name: str, rows: Int64[np.ndarray, " some"]) -> PhaseUse:
        parts = occurring if name == "all" else [(name, rows)]
        shares = {part: len(each) / len(rows) for part, each in parts}
        choice = sum(shares[part] * _entropy(_counts(chosen[each], bins[each], members).sum(1)) for part, each in parts)
        bits = sum(shares[part] * _information(chosen[each], bins[each], members) for part, each in parts)
        by_chance = np.sum([shares[part] * chance[part] for part, _ in parts], axis=0)
        counts = _counts(chosen[rows], bins[rows], members)
        return PhaseUse(
            gait=name,
            rows=len(rows),
            counts=tuple(tuple(int(count) for count in row) for row in counts),
            choice_bits=float(choice),
            information_bits=float(bits),
            information_share=float(bits / choice) if choice else 0.0,
            chance_share=float(by_chance.mean() / choice) if choice else 0.0,
            chance_share_p95=float(np.quantile(by_chance, 0.95) / choice) if choice else 0.0,
            concentration=_concentrations(chosen[rows], phase[rows], members),
        )

    return (of("all", np.arange(len(chosen))), *(of(name, rows) for name, rows in occurring))


def _check(chosen: np.ndarray, phase: np.ndarray, gait: np.ndarray, members: int) -> None:
    if not len(chosen) or not len(chosen) == len(phase) == len(gait):
        message = (
            "phase use needs a chosen member, a phase and a gait of each of at least one row, "
            f"but got {len(chosen)}, {len(phase)} and {len(gait)}"
        )
        raise EvaluationError(message)
    ranges: dict[str, tuple[Shaped[np.ndarray, " row"], Callable[[float, float], bool], str]] = {
        "members": (chosen, lambda low, high: low >= 0 and high < members, f"0 to {members - 1}"),
        "phases": (phase, lambda low, high: low >= 0 and high <= 1, "0 to 1"),
        "gaits": (gait, lambda low, high: low >= 0 and high < len(GAITS), f"0 to {len(GAITS) - 1}"),
    }
    for name, (values, fits, expected) in ranges.items():
        if not fits(values.min(), values.max()):
            message = f"{name} should be from {expected}, but are from {values.min():g} to {values.max():g}"
            raise EvaluationError(message)


def _counts(
    chosen: Int64[np.ndarray, " row"], bins: Int64[np.ndarray, " row"], members: int
) -> Int64[np.ndarray, "member bin"]:
    return np.bincount(chosen * PHASE_BINS + bins, minlength=members * PHASE_BINS).reshape(members, PHASE_BINS)


def _entropy(counts: Int64[np.ndarray, " any"]) -> float:
    """Return the entropy of counted outcomes, in bits."""
    shares = counts[counts > 0] / counts.sum()
    return float(-(shares * np.log2(shares)).sum())


def _information(chosen: Int64[np.ndarray, " row"], bins: Int64[np.ndarray, " row"], members: int) -> float:
    """Return the mutual information of member and interval of the phase, in bits."""
    counts = _counts(chosen, bins, members)
    return max(0.0, _entropy(counts.sum(axis=1)) + _entropy(counts.sum(axis=0)) - _entropy(counts.ravel()))


def _concentrations(
    chosen: Int64[np.ndarray, " row"], phase: Float[np.ndarray, " row"], members: int
) -> tuple[Concentration, ...]:
    found = []
    for member in range(members):
        own: Float64[np.ndarray, " own"] = phase[chosen == member].astype(np.float64)
        if len(own):
            once, twice = (np.exp(2j * np.pi * frequency * own).mean() for frequency in (1, 2))
            found.append(
                Concentration(
                    member=member,
                    rows=len(own),
                    once=float(np.abs(once)),
                    once_phase=float(np.angle(once) / (2 * np.pi)) % 1.0,
                    twice=float(np.abs(twice)),
                    twice_phase=float(np.angle(twice) / (4 * np.pi)) % 0.5,
                )
            )
    return tuple(found)
