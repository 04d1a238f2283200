"""A picture of the stages of one experiment, as dvc.yaml has them: what `dvc dag` shows, drawn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

RAW = {"${item.raw}": "data/raw/${key}"}
"""What a stage's dependency is that an experiment names."""
WIDTH, HEIGHT, GAP, BELOW = 130, 34, 40, 18
"""Of a box, and the space beside and below it."""


def stages_picture(file: Path) -> str:
    """Return an inline SVG of the stages of an experiment, each to the right of what it needs."""
    stages: Mapping[str, Any] = YAML(typ="safe", pure=True).load(file.read_text(encoding="utf-8"))["stages"]
    needs = {name: needed(name, stages) for name in stages}
    columns: dict[int, list[str]] = {}
    for name in stages:
        columns.setdefault(_rank(name, needs), []).append(name)
    places = dict(_places(columns))
    width = len(columns) * (WIDTH + GAP) - GAP
    height = max(map(len, columns.values())) * (HEIGHT + BELOW) - BELOW
    arrows = [_arrow(places[before], places[name]) for name, given in needs.items() for before in direct(given, needs)]
    boxes = [_box(name, stages[name]["do"]["desc"], place) for name, place in places.items()]
    return (
        f'<svg viewBox="-1 -1 {width + 2} {height + 2}" role="img" aria-label="Stages of an experiment" class="stages">'
        '<defs><marker id="head" viewBox="0 0 6 6" refX="6" refY="3" markerWidth="6" markerHeight="6" orient="auto">'
        '<path d="M0 0L6 3L0 6z" fill="currentColor"/></marker></defs>'
        f"{''.join(arrows)}{''.join(boxes)}</svg>"
    )


def needed(name: str, stages: Mapping[str, Any]) -> set[str]:
    """Return the stages whose outputs a stage depends on."""
    deps = [RAW.get(dep, dep) for dep in stages[name]["do"]["deps"]]
    made = {other: list(_outputs(stage["do"])) for other, stage in stages.items() if other != name}
    return {other for other, outs in made.items() if any(_same(dep, out) for dep in deps for out in outs)}


def direct(given: set[str], needs: Mapping[str, set[str]]) -> set[str]:
    """Return those stages that no other one of them needs: the others are reached through it."""
    return {each for each in given if not any(each in needs[other] for other in given)}


def _outputs(stage: Mapping[str, Any]) -> Iterator[str]:
    for out in stage.get("outs", []):
        yield out if isinstance(out, str) else next(iter(out))


def _same(dependency: str, out: str) -> bool:
    return Path(dependency).is_relative_to(out)


def _rank(name: str, needs: Mapping[str, set[str]]) -> int:
    return max((_rank(before, needs) + 1 for before in needs[name]), default=0)


def _places(columns: Mapping[int, list[str]]) -> Iterator[tuple[str, tuple[int, int]]]:
    """Yield the corner of every box; columns are centred."""
    most = max(map(len, columns.values()))
    for rank, names in columns.items():
        top = (most - len(names)) * (HEIGHT + BELOW) // 2
        for row, name in enumerate(names):
            yield name, (rank * (WIDTH + GAP), top + row * (HEIGHT + BELOW))


def _box(name: str, meaning: str, place: tuple[int, int]) -> str:
    x, y = place
    return (
        f"<g><title>{escape(meaning)}</title>"
        f'<rect x="{x}" y="{y}" width="{WIDTH}" height="{HEIGHT}" rx="5" fill="none" stroke="currentColor"/>'
        f'<text x="{x + WIDTH // 2}" y="{y + HEIGHT // 2 + 5}" text-anchor="middle" fill="currentColor">'
        f"{escape(name)}</text></g>"
    )


def _arrow(start: tuple[int, int], end: tuple[int, int]) -> str:
    (x, y), (right, down) = start, end
    x, y, down = x + WIDTH, y + HEIGHT // 2, down + HEIGHT // 2
    middle = (x + right) // 2
    path = f"M{x} {y}C{middle} {y} {middle} {down} {right} {down}"
    return f'<path d="{path}" fill="none" stroke="currentColor" marker-end="url(#head)"/>'
