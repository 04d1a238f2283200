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
        (2.0, 0, 0, "stand"), (3.0, 75, 0, "walk"), (2.5, 85, 0.7, "walk"), (2.5, 65, -0.8, "walk"),
        (2.0, 0, 0, "stand"),
    ),
    "circles": _script((1.5, 100, 0, "walk"), (5.0, 110, 0.9, "walk"), (5.0, 100, -1.0, "walk")),
    "turns": _script(
        (1.5, 0, 0, "stand"), (2.0, 0, 1.1, "stand"), (1.8, 0, 0, "stand"), (2.4, 95, -0.6, "walk"),
        (1.6, 0, 0, "stand"), (2.0, 0, -1.2, "stand"), (2.5, 90, 0.5, "walk"),
    ),
    "brisk": _script(
        (1.4, 0, 0, "stand"), (3.0, 140, 0, "walk"), (2.5, 155, 0.5, "walk"), (2.5, 130, -0.9, "walk"),
        (2.5, 150, 0, "walk"),
    ),
    "snakes": _script(
        (1.6, 115, 0.8, "walk"), (1.6, 120, -0.8, "walk"), (1.8, 110, 0.9, "walk"), (1.8, 190, -0.8, "jog"),
        (1.8, 200, 0.8, "jog"), (1.8, 190, -0.9, "jog"),
    ),
    "jog": _script(
        (1.6, 0, 0, "stand"), (3.0, 200, 0, "jog"), (2.5, 230, 0.7, "jog"), (2.5, 190, -0.8, "jog"),
        (2.2, 0, 0, "stand"),
    ),
    "run": _script(
        (1.6, 120, 0, "walk"), (2.0, 250, 0.2, "jog"), (3.0, 350, 0, "run"), (2.5, 310, 0.5, "run"),
        (2.5, 330, -0.45, "run"),
    ),
    "changes": _script(
        (2.2, 90, 0.3, "walk"), (2.4, 240, 0, "jog"), (2.2, 110, -0.6, "walk"), (2.2, 215, 0.5, "jog"),
        (2.0, 0, 0, "stand"), (2.0, 120, 0, "walk"),
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
