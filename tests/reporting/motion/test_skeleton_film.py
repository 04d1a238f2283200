"""Films of skeletons: who is drawn where, what lies on the ground, the clock, and the size."""

import io
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from films import frames
from PIL import Image, ImageChops, ImageColor

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.episodes.layout import JOINTS, PARENTS
from addressed_dynamics.recording.walker.body import OFFSETS
from addressed_dynamics.recording.walker.clips import walk
from addressed_dynamics.recording.walker.script import SCRIPTS
from addressed_dynamics.reporting.common.animation.camera import Camera
from addressed_dynamics.reporting.common.animation.film import GAP, HEAD
from addressed_dynamics.reporting.common.animation.gif import Palette
from addressed_dynamics.reporting.motion.actors import Actor
from addressed_dynamics.reporting.motion.animation import skeleton
from addressed_dynamics.reporting.motion.animation.skeleton import HEIGHT, SIDE, skeleton_film


def walker(seconds: float, seed: int = 0) -> Any:
    """Positions of the joints of someone who walks and jogs, at 60 Hz."""
    clip = walk("", SCRIPTS["changes"], seconds, np.random.default_rng(seed))
    turned, places = clip.turns[::2].copy(), np.zeros((len(clip.turns[::2]), len(JOINTS), 3))
    places[:, 0] = clip.place[::2]
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            turned[:, joint] = turned[:, parent] @ turned[:, joint]
            places[:, joint] = places[:, parent] + turned[:, parent] @ OFFSETS[joint]
    return places


@pytest.fixture(scope="module")
def moving() -> Any:
    return walker(1.0)


def pixels(image: Image.Image, colour: str) -> int:
    """How many pixels are of a colour."""
    return int((np.asarray(image) == ImageColor.getrgb(colour)).all(axis=2).sum())


def sides(image: Image.Image) -> list[Image.Image]:
    return [image.crop((left, HEAD, left + SIDE, HEAD + HEIGHT)) for left in (0, SIDE + GAP)]


def test_a_film_shows_each_person_on_a_side_in_a_colour_of_its_own(moving: Any) -> None:
    panel = skeleton_film("legs", "walk", [Actor("ours", moving), Actor("theirs", moving)])
    shown = frames(panel)
    assert len(shown) == 12, "every fifth of 60 frames"
    assert all(ImageChops.difference(a, b).getbbox() for a, b in pairwise(shown))
    assert shown[0].size == (panel.width, panel.height) == (2 * SIDE + GAP, shown[0].height)
    for frame in shown:
        left, right = sides(frame)
        assert min(pixels(left, "#0072b2"), pixels(right, "#5a5a5a")) > 1500
        assert max(pixels(left, "#5a5a5a"), pixels(right, "#0072b2")) == 0
    assert panel.alternative == "Animation: walk; ours left, theirs right"


def test_a_film_of_one_person_is_half_as_wide(moving: Any) -> None:
    panel = skeleton_film("legs", "walk", [Actor("ours", moving)])
    assert (panel.width, panel.alternative) == (SIDE, "Animation: walk; ours")


@pytest.mark.parametrize(("longest", "shown"), [(10.0, 1000), (0.5, 500)])
def test_a_film_passes_as_fast_as_the_motion_until_it_is_long_enough(
    moving: Any, monkeypatch: pytest.MonkeyPatch, longest: float, shown: int
) -> None:
    monkeypatch.setattr(skeleton, "SECONDS", longest)
    with Image.open(io.BytesIO(skeleton_film("legs", "", [Actor("ours", moving)]).content)) as file:
        durations = []
        for index in range(file.n_frames):
            file.seek(index)
            durations.append(file.info["duration"])
    assert sum(durations) == shown


def test_who_runs_stays_in_the_picture_and_who_is_far_away_looks_the_same(moving: Any) -> None:
    fast = moving + 12.0 * np.arange(len(moving))[:, None, None] * [1, 0, 1]
    for frame in frames(skeleton_film("legs", "", [Actor("ours", fast)])):
        x = np.flatnonzero((np.asarray(sides(frame)[0]) == ImageColor.getrgb("#0072b2")).all(axis=2).any(axis=0))
        assert x.min() > 20
        assert x.max() < SIDE - 20
    here, there = (
        frames(skeleton_film("legs", "", [Actor("ours", moving + shift)]))[3]
        for shift in (0.0, np.array([80_000.0, 0.0, -160_000.0]))
    )
    assert not ImageChops.difference(here, there).getbbox()


def test_feet_that_touch_and_the_command_are_marked(moving: Any) -> None:
    touching = np.zeros((len(moving), 4))
    command = np.tile([1.5, -2.0], (len(moving), 1))
    plain = frames(skeleton_film("legs", "", [Actor("ours", moving, touching)]))[-1]
    marked = frames(skeleton_film("legs", "", [Actor("ours", moving, touching + 1)], command))[-1]
    asked_to_stand = frames(skeleton_film("legs", "", [Actor("ours", moving)], 0 * command))[-1]
    assert pixels(plain, "#009e73") == 0
    assert pixels(marked, "#009e73") > 50
    assert pixels(sides(plain)[0], "#d55e00") == 0
    assert pixels(sides(marked)[0], "#d55e00") > 100
    assert pixels(sides(asked_to_stand)[0], "#d55e00") == 0
    assert pixels(asked_to_stand, "#d55e00") > 20, "the words"


def test_five_seconds_of_two_people_are_less_than_half_a_megabyte() -> None:
    actors = [Actor("ours", walker(5.0, 1)), Actor("theirs", walker(5.0, 2))]
    assert len(skeleton_film("legs", "walk", actors, np.tile([1.0, 2.0], (300, 1))).content) < 0.5e6


def test_the_same_motion_makes_the_same_bytes(moving: Any) -> None:
    assert skeleton_film("legs", "", [Actor("ours", moving)]) == skeleton_film("legs", "", [Actor("ours", moving)])


@pytest.mark.parametrize("lost", [1e9, -1e9])
def test_a_model_that_lost_its_limbs_has_a_film_too(moving: Any, lost: float) -> None:
    torn = moving + lost * (np.arange(len(JOINTS)) == JOINTS.index("Head"))[:, None]
    assert len(frames(skeleton_film("legs", "", [Actor("ours", torn)]))) == 12


def test_what_cannot_be_shown_is_an_error_that_says_why(moving: Any) -> None:
    broken = moving.copy()
    broken[30, 4, 1] = np.nan
    for actors, words in (
        ([], "there are 0 actors"),
        ([Actor("ours", moving)] * 3, "there are 3 actors"),
        ([Actor("ours", moving), Actor("theirs", moving[:30])], "lengths 30, 60"),
        ([Actor("ours", moving), Actor("ours", moving)], "both actors are called 'ours'"),
        ([Actor("ours", moving[:0])], "lengths 0"),
        ([Actor("ours", broken)], "'ours'.*not finite: show it until"),
        ([Actor("ours", moving[:, :20])], r"shape \(60, 20, 3\)"),
    ):
        with pytest.raises(ReportError, match=words):
            skeleton_film("legs", "", actors)


def test_all_joints_of_a_person_are_seen_at_once(moving: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = Camera.seen
    asked: list[int] = []

    def counted(camera: Camera, points: Any) -> Any:
        asked.append(len(points))
        return seen(camera, points)

    monkeypatch.setattr(Camera, "seen", counted)
    skeleton_film("legs", "", [Actor("ours", moving)])
    assert asked.count(len(JOINTS)) == 2 * 12, "the person and the shadow in each of 12 pictures"
    assert len(asked) == 5 * 12, "beside them the tiles, the traces of the feet, and the crown of the head"


def test_a_camera_sees_its_target_in_the_middle_and_what_is_left_of_it_to_the_left() -> None:
    camera = Camera(np.array([100.0, 90.0, -50.0]), 0.0, 0.0, 800.0, 1.5)
    places = camera.seen(camera.target + np.array([[0, 0, 0], [-10, 0, 0], [0, 10, 0], [10, 0, 400]]))
    assert np.allclose(places, [(0, 0), (-15, 0), (0, 15), (30, 0)]), "what is half as far looks twice as large"
    from_the_left = Camera(np.zeros(3), np.pi / 2, 0.0, 800.0, 1.5)
    assert np.allclose(from_the_left.seen(np.array([[0.0, 0.0, 10.0]])), [(-15, 0)])


def test_a_palette_keeps_its_colours_and_white() -> None:
    colours = ["#0072b2", "#d55e00", "#efefef"]
    for colour in ("#ffffff", *colours):
        shown = Palette(colours[:2], flat=colours[2:]).reduced(Image.new("RGB", (8, 8), colour))
        assert shown.size == (4, 4)
        assert shown.convert("RGB").getpixel((1, 1)) == ImageColor.getrgb(colour)
