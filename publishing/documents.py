"""The documents with figures: templates in docs/templates, filled with the files in docs/figures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, UndefinedError

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.base.files import write_text
from addressed_dynamics.envs.mountain_car import HIGHEST_POSITION, LOWEST_POSITION
from addressed_dynamics.evaluation.common.bootstrap import COVERAGE
from addressed_dynamics.evaluation.transitions.horizons import LOST_PERCENT
from addressed_dynamics.reporting.common import numbers
from addressed_dynamics.reporting.transitions.paper import PAPER
from publishing import ROOT
from publishing.figures import Figures

FIGURES = Path("docs", "figures")
TEMPLATES = Path("docs", "templates")
DOCUMENTS = {
    "README.md.j2": Path("README.md"),
    "results.md.j2": Path("docs", "results.md"),
    "soak.md.j2": Path("docs", "soak.md"),
}
"""Templates, and the documents that are made of them."""
SCALES = {"quick": "quick scale", "paper": "paper's scale"}
"""Folders of figures that stand beside each other in a table, with what they are called there."""
NAMES = {"mountaincar": "MountainCar", "acrobot": "Acrobot", "pendulum": "Pendulum"}


def load_figures(folder: Path) -> Figures:
    """Return all figures: by their files' names, and below the name of the folder where they are in one."""
    scales = [path for path in sorted(folder.iterdir()) if path.is_dir()]
    return _inside(folder) | {scale.name: _inside(scale) for scale in scales}


def rendered(root: Path = ROOT) -> dict[Path, str]:
    """Return every document with figures, by its path below `root`.

    Raises:
        ReportError: a figure is missing.
    """
    environment = Environment(
        loader=FileSystemLoader(root / TEMPLATES),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    environment.filters |= FILTERS
    environment.globals |= GLOBALS
    figures = load_figures(root / FIGURES)
    figures["scales"] = [(title, figures[name]) for name, title in SCALES.items() if name in figures]
    return {path: _filled(environment, name, figures) for name, path in DOCUMENTS.items()}


def write(root: Path = ROOT) -> list[Path]:
    """Write every document with figures, and return those that have changed."""
    documents = {root / path: text for path, text in rendered(root).items()}
    changed = [path for path, text in documents.items() if not path.is_file() or path.read_text("utf-8") != text]
    for path in changed:
        write_text(path, documents[path])
    return changed


def beside(value: float | None, other: float) -> str:
    """Say how many times less or more a figure is than another: `2.2 × less`."""
    if not value:
        return numbers.MISSING
    ratio = other / value
    if 0.95 < ratio < 1.05:
        return "as much"
    factor, word = (ratio, "less") if ratio > 1.0 else (1.0 / ratio, "more")
    return f"{numbers.significant(factor, 2)} × {word}"


def lowest(candidates: Mapping[str, Any], measure: str) -> Any:
    """Return the candidate with the lowest value of a measure."""
    return min(candidates.values(), key=lambda each: each[measure])


def lower(values: Sequence[float], others: Sequence[float]) -> bool:
    """Say whether an error is lower than another from every seed."""
    return max(values) < min(others)


def seeds_of(candidates: Mapping[str, Any], name: str) -> list[Any]:
    """Return a candidate from all its seeds: `total_parameters`, or `ensemble/argmax`, whose first has no number."""
    return [each for key, each in candidates.items() if key == name or key.startswith(f"{name}/seed-")]


def span(values: Sequence[float], digits: int = 2) -> str:
    """Return the lowest and the highest of some figures, or the only one."""
    low, high = (numbers.scientific(each, digits) for each in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def held(horizon: Mapping[str, Any] | None) -> str:
    """Return for how many seconds a rollout holds; at least, if it never is lost."""
    if horizon is None:
        return numbers.MISSING
    return f"{'' if horizon['lost'] else '> '}{numbers.significant(horizon['seconds'], 2)}"


def ratio(found: Mapping[str, float] | None) -> str:
    """Return a ratio with its interval."""
    if found is None:
        return numbers.MISSING
    if found["low"] == found["high"] == 1.0:
        return "1"
    return f"{found['value']:.2f} ({found['low']:.2f} to {found['high']:.2f})"


def mean_of(errors: Mapping[str, float], names: Sequence[str]) -> float:
    """Return the mean error of some dimensions."""
    return sum(errors[name] for name in names) / len(names)


def worst_of(errors: Mapping[str, float], names: Sequence[str]) -> float:
    """Return the largest error of some dimensions."""
    return max(errors[name] for name in names)


def reached(is_so: bool) -> str:
    """Say whether a target is reached."""
    return "reached" if is_so else "missed"


def decimals(values: Sequence[float], places: int) -> str:
    """Return the lowest and the highest of some seeds with so many decimals, or the only one."""
    low, high = (f"{each:,.{places}f}" for each in (min(values), max(values)))
    return low if low == high else f"{low} – {high}"


def pair(values: Sequence[float]) -> str:
    """Return a median with the worst in brackets."""
    return f"{values[0]:.2f} ({values[1]:.2f})"


def fixed(value: float | None, places: int) -> str:
    """Return a number with so many decimals."""
    return numbers.MISSING if value is None else f"{value:.{places}f}"


def signed(value: float, places: int = 0) -> str:
    """Return a number with so many decimals and a sign as it is printed."""
    return f"{value:,.{places}f}".replace("-", "−")


def share(value: float | None, digits: int = 1) -> str:
    """Return a share in per cent."""
    return numbers.percent(value, digits).replace("\u202f", " ")


FILTERS = {
    "count": numbers.count,
    "decimals": decimals,
    "fixed": fixed,
    "pair": pair,
    "plain": numbers.significant,
    "sci": numbers.scientific,
    "share": share,
    "signed": signed,
    "span": span,
    "words": numbers.in_words,
}
GLOBALS = {
    "interval": COVERAGE,
    "lost_percent": f"{LOST_PERCENT:g}",
    "lower": lower,
    "lowest": lowest,
    "track_metres": HIGHEST_POSITION - LOWEST_POSITION,
    "beside": beside,
    "held": held,
    "mean_of": mean_of,
    "names": NAMES,
    "published": PAPER,
    "ratio": ratio,
    "reached": reached,
    "seeds_of": seeds_of,
    "worst_of": worst_of,
}


def _filled(environment: Environment, name: str, figures: Figures) -> str:
    try:
        return environment.get_template(name).render(figures)
    except UndefinedError as error:
        what = "an experiment or a model that it speaks of was not evaluated"
        message = f"{TEMPLATES / name}: a figure is missing, for {what} ({error}); fill it from a run that has it"
        raise ReportError(message) from error


def _inside(folder: Path) -> Figures:
    """Return the files in a folder by their names, as a template can write them: `real_data` for real-data.json."""
    return {path.stem.replace("-", "_"): json.loads(path.read_text("utf-8")) for path in sorted(folder.glob("*.json"))}
