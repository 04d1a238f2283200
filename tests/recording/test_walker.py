"""The made-up walker: its feet stand still, its files fit together, and a seed is all that it depends on."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.layout import JOINTS, PARENTS
from addressed_dynamics.logs.bvh import read_bvh
from addressed_dynamics.recording.walker import make_walker_clips
from addressed_dynamics.recording.walker.body import OFFSETS
from addressed_dynamics.recording.walker.clips import CM_PER_UNIT, Clip, mirrored, walk
from addressed_dynamics.recording.walker.course import MARGIN, follow
from addressed_dynamics.recording.walker.curves import RATE, about_x, about_y, about_z, angles_of, through
from addressed_dynamics.recording.walker.feet import swing
from addressed_dynamics.recording.walker.pose import pose
from addressed_dynamics.recording.walker.script import SCRIPTS, commands, draw_style

SECONDS = 9.0
MINUTES = 16 * 6 / 60


def in_world(clip: Clip) -> np.ndarray:
    """Positions of the joints, by the book."""
    turned, places = clip.turns.copy(), np.zeros((*clip.turns.shape[:2], 3))
    places[:, 0] = clip.place
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            turned[:, joint] = turned[:, parent] @ clip.turns[:, joint]
            places[:, joint] = places[:, parent] + turned[:, parent] @ OFFSETS[joint]
    return places


@pytest.fixture(scope="module", params=list(SCRIPTS))
def clip(request: pytest.FixtureRequest) -> Clip:
    return walk(request.param, SCRIPTS[request.param], SECONDS, np.random.default_rng(3))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("walker") / "clips"
    make_walker_clips(path, seed=1, minutes=MINUTES)
    return path


def test_a_foot_that_stands_does_not_skate(clip: Clip) -> None:
    places = in_world(clip)[::2]
    for toe in ("LeftToeBase", "RightToeBase"):
        place = places[:-1, JOINTS.index(toe)]
        speed = np.linalg.norm(np.diff(places[:, JOINTS.index(toe)], axis=0), axis=1) * 60
        stands = (place[:, 1] < 6) & (speed < 8.5)  # what passes for contact in the published features
        assert stands.mean() > 0.25
        assert speed[stands].mean() < 1
        assert np.median(speed[stands]) < 0.01


def test_feet_strike_in_turn_the_right_one_first(clip: Clip) -> None:
    places = in_world(clip)
    for index, (strike, following) in enumerate(pairwise(clip.strikes)):
        toe = JOINTS.index("LeftToeBase" if index % 2 else "RightToeBase")
        stands = places[strike + (following - strike) // 2, toe]
        assert stands[1] < 3
        assert np.abs(places[strike + (following - strike) // 2 + 5, toe] - stands).max() < 0.01


def test_joints_move_about_as_fast_as_those_of_people(clip: Clip) -> None:
    velocity = np.diff(in_world(clip), axis=0) * RATE
    root = velocity[:, 0] * [1, 0, 1]
    relative = np.linalg.norm(velocity - root[:, None], axis=2).mean(axis=1)
    speed = np.linalg.norm(root, axis=1)
    assert relative[speed < 5].max(initial=0) < 30
    for slow, fast, least, most in ((80, 130, 35, 85), (180, 260, 60, 115)):
        within = (speed > slow) & (speed < fast)
        assert not within.any() or least < relative[within].mean() < most


def test_knees_bend_forwards_and_never_lock_or_fold(clip: Clip) -> None:
    for side in ("Left", "Right"):
        angles = np.degrees(angles_of(clip.turns[:, JOINTS.index(f"{side}Leg")]))
        assert np.abs(angles[:, 1:]).max() < 1e-6, "a knee is a hinge"
        assert angles[:, 0].min() > 5
        assert angles[:, 0].max() < 120


def test_legs_end_where_the_feet_are() -> None:
    generator = np.random.default_rng(5)
    style = draw_style(generator)
    course = follow(commands(SCRIPTS["changes"], SECONDS, generator), round(SECONDS * RATE), style, generator)
    feet = {"Left": swing(course, 1, style), "Right": swing(course, -1, style)}
    place, turns = pose(course, feet, style, generator)
    places = in_world(Clip("", place, turns, course.gaits, np.zeros(0, dtype=np.int64)))
    shown = slice(MARGIN, -MARGIN)
    for side, foot in feet.items():
        assert np.abs(places[shown, JOINTS.index(f"{side}ToeBase")] - foot.toe[shown]).max() < 1e-6


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_course_follows_its_commands(name: str) -> None:
    generator = np.random.default_rng(2)
    told = commands(SCRIPTS[name], SECONDS, generator)
    course = follow(told, round(SECONDS * RATE), draw_style(generator), generator)
    end = MARGIN
    for command in told:
        begin, end = end, end + round(command.seconds * RATE)
        middle = (begin + end) // 2
        if end <= MARGIN + SECONDS * RATE:
            assert course.speed[middle] == pytest.approx(command.speed, rel=0.2, abs=5)
            assert course.turn[middle] == pytest.approx(command.turn, abs=0.35)
            label = "run" if command.gait == "run" else command.gait
            assert course.gaits[middle].argmax() == ("stand", "walk", "jog", "run").index(label)


def test_a_mirror_exchanges_left_and_right(clip: Clip) -> None:
    places, seen = in_world(clip), in_world(mirrored(clip))
    for joint, other in (("LeftToeBase", "RightToeBase"), ("RightHandIndex1", "LeftHandIndex1"), ("Head", "Head")):
        expected = places[:, JOINTS.index(joint)] * [-1, 1, 1]
        assert np.abs(seen[:, JOINTS.index(other)] - expected).max() < 1e-9


def test_files_of_a_clip_fit_together(folder: Path) -> None:
    names = sorted(path.stem for path in folder.glob("*.bvh"))
    assert names == sorted(f"Walker_{name}{end}" for name in SCRIPTS for end in ("", "_mirror"))
    for name in names:
        bvh = read_bvh(folder / f"{name}.bvh")
        frames = len(bvh.positions)
        phase = np.loadtxt(folder / f"{name}.phase")
        gaits = np.loadtxt(folder / f"{name}.gait")
        assert bvh.skeleton.names == JOINTS
        assert bvh.frame_time == pytest.approx(1 / 120, abs=1e-6)
        assert frames == len(phase) == len(gaits) == 6 * 120
        assert phase.min() >= 0
        assert phase.max() < 1
        assert np.abs(gaits.sum(axis=1) - 1).max() < 1e-4
        rows = [line.split() for line in (folder / f"{name}_footsteps.txt").read_text().splitlines()]
        assert len(rows) >= 2
        assert all(len(row) == 2 for row in rows[:-1])
        assert len(rows[-1]) == 1
        for right, left in rows[:-1]:
            assert phase[int(right) - 1] == 0
            assert phase[int(left) - 1] == 0.5
        first, label = (folder / f"{name}_gait.txt").read_text().split()[:2]
        assert (first, gaits[0].argmax()) == ("1", ("stand", "walk", "jog", "run").index(label))


def test_files_hold_the_motion_that_was_made(folder: Path) -> None:
    generator = np.random.default_rng(1).spawn(len(SCRIPTS))[0]
    name, script = next(iter(SCRIPTS.items()))
    clip = walk(name, script, 6.0, generator)
    bvh = read_bvh(folder / f"Walker_{name}.bvh")
    assert np.abs(bvh.positions[:, 0] * CM_PER_UNIT - clip.place).max() < 1e-5
    x, y, z = (turn(np.radians(bvh.rotations[:, 7, axis])) for axis, turn in enumerate((about_x, about_y, about_z)))
    assert np.abs(z @ y @ x - clip.turns[:, 7]).max() < 1e-6


def test_a_seed_makes_the_same_bytes_and_another_one_does_not(folder: Path, tmp_path: Path) -> None:
    make_walker_clips(tmp_path / "again", seed=1, minutes=MINUTES)
    make_walker_clips(tmp_path / "other", seed=2, minutes=MINUTES)
    for path in folder.iterdir():
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes()
    motions = [(where / "Walker_jog.bvh").read_bytes() for where in (folder, tmp_path / "other")]
    assert motions[0] != motions[1]


def test_a_folder_with_other_files_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(MotionError, match=r"thesis\.tex.*folder of its own"):
        make_walker_clips(tmp_path, seed=0, minutes=MINUTES)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_clips_too_short_for_a_cycle_are_an_error_and_leave_nothing(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match="make it longer"):
        make_walker_clips(tmp_path / "clips", seed=0, minutes=0.5)
    assert not list(tmp_path.iterdir())


@given(st.lists(st.floats(-5, 5), min_size=3, max_size=8), st.integers(0, 2**31))
def test_a_curve_meets_its_knots_and_stays_between_them(values: list[float], seed: int) -> None:
    knots = np.cumsum(np.random.default_rng(seed).uniform(0.1, 2.0, len(values)))
    heights = np.array(values)
    assert np.allclose(through(knots, knots, heights), heights)
    for (left, right), (low, high) in zip(pairwise(knots), pairwise(values), strict=True):
        inner = through(np.linspace(left, right, 50), knots, heights)
        assert inner.min() >= min(low, high) - 1e-9
        assert inner.max() <= max(low, high) + 1e-9


@given(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1))
def test_angles_are_those_of_the_turns_that_they_make(x: float, y: float, z: float) -> None:
    turns = about_z(np.array([z])) @ about_y(np.array([y])) @ about_x(np.array([x]))
    assert np.allclose(angles_of(turns), [[x, y, z]], atol=1e-9)
