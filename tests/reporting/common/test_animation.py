"""Animations of rollouts: the states that are drawn, the clock, and the file."""

import dataclasses
import io
import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from builders import CAR
from films import frames
from PIL import Image, ImageChops
from report_examples import example_arrays

from addressed_dynamics.episodes.transitions import DiscreteAction, SpaceSpec
from addressed_dynamics.reporting.common.animation import brush
from addressed_dynamics.reporting.common.animation.film import GAP, HEAD, NAME_SIZE, NOTE_SIZE, SIDE, film
from addressed_dynamics.reporting.common.animation.scenes import Scene
from addressed_dynamics.reporting.common.blocks import Panel
from addressed_dynamics.reporting.transitions.animation.acrobot import ACROBOT
from addressed_dynamics.reporting.transitions.animation.mountain_car import MOUNTAIN_CAR
from addressed_dynamics.reporting.transitions.animation.rollouts import animations, scene_of
from addressed_dynamics.reporting.transitions.results import Arrays


def course(scene: Scene, steps: int) -> Any:
    """States that differ from one step to the next."""
    time = np.arange(steps + 1)
    if scene is MOUNTAIN_CAR:
        return np.stack([-0.3 + 0.02 * time, 0.02 + 0 * time], axis=1)
    angles = np.stack([0.1 * time, 1 - 0.2 * time], axis=1)
    return np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(len(time), 4)


def example(scene: Scene = ACROBOT, steps: int = 12, off: float = 0.0, **changes: Any) -> Panel:
    true = course(scene, steps)
    values = {"directions": np.arange(steps) % 3 - 1, "step_seconds": 0.02}
    return film("name", "a title", scene, true, true + off, **values | changes)


def durations(panel: Panel) -> list[int]:
    with Image.open(io.BytesIO(panel.content)) as file:
        found = []
        for index in range(file.n_frames):
            file.seek(index)
            found.append(file.info["duration"])
        return found


def sides(frame: Image.Image) -> tuple[Image.Image, Image.Image]:
    """Left and right picture of a frame, without what is written above them, in white and not."""
    cuts = [frame.crop((x, HEAD, x + SIDE, frame.height)) for x in (0, SIDE + GAP)]
    return tuple(cut.convert("L").point(lambda value: 255 * (value < 220)) for cut in cuts)


@pytest.mark.parametrize("scene", [MOUNTAIN_CAR, ACROBOT])
def test_a_film_is_a_gif_of_its_size_that_repeats_and_moves(scene: Scene) -> None:
    panel = example(scene)
    shown = frames(panel)
    assert len(shown) == 4, "every fourth of 13 states"
    assert all(ImageChops.difference(a, b).getbbox() for a, b in pairwise(shown))
    assert {frame.size for frame in shown} == {(panel.width, panel.height)}
    with Image.open(io.BytesIO(panel.content)) as file:
        assert file.format == "GIF"
        assert file.info["loop"] == 0


@pytest.mark.parametrize(("scene", "far"), [(MOUNTAIN_CAR, [-1.2, 0.07]), (ACROBOT, [-1.0, 0.0, -1.0, 0.0])])
def test_what_is_written_over_a_film_has_room_beside_its_name(scene: Scene, far: list[float]) -> None:
    name = brush._font(NAME_SIZE, True).getlength("model")
    near = np.array([0.6, -0.07] if scene is MOUNTAIN_CAR else [1.0, 0.0, 1.0, 0.0])
    assert name + brush._font(NOTE_SIZE, False).getlength(scene.error(near, np.array(far))) < SIDE - 8
    assert NOTE_SIZE * 360 / (2 * SIDE + GAP) > 7, "pixels on a telephone"


@pytest.mark.parametrize(("step_seconds", "steps", "count"), [(0.02, 12, 4), (1 / 30, 20, 11), (0.2, 3, 4)])
def test_a_film_passes_as_fast_as_what_happened(step_seconds: float, steps: int, count: int) -> None:
    found = durations(example(steps=steps, step_seconds=step_seconds))
    assert len(found) == count
    stride = steps // (count - 1)
    assert sum(found) == pytest.approx(1000 * count * stride * step_seconds, abs=5)


def test_a_long_rollout_is_cut() -> None:
    assert sum(durations(example(MOUNTAIN_CAR, steps=160, step_seconds=0.2))) == 10_200


@pytest.mark.parametrize("scene", [MOUNTAIN_CAR, ACROBOT])
def test_both_sides_show_the_same_where_the_model_is_right_and_something_else_where_it_is_not(scene: Scene) -> None:
    for off, same in ((0.0, True), (-0.3, False)):
        for frame in frames(example(scene, off=off)):
            assert (sides(frame)[0] == sides(frame)[1]) == same


def test_an_action_is_drawn_at_both_sides_and_none_is_not() -> None:
    still = np.repeat(course(ACROBOT, 0), 13, axis=0)
    without, left, right = (
        sides(frames(film("name", "", ACROBOT, still, still, np.full(12, direction), 0.02))[0])
        for direction in (0, -1, 1)
    )
    for side in (0, 1):
        assert len({each[side].tobytes() for each in (without, left, right)}) == 3


def test_the_same_rollout_makes_the_same_bytes() -> None:
    assert example() == example()


def test_the_still_is_the_last_picture_as_a_png() -> None:
    panel = example()
    assert panel.still is not None
    with Image.open(io.BytesIO(panel.still)) as still:
        assert still.format == "PNG"
        assert still.convert("RGB").tobytes() == frames(panel)[-1].tobytes()


@pytest.mark.parametrize("lost", [1e6, -1e6])
@pytest.mark.parametrize("scene", [MOUNTAIN_CAR, ACROBOT])
def test_a_model_that_lost_its_state_has_a_film_too(scene: Scene, lost: float) -> None:
    assert len(frames(example(scene, off=lost))) == 4


def test_the_errors_above_the_model_are_those_of_its_state() -> None:
    true = np.array([math.cos(3.1), math.sin(3.1), 1.0, 0.0])
    predicted = np.array([math.cos(-3.1), math.sin(-3.1), math.cos(0.25), math.sin(0.25)])
    assert ACROBOT.error(true, predicted) == "off by 0.083 rad and 0.250 rad"
    assert MOUNTAIN_CAR.error(np.array([0.5, 0.01]), np.array([0.25, 0.02])) == "off by 0.2500 m and 0.01000 m/step"


def test_a_scene_is_known_by_the_names_of_dimensions_and_actions() -> None:
    car = dataclasses.replace(CAR, action=DiscreteAction(MOUNTAIN_CAR.actions))
    assert scene_of(car) is MOUNTAIN_CAR
    assert scene_of(dataclasses.replace(CAR, action=DiscreteAction(("a", "b", "c")))) is None
    assert scene_of(SpaceSpec(CAR.observation[:1], car.action, 0.1)) is None


@pytest.mark.parametrize("actions", [None, np.tile(np.arange(30) % 3, (2, 1))])
def test_every_group_of_rollouts_has_a_film(actions: Any) -> None:
    arrays = Arrays(**{**example_arrays(CAR, 2), "rollout_actions": actions})
    car = dataclasses.replace(CAR, action=DiscreteAction(MOUNTAIN_CAR.actions))
    figure = animations(arrays, car)
    assert figure is not None
    assert [panel.name for panel in figure.panels] == ["animation-no_wall", "animation-wall"]
    assert ("arrow" in figure.caption) == (actions is not None)
    assert "no wall; left as it was" in figure.panels[0].alternative
    assert animations(arrays, dataclasses.replace(CAR, action=DiscreteAction(("a", "b", "c")))) is None
