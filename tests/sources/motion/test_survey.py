"""Surveys: clips and cycles are found again with and without names, and every copy is counted and left out."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motion_examples import assert_same_motion, concatenate, make_clip, on_patches, save_database
from pfnn_data import PFNN_DATA, needs_pfnn_data

from addressed_dynamics import Motion, read_motion
from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.layout import OUTPUT
from addressed_dynamics.sources.motion import source
from addressed_dynamics.sources.motion import survey as survey_module
from addressed_dynamics.sources.motion.contents import cycle_starts
from addressed_dynamics.sources.motion.source import stream_motion, survey_motion
from addressed_dynamics.sources.motion.survey import survey_database

lengths = st.lists(st.integers(3, 9), min_size=1, max_size=4)


def clips(shape: list[list[int]]) -> Motion:
    """Return clips with cycles of these lengths."""
    return concatenate([make_clip(f"clip_{n:04d}", each, seed=n) for n, each in enumerate(shape)])


@settings(max_examples=40)
@given(
    shape=st.lists(lengths, min_size=1, max_size=3),
    patches=st.integers(1, 4),
    hilly=st.booleans(),
    named=st.booleans(),
    block=st.integers(1, 40),
)
def test_clips_are_read_back_on_one_patch_whether_the_database_names_them_or_not(
    tmp_path_factory: pytest.TempPathFactory, shape: list[list[int]], patches: int, hilly: bool, named: bool, block: int
) -> None:
    motion = clips(shape)
    copies, patch = on_patches(motion, patches, hilly=hilly)
    first = concatenate([copies.select(rows) for rows in first_patches(copies, patch)])
    path = save_database(tmp_path_factory.mktemp("database") / "d.npz", copies, patch if named else None)
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(survey_module, "BLOCK_ROWS", block)
        survey = survey_database(path)
    assert_same_motion(concatenate(list(stream_motion(path, survey, rows=10))), first)
    extra = len(copies) - len(motion)
    assert survey.rows == len(copies)
    assert survey.kept_rows == len(motion)
    assert (survey.exact_duplicates, survey.other_patches) == ((0, extra) if hilly else (extra, 0))
    assert survey.boundaries == ("meta" if named else "phase")


def first_patches(copies: Motion, patch: np.ndarray[Any, Any]) -> Iterator[slice]:
    starts = np.flatnonzero(
        np.diff(np.concatenate([[-1], patch])) | np.isin(np.arange(len(patch)), cycle_starts(copies))
    )
    for start, stop in zip(starts, [*starts[1:], len(copies)], strict=True):
        if patch[start] == 0:
            yield slice(start, stop)


@needs_pfnn_data
def test_the_reference_database_is_read_exactly_as_it_is() -> None:
    motion = read_motion(PFNN_DATA / "database_flat.npz")
    with np.load(PFNN_DATA / "database_flat.npz") as file:
        meta = file["meta"]
        expected = Motion(
            file["Xun"], file["Yun"], file["Pun"], file["clips"][meta[:, 0]],
            meta[:, 1].astype(np.int64), meta[:, 2].astype(np.int64),
        )  # fmt: skip
    assert len(motion) == 2899
    assert_same_motion(motion, expected)
    assert motion.x.dtype == motion.y.dtype == motion.phase.dtype == np.float32


@needs_pfnn_data
def test_real_clips_and_their_mirrors_are_told_from_the_phase_alone(tmp_path: Path) -> None:
    named = read_motion(PFNN_DATA / "database_flat.npz")
    path = save_database(tmp_path / "d.npz", named)
    survey, found = survey_motion(path), read_motion(path)
    names = dict(zip(dict.fromkeys(found.clip.tolist()), dict.fromkeys(named.clip.tolist()), strict=True))
    assert [names[clip] for clip in found.clip.tolist()] == named.clip.tolist()
    np.testing.assert_array_equal(cycle_starts(found), cycle_starts(named))
    for clip, group in survey.groups.items():
        assert names[group] == names[clip].removesuffix("_mirror")
        # Frames count from another one, but alike in a clip and in its mirror.
        shifts = named.frame[np.isin(found.clip, [clip, group])] - found.frame[np.isin(found.clip, [clip, group])]
        assert len(set(shifts.tolist())) == 1
    assert min(found.frame) == 0


def mirrored(motion: Motion, rows: slice, name: str, cuts: list[int]) -> Motion:
    """Return other motion in which only the hips rise and fall like in `motion`."""
    other = make_clip(name, cuts, seed=99)
    y, frame = other.y.copy(), other.frame
    rise = OUTPUT.names.index("joint_velocity.Hips.y")
    y[:, rise] = motion.y[rows, rise][frame]
    return Motion(other.x, y, other.phase, other.clip, other.frame, other.cycle)


def test_a_mirror_joins_the_parts_of_a_performance(tmp_path: Path) -> None:
    # One cycle each, so that rows are frames; in between, other clips and a pause that the database leaves out.
    whole = make_clip("whole", (100,))
    first, second = make_part(whole, slice(0, 40)), make_part(whole, slice(50, 100))
    mirror = mirrored(whole, slice(None), "mirror", [30, 41, 31])
    path = save_database(tmp_path / "d.npz", concatenate([first, make_clip("b", (20,), seed=5), second, mirror]))
    survey = survey_database(path)
    assert survey.groups == {"clip_0000": "clip_0000", "clip_0001": "clip_0001", "clip_0002": "clip_0000",
                             "clip_0003": "clip_0000"}  # fmt: skip
    assert [(cycle.clip, cycle.frame) for cycle in survey.cycles] == [
        ("clip_0000", 0), ("clip_0001", 0), ("clip_0002", 50), ("clip_0003", 0), ("clip_0003", 29), ("clip_0003", 69),
    ]  # fmt: skip


def make_part(whole: Motion, rows: slice) -> Motion:
    part = whole.select(rows)
    phase = np.linspace(0, 1, len(part), dtype=np.float32)
    return Motion(part.x, part.y, phase, part.clip, part.frame, part.cycle)


def test_a_clip_that_occurs_again_under_another_name_is_dropped(tmp_path: Path) -> None:
    clip = make_clip("walk", (6, 5))
    again = Motion(clip.x, clip.y, clip.phase, np.full(len(clip), "copy"), clip.frame, clip.cycle)
    path = save_database(tmp_path / "d.npz", concatenate([clip, again]), np.zeros(2 * len(clip), np.int64))
    survey = survey_database(path)
    assert_same_motion(read_motion(path), clip)
    assert (survey.exact_duplicates, survey.other_patches) == (len(clip), 0)


def test_a_phase_that_dips_inside_a_cycle_does_not_part_it(tmp_path: Path) -> None:
    clip = make_clip("walk", (9, 7))
    phase = clip.phase.copy()
    phase[1] = 0.98  # a cycle can begin a little before its own phase does
    motion = Motion(clip.x, clip.y, phase, clip.clip, clip.frame, clip.cycle)
    assert [cycle.rows for cycle in survey_database(save_database(tmp_path / "d.npz", motion)).cycles] == [9, 7]


def test_a_cycle_that_ends_early_is_parted_from_the_next(tmp_path: Path) -> None:
    motion = concatenate([make_clip("a", (9,)).select(slice(0, 6)), make_clip("b", (7,), seed=1)])
    survey = survey_database(save_database(tmp_path / "d.npz", motion))
    assert [(cycle.clip, cycle.rows) for cycle in survey.cycles] == [("clip_0000", 6), ("clip_0001", 7)]


def test_rows_without_cycles_are_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(survey_module, "MAX_CYCLE_ROWS", 30)
    path = save_database(tmp_path / "d.npz", make_clip("walk", (5, 31, 4)))
    with pytest.raises(MotionError, match=r"d\.npz: rows 5 to 35 are one gait cycle of 31 rows; expected the phase to"):
        survey_database(path)


def test_frames_that_skip_inside_a_cycle_are_an_error(tmp_path: Path) -> None:
    motion = make_clip("walk", (9, 7))
    kept = np.array([row for row in range(len(motion)) if row != 12])
    path = save_database(tmp_path / "d.npz", motion.select(kept), np.zeros(len(kept), np.int64))
    with pytest.raises(MotionError, match=r"d\.npz: meta: row 12: expected the frame after that of the row before it"):
        survey_database(path)


@pytest.mark.parametrize("rows", [1, 12, 1000])
def test_blocks_hold_whole_cycles_and_no_more_rows_than_asked_if_cycles_allow(tmp_path: Path, rows: int) -> None:
    motion = clips([[5, 6, 7], [8, 3]])
    parts = list(stream_motion(save_database(tmp_path / "d.npz", motion), rows=rows))
    assert_same_motion(concatenate(parts), motion)
    assert all(len(part) <= rows or len(cycle_starts(part)) == 1 for part in parts)
    assert [len(part) for part in parts] == {1: [5, 6, 7, 8, 3], 12: [11, 7, 11], 1000: [29]}[rows]


@pytest.fixture
def folder_of_clips(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, list[Motion]]:
    """Return a folder, and the clips that its import finds in it."""
    without_cycles = make_clip("short", (3,)).select(slice(0))
    found = [make_clip("run", (6, 5), first_frame=60), without_cycles, make_clip("walk", (8,), seed=1, first_frame=61)]
    monkeypatch.setattr(source, "read_clips", lambda folder: iter(found if folder == tmp_path else []))
    return tmp_path, found


def test_a_folder_of_clips_is_read_like_a_database(folder_of_clips: tuple[Path, list[Motion]]) -> None:
    folder, found = folder_of_clips
    assert_same_motion(read_motion(folder), concatenate(found))
    assert_same_motion(concatenate(list(stream_motion(folder, rows=7))), concatenate(found))
    survey = survey_motion(folder)
    assert [(cycle.row, cycle.rows, cycle.clip, cycle.cycle, cycle.frame) for cycle in survey.cycles] == [
        (0, 6, "run", 0, 60), (6, 5, "run", 1, 65), (11, 8, "walk", 0, 61),
    ]  # fmt: skip
    assert (survey.rows, survey.exact_duplicates, survey.boundaries) == (19, 0, "files")


def test_a_path_that_is_neither_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match="expected a database of motion"):
        read_motion(str(tmp_path / "nowhere"))
