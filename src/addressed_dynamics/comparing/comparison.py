"""What changed between two versions of an experiment."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, final

import numpy as np

from addressed_dynamics.comparing.intervals import Beside, one_step_beside, rollouts_beside
from addressed_dynamics.comparing.versions import ComparisonError, Version
from addressed_dynamics.evaluation.common.bootstrap import COVERAGE, FEWEST_EPISODES, Ratio

PAIRED = "paired over the same test episodes"
UNPAIRED = "unpaired: the test episodes differ"
_ROLLOUTS_OF = "rollouts, "
"""How the measure begins of one dimension alone."""


@final
@dataclass(frozen=True)
class Change:
    """A value that differs; None where a version has none."""

    name: str
    first: Any
    second: Any


@final
@dataclass(frozen=True)
class ErrorChange:
    """The errors of two models, which may be the same one in both versions."""

    model: str
    """What people call it; both, where they differ."""
    measure: str
    """What is measured, with its unit."""
    first: float
    second: float
    ratio: Ratio | None
    """The second in multiples of the first, with its interval."""
    said: str
    """What follows: `lower`, `higher`, `the same`, `may be chance`, or `no interval`."""
    how: str
    """How the interval came about, or why there is none."""


@final
@dataclass(frozen=True)
class Comparison:
    """Two versions of an experiment."""

    first: Version
    second: Version
    params: tuple[Change, ...]
    """Params that differ."""
    data: tuple[Change, ...]
    """Data that differ, by path, and counts that do."""
    code: tuple[Change, ...]
    """Code that differs, by path."""
    figures: tuple[Change, ...]
    """All figures of the headline, the same ones included."""
    errors: tuple[ErrorChange, ...]
    """Of the recommended models."""
    candidates: tuple[ErrorChange, ...]
    """Of each model that both versions have."""
    notes: tuple[str, ...]
    """What is missing or doubtful."""

    @property
    def experiment(self) -> str:
        """Name of the experiment."""
        return self.first.experiment

    @property
    def verdict(self) -> str:
        """What changed, in a sentence or two."""
        parts = [_counted(len(self.params), "param"), "other data" if self.data else "the same data"]
        parts.append("other code" if self.code else "the same code")
        sentences = [f"{self.experiment}: {', '.join(parts)}."]
        overall = [each for each in self.errors if not each.measure.startswith(_ROLLOUTS_OF)]
        sentences += [_sentence(each, self.second.name, self.first.name) for each in overall]
        if not overall:
            sentences.append("No error of both is known, so neither is called better.")
        return " ".join(sentences)

    def to_json(self) -> dict[str, Any]:
        """Return all of it as JSON-compatible values."""
        sides = {key: {"name": each.name, "what": each.what} for key, each in (("a", self.first), ("b", self.second))}
        return {
            "experiment": self.experiment,
            **sides,
            "verdict": self.verdict,
            "params": [_change(each) for each in self.params],
            "data": [_change(each) for each in self.data],
            "code": [_change(each) for each in self.code],
            "figures": [_change(each) for each in self.figures],
            "errors": [_error(each) for each in self.errors],
            "candidates": [_error(each) for each in self.candidates],
            "notes": list(self.notes),
        }


def _why_no_interval(evaluation: Mapping[str, Any]) -> str:
    if "reference" in evaluation:
        return (
            "it is of motion, of which a few clips are held out whole, and one script in the closed loop: too few "
            "alike parts to draw from, so no interval can be given"
        )
    return "its evaluation keeps no errors by episode, so no interval can be given"


def compare(first: Version, second: Version) -> Comparison:
    """Compare two versions of an experiment.

    Raises:
        ComparisonError: they are of different experiments.
    """
    if first.experiment != second.experiment:
        message = (
            f"{first.name} is of the experiment '{first.experiment}', {second.name} of '{second.experiment}': "
            "two of the same experiment can be compared"
        )
        raise ComparisonError(message)
    notes = ["A and B are the same, so nothing can differ"] if first.what == second.what else []
    notes += [f"{each.name}: {note}" for each in (first, second) for note in each.notes]
    notes += [
        f"{each.name}: {_why_no_interval(each.evaluation)}"
        for each in (first, second)
        if each.evaluation and each.errors is None
    ]
    return Comparison(
        first,
        second,
        tuple(_changes(first.params, second.params)),
        (*_changes(first.data, second.data), *_changes(first.counts, second.counts)),
        tuple(_changes(first.code, second.code)),
        tuple(_changes(first.figures, second.figures, all_of_them=True)) + tuple(_of_evaluations(first, second)),
        tuple(_recommended(first, second)),
        tuple(_of_candidates(first, second)),
        tuple(dict.fromkeys(notes)),
    )


def _changes(first: Mapping[str, Any], second: Mapping[str, Any], *, all_of_them: bool = False) -> Iterator[Change]:
    if not first or not second:
        return  # what is not known of one did not change
    for name in dict.fromkeys([*first, *second]):
        one, other = first.get(name), second.get(name)
        if all_of_them or one != other:
            yield Change(name, one, other)


def _of_evaluations(first: Version, second: Version) -> Iterator[Change]:
    """Yield what the evaluations say of the recommended models and of trust, which no episode tells alone."""
    sides = [dict(_told(version)) for version in (first, second)]
    yield from _changes(*sides, all_of_them=True)


def _told(version: Version) -> Iterator[tuple[str, float]]:
    own = version.candidates.get(version.recommended or "", {})
    for after in own.get("errors_after") or ():
        yield f"recommended: RMSE after {after['steps']} steps, % of the range", after["percent"]
    horizon = (own.get("rollouts") or {}).get("horizon")
    if horizon:
        yield "recommended: horizon, s", horizon["seconds"]
    trust = version.evaluation.get("trust") or {}
    for each in trust.get("coverage") or ():
        if each["steps"] == 1:
            yield f"trust: share within {100 * each['asked']:g} % intervals of a step", each["of_all"]
    if "trusted_steps" in trust:
        yield "trust: steps until it ends", trust["trusted_steps"]
    for name, shift in (trust.get("shifts") or {}).items():
        for score in ("trust", "surprise"):
            if (area := shift["auroc"].get(score)) is not None:
                yield f"trust: area for '{name}' by {score}", area


def _recommended(first: Version, second: Version) -> Iterator[ErrorChange]:
    one, other = first.recommended, second.recommended
    if one is None or other is None or first.errors is None or second.errors is None:
        return
    label = " → ".join(dict.fromkeys([first.label(one), second.label(other)]))
    yield from _errors(first, one, second, other, label)
    dimensions = [each["name"] for each in first.candidates[one]["one_step"]["dimensions"]]
    units = {each["name"]: each["unit"] for each in first.candidates[one]["one_step"]["dimensions"]}
    size = next((each.shape[1] for each in first.errors.rollouts.values()), 0)
    for index, name in enumerate(dimensions[:size]):
        found = rollouts_beside(
            first.errors, one, second.errors, other, np.eye(size)[index], same_data=_same_data(first, second)
        )
        if found is not None:
            yield _rooted(found, label, f"{_ROLLOUTS_OF}{name} [{units[name] or '1'}]", 1.0)


def _of_candidates(first: Version, second: Version) -> Iterator[ErrorChange]:
    if first.errors is None or second.errors is None:
        return
    for name in first.errors.one_step:
        if name in second.errors.one_step:
            yield from _errors(first, name, second, name, first.label(name))


def _errors(first: Version, one: str, second: Version, other: str, label: str) -> Iterator[ErrorChange]:
    assert first.errors is not None
    assert second.errors is not None
    same = _same_data(first, second)
    losses = {version.evaluation.get("loss") for version in (first, second)}
    found = one_step_beside(first.errors, one, second.errors, other, same_data=same)
    if found is not None and losses == {"mse"}:
        yield _rooted(found, label, "one step [% of the range]", 100.0)
    elif found is not None and losses == {"mae"}:
        yield _said(found, label, "one step, absolute [% of the range]", 100.0)
    scale = first.errors.scale if first.errors.scale is not None else second.errors.scale
    if scale is None:
        return
    rolled = rollouts_beside(
        first.errors, one, second.errors, other, np.asarray(scale) ** -2.0 / len(scale), same_data=same
    )
    if rolled is not None:
        yield _rooted(rolled, label, "rollouts [% of the range]", 100.0)


def _same_data(first: Version, second: Version) -> bool:
    return bool(first.data) and not [*_changes(first.data, second.data)] and bool(second.data)


def _rooted(found: Beside, label: str, measure: str, factor: float) -> ErrorChange:
    """Return squared errors as their roots; the order of draws, and so the interval, stays."""
    ratio = found.ratio
    root = None if ratio is None else Ratio(*(math.sqrt(each) for each in (ratio.value, ratio.low, ratio.high)))
    return _said(Beside(math.sqrt(found.first), math.sqrt(found.second), root, found.paired), label, measure, factor)


def _said(found: Beside, label: str, measure: str, factor: float) -> ErrorChange:
    ratio = found.ratio
    if ratio is None:
        how = f"fewer than {FEWEST_EPISODES} test episodes, or an error of zero"
        return ErrorChange(label, measure, factor * found.first, factor * found.second, None, "no interval", how)
    return ErrorChange(
        label, measure, factor * found.first, factor * found.second, ratio, _word(ratio),
        PAIRED if found.paired else UNPAIRED,
    )  # fmt: skip


def _word(ratio: Ratio) -> str:
    if ratio.value == ratio.low == ratio.high == 1.0:
        return "the same"
    if ratio.low <= 1.0 <= ratio.high:
        return "may be chance"
    return "lower" if ratio.high < 1.0 else "higher"


def _sentence(change: ErrorChange, second: str, first: str) -> str:
    what = f"{change.measure.partition(' [')[0].capitalize()}: the recommended model of {second}"
    if change.ratio is None:
        values = f"{change.second:.3g} where {first} has {change.first:.3g}"
        return f"{what} has {values}; there is no interval ({change.how})."
    if change.said == "the same":
        return f"{what} has the same error as that of {first}."
    interval = f"{100 * COVERAGE:g} %: {change.ratio.low:.3g} to {change.ratio.high:.3g}"
    times = f"{what} has {change.ratio.value:.3g} times the error of {first} ({interval})"
    if change.said == "may be chance":
        return f"{times}: other test episodes could turn it round, so neither is called better."
    return f"{times}: {change.said}."


def _counted(number: int, what: str) -> str:
    if not number:
        return f"the same {what}s"
    return f"{number} {what}s differ" if number > 1 else f"1 {what} differs"


def _change(change: Change) -> dict[str, Any]:
    return {"name": change.name, "a": change.first, "b": change.second}


def _error(change: ErrorChange) -> dict[str, Any]:
    return {
        "model": change.model, "measure": change.measure, "a": change.first, "b": change.second,
        "ratio": None if change.ratio is None else asdict(change.ratio), "said": change.said, "how": change.how,
    }  # fmt: skip
