"""What the walker is told to do in each clip, and how it carries itself."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

GAITS = ("stand", "walk", "jog", "run", "crouch", "jump", "crawl", "bump")
"""The columns of a `.gait` file."""


@dataclass(frozen=True)
class Command:
    """What to do for a while."""

    seconds: float
    """How long."""
    speed: float
    """How fast to go, in cm/s."""
    turn: float
    """How fast to turn to the left, in rad/s."""
    gait: str
    """One of `GAITS`."""


def _script(*commands: tuple[float, float, float, str]) -> tuple[Command, ...]:
    return tuple(Command(*command) for command in commands)


SCRIPTS = {
    "stroll": _script(
        (2.6, 0, 0, "stand"), (2.0, 75, 0, "walk"), (1.6, 80, 1.2, "walk"), (1.6, 90, -0.5, "walk"),
        (1.6, 65, -1.5, "walk"), (2.4, 0, 0, "stand"), (2.0, 60, 0.4, "walk"),
    ),
    "circles": _script((1.2, 100, 0, "walk"), (4.0, 105, 1.3, "walk"), (1.5, 120, 0, "walk"), (4.5, 100, -1.5, "walk")),
    "turns": _script(
        (1.8, 0, 0, "stand"), (1.6, 0, 1.4, "stand"), (1.6, 0, 0, "stand"), (2.2, 90, -1.3, "walk"),
        (1.8, 0, 0, "stand"), (1.5, 0, -1.6, "stand"), (2.5, 85, 1.0, "walk"), (1.6, 0, 0, "stand"),
    ),
    "brisk": _script(
        (2.4, 0, 0, "stand"), (2.2, 145, 0, "walk"), (1.6, 150, 0.8, "walk"), (1.5, 130, -1.4, "walk"),
        (2.0, 155, 0, "walk"), (1.6, 135, 1.5, "walk"),
    ),
    "snakes": _script(
        (1.3, 115, 1.3, "walk"), (1.4, 120, -1.4, "walk"), (1.5, 110, 1.5, "walk"), (1.6, 185, -1.2, "jog"),
        (1.5, 200, 1.4, "jog"), (1.6, 190, -1.5, "jog"), (1.5, 205, 1.2, "jog"),
    ),
    "jog": _script(
        (2.2, 0, 0, "stand"), (2.2, 200, 0, "jog"), (2.0, 230, 1.1, "jog"), (1.8, 180, -1.5, "jog"),
        (2.4, 0, 0, "stand"), (2.0, 190, 0.5, "jog"),
    ),
    "run": _script(
        (1.4, 120, 0, "walk"), (1.8, 250, 0.4, "jog"), (2.4, 350, 0, "run"), (2.0, 300, 0.9, "run"),
        (2.2, 330, -0.7, "run"), (1.6, 240, -1.2, "jog"),
    ),
    "changes": _script(
        (1.8, 90, 0.6, "walk"), (2.0, 240, 0, "jog"), (1.8, 110, -1.2, "walk"), (1.8, 215, 1.0, "jog"),
        (2.3, 0, 0, "stand"), (1.8, 120, -0.4, "walk"), (1.8, 260, -0.8, "jog"),
    ),
}  # fmt: skip
"""Commands of each clip, by its name; a longer clip begins again."""


def commands(script: tuple[Command, ...], seconds: float, generator: np.random.Generator) -> list[Command]:
    """Return commands for at least `seconds`: those of the script again and again, each time a little different."""
    varied: list[Command] = []
    while sum(command.seconds for command in varied) < seconds:
        for command in script:
            length, speed, turn = generator.uniform(0.85, 1.15, 3).tolist()
            varied.append(Command(command.seconds * length, command.speed * speed, command.turn * turn, command.gait))
    return varied


@dataclass(frozen=True)
class Style:
    """How a walker carries itself; 1 is how most do."""

    stride: float
    """Length of its strides."""
    arms: float
    """How far its arms swing."""
    elbows: float
    """How far its elbows bend."""
    bob: float
    """How far its hips rise and fall."""
    sway: float
    """How far its hips go from side to side."""
    twist: float
    """How far hips and shoulders turn against each other."""
    lean: float
    """How far it leans forward."""
    width: float
    """How far apart it sets its feet."""
    lift: float
    """How high it lifts them."""


def draw_style(generator: np.random.Generator) -> Style:
    """Draw a style."""
    spread = {"stride": 0.09, "arms": 0.25, "elbows": 0.2, "lean": 0.3}
    drawn = {field.name: 1 + spread.get(field.name, 0.15) * generator.uniform(-1, 1) for field in fields(Style)}
    return Style(**drawn)
