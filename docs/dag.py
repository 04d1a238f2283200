"""Draw the stages of an experiment: dvc dag --dot report@mountaincar | python docs/dag.py > docs/images/dag.svg."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from html import escape

WIDTH, HEIGHT = 170, 34
"""Of a stage, in pixels."""
GAP_X, GAP_Y = 24, 34

STYLE = """
text { font: 14px system-ui, sans-serif; fill: #1c1c1c; text-anchor: middle; dominant-baseline: central }
rect { fill: #eef3f7; stroke: #4a6b82 } path { fill: none; stroke: #4a6b82 } marker path { fill: #4a6b82 }
@media (prefers-color-scheme: dark) {
  text { fill: #ececec } rect { fill: #22303a; stroke: #9db8c9 } path { stroke: #9db8c9 } marker path { fill: #9db8c9 }
}
"""

Edge = tuple[str, str]


def read_dot(text: str) -> tuple[list[str], list[Edge]]:
    """Return the stages and which depends on which, of what `dvc dag --dot` prints."""
    edges = re.findall(r'^"([^"]+)" -> "([^"]+)";', text, flags=re.MULTILINE)
    return re.findall(r'^"([^"]+)";', text, flags=re.MULTILINE), edges


def reduced(edges: Iterable[Edge]) -> list[Edge]:
    """Return the edges that do not follow from others: an arrow from a to c is left out where a path goes by b."""
    kept = list(edges)
    below = {begin: {end for start, end in kept if start == begin} for begin, _ in kept}

    def reached(node: str) -> set[str]:
        return below.get(node, set()).union(*(reached(each) for each in below.get(node, ())))

    return [
        (begin, end) for begin, end in kept if all(end not in reached(other) for other in below[begin] if other != end)
    ]


def levels(stages: Iterable[str], edges: Iterable[Edge]) -> list[list[str]]:
    """Return the stages in rows, each below all that it depends on."""
    above = {stage: [begin for begin, end in edges if end == stage] for stage in stages}

    def depth(stage: str) -> int:
        return 1 + max((depth(each) for each in above[stage]), default=-1)

    depths = {stage: depth(stage) for stage in above}
    return [[stage for stage in above if depths[stage] == row] for row in range(max(depths.values()) + 1)]


def draw(stages: list[str], edges: list[Edge]) -> str:
    """Return the picture as SVG."""
    shown = reduced(edges)
    rows = levels(stages, shown)
    width = max(map(len, rows)) * (WIDTH + GAP_X) + GAP_X
    height = len(rows) * (HEIGHT + GAP_Y)
    place = {
        stage: ((width - len(row) * (WIDTH + GAP_X) + GAP_X) / 2 + column * (WIDTH + GAP_X) + WIDTH / 2,
                GAP_Y / 2 + level * (HEIGHT + GAP_Y))
        for level, row in enumerate(rows)
        for column, stage in enumerate(row)
    }  # fmt: skip
    parts = [_arrow(*place[begin], *place[end]) for begin, end in shown]
    for stage, (x, y) in place.items():
        parts.append(f'<rect x="{x - WIDTH / 2:g}" y="{y:g}" width="{WIDTH}" height="{HEIGHT}" rx="6"/>')
        parts.append(f'<text x="{x:g}" y="{y + HEIGHT / 2:g}">{escape(stage.partition("@")[0])}</text>')
    body = "\n".join(parts)
    marker = (
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0 0 8 4 0 8z"/></marker></defs>'
    )
    title = f"<title>Stages of {escape(stages[0].partition('@')[2])}</title>"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}" '
        f'height="{height:g}">{title}\n<style>{STYLE}</style>\n{marker}\n{body}\n</svg>\n'
    )


def _arrow(x: float, y: float, to_x: float, to_y: float) -> str:
    begin, middle = y + HEIGHT, (y + HEIGHT + to_y) / 2
    return f'<path d="M{x:g} {begin:g}C{x:g} {middle:g} {to_x:g} {middle:g} {to_x:g} {to_y:g}" marker-end="url(#tip)"/>'


if __name__ == "__main__":
    sys.stdout.write(draw(*read_dot(sys.stdin.read())))
