"""Databases: any row count, stored or deflated, in blocks; and one clear error for whatever is wrong with a file."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motion_examples import arrays_of, make_clip, save_database

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.sources.motion.database import open_database

Arrays = dict[str, Any]
MOTION = make_clip("walk", (5, 8, 4))
PATCH = np.zeros(len(MOTION), dtype=np.int64)


def read_all(path: Path, rows: int = 7) -> list[Any]:
    with open_database(path) as database:
        blocks = []
        while database.row < database.rows:
            blocks.append(database.read(rows))
    return blocks


@settings(max_examples=30)
@given(sizes=st.lists(st.integers(0, 9), max_size=6), compressed=st.booleans(), with_meta=st.booleans())
def test_blocks_of_any_size_are_the_rows_of_the_file(
    tmp_path_factory: pytest.TempPathFactory, sizes: list[int], compressed: bool, with_meta: bool
) -> None:
    path = tmp_path_factory.mktemp("database") / "database.npz"
    save_database(path, MOTION, PATCH if with_meta else None, compressed=compressed)
    with open_database(path) as database:
        assert database.rows == len(MOTION)
        assert database.clips == (("walk",) if with_meta else None)
        for size in [*sizes, len(MOTION)]:
            rows = slice(database.row, database.row + size)
            block = database.read(size)
            np.testing.assert_array_equal(block.x, MOTION.x[rows])
            np.testing.assert_array_equal(block.y, MOTION.y[rows])
            np.testing.assert_array_equal(block.phase, MOTION.phase[rows])
            assert (block.meta is not None) == with_meta
            if block.meta is not None:
                np.testing.assert_array_equal(block.meta[:, 1], MOTION.frame[rows])


def test_rows_can_be_skipped(tmp_path: Path) -> None:
    with open_database(save_database(tmp_path / "d.npz", MOTION)) as database:
        database.skip(9)
        np.testing.assert_array_equal(database.read(3).y, MOTION.y[9:12])


def test_other_floats_become_float32(tmp_path: Path) -> None:
    arrays = {name: values.astype(">f8") for name, values in arrays_of(MOTION).items()}
    np.savez(tmp_path / "d.npz", **arrays)
    (block,) = read_all(tmp_path / "d.npz", rows=100)
    assert block.x.dtype == np.float32
    np.testing.assert_array_equal(block.x, MOTION.x)


def without(name: str) -> Callable[[Arrays], Arrays]:
    return lambda arrays: {key: value for key, value in arrays.items() if key != name}


def changed(name: str, change: Callable[[Any], Any]) -> Callable[[Arrays], Arrays]:
    return lambda arrays: arrays | {name: change(arrays[name])}


def with_value(name: str, place: Any, value: float) -> Callable[[Arrays], Arrays]:
    def change(values: Any) -> Any:
        values = values.copy()
        values[place] = value
        return values

    return changed(name, change)


WRONG = {
    "a missing array": (without("Yun"), r"d\.npz: Yun: expected an array of that name, found Pun, Xun, clips, meta;"),
    "another width": (changed("Xun", lambda x: x[:, :340]), r"Xun: expected shape \(17, 342\), found \(17, 340\); the"),
    "other rows": (changed("Yun", lambda y: y[1:]), r"Yun: expected shape \(17, 311\), found \(16, 311\); all arrays"),
    "one dimension": (changed("Xun", lambda x: x[:, 0]), r"Xun: expected shape \(17, 342\), found \(17,\)"),
    "no rows": (lambda arrays: {name: values[:0] for name, values in arrays.items()}, r"Pun: expected one phase"),
    "a scalar": (changed("Pun", lambda p: p[0]), r"Pun: expected one phase for each row, found an array of shape \(\)"),
    "integers": (changed("Pun", lambda p: p.astype(int)), r"Pun: expected float32, found int64"),
    "half precision": (changed("Xun", lambda x: x.astype(np.float16)), r"Xun: expected float32, found float16"),
    "pickled objects": (changed("Xun", lambda x: x.astype(object)), r"Xun: holds pickled objects, which are never"),
    "Fortran order": (changed("Xun", np.asfortranarray), r"Xun: is stored column by column \(Fortran order\); save"),
    "a NaN": (
        with_value("Yun", (11, 2), np.nan),
        r"Yun: row 11, column 2 \(root_turn\) is not finite; leave its clip out",
    ),
    "an infinite phase": (with_value("Pun", 9, np.inf), r"Pun: row 9 is not finite"),
    "a double that is too large": (
        lambda arrays: with_value("Xun", (8, 0), 1e300)(arrays | {"Xun": arrays["Xun"].astype(float)}),
        r"Xun: row 8, column 0 \(trajectory_position_x.-60\) is not finite",
    ),
    "a phase above 1": (with_value("Pun", 10, 1.5), r"Pun: row 10: expected a phase in \[0, 1\], found 1.5"),
    "meta of floats": (changed("meta", lambda m: m.astype(float)), r"meta: expected integers, found float64"),
    "meta of another shape": (changed("meta", lambda m: m[:, :3]), r"meta: expected shape \(17, 4\) \(clip, frame"),
    "a clip without a name": (with_value("meta", (8, 0), 3), r"meta: row 8: expected numbers from 0, and one of 1 cl"),
    "a negative frame": (with_value("meta", (8, 1), -1), r"meta: row 8: expected numbers from 0.*frame -1"),
    "no names of clips": (without("clips"), r"clips: expected an array of that name"),
    "pickled names": (changed("clips", lambda c: c.astype(object)), r"clips: holds pickled objects"),
    "names that are numbers": (changed("clips", lambda c: np.zeros(len(c))), r"clips: expected a list of names, found"),
    "a name given twice": (changed("clips", lambda c: np.repeat(c, 2)), r"clips: a name occurs twice"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "message"), WRONG.values(), ids=WRONG.keys())
def test_what_is_wrong_with_an_array_is_one_clear_error(
    tmp_path: Path, change: Callable[[Arrays], Arrays], message: str
) -> None:
    np.savez(tmp_path / "d.npz", **change(arrays_of(MOTION, PATCH)))
    with pytest.raises(MotionError, match=message) as found:
        read_all(tmp_path / "d.npz")
    assert "\n" not in str(found.value)
    assert str(tmp_path / "d.npz") in str(found.value)


def test_a_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match=r"none\.npz: expected a database of motion \(\.npz\), but there is no such"):
        read_all(tmp_path / "none.npz")


@pytest.mark.parametrize("content", [b"", b"nothing like an archive" * 100])
def test_a_file_that_is_no_archive_is_an_error(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "d.npz").write_bytes(content)
    with pytest.raises(MotionError, match=r"d\.npz: expected an \.npz archive, but it is none or cut short"):
        read_all(tmp_path / "d.npz")


@settings(max_examples=40)
@given(compressed=st.booleans(), share=st.floats(0, 1, exclude_max=True))
def test_a_file_that_is_cut_short_anywhere_is_an_error(
    tmp_path_factory: pytest.TempPathFactory, compressed: bool, share: float
) -> None:
    path = save_database(tmp_path_factory.mktemp("database") / "d.npz", MOTION, compressed=compressed)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(MotionError, match=r"d\.npz"):
        read_all(path)


@settings(max_examples=60)
@given(compressed=st.booleans(), share=st.floats(0, 1, exclude_max=True), skip=st.booleans())
def test_a_flipped_byte_is_an_error_or_changes_nothing(
    tmp_path_factory: pytest.TempPathFactory, compressed: bool, share: float, skip: bool
) -> None:
    path = save_database(tmp_path_factory.mktemp("database") / "d.npz", MOTION, PATCH, compressed=compressed)
    damaged = bytearray(path.read_bytes())
    damaged[int(len(damaged) * share)] ^= 0x55
    path.write_bytes(damaged)
    try:
        with open_database(path) as database:
            if skip:
                database.skip(database.rows)
                return
            block = database.read(len(MOTION))
    except MotionError as error:
        assert "d.npz" in str(error)  # noqa: PT017 - most flips are found, but some bytes mean nothing
    else:
        np.testing.assert_array_equal(block.x, MOTION.x)
        np.testing.assert_array_equal(block.y, MOTION.y)
        np.testing.assert_array_equal(block.phase, MOTION.phase)


def test_an_array_with_fewer_rows_than_it_says_is_an_error(tmp_path: Path) -> None:
    save_database(tmp_path / "d.npz", MOTION)
    content = (tmp_path / "d.npz").read_bytes()
    assert content.count(b"(17, 311)") == 1
    (tmp_path / "d.npz").write_bytes(content.replace(b"(17, 311)", b"(19, 311)"))
    with pytest.raises(MotionError, match=r"Yun: is cut short or damaged: expected 23,636 bytes .* found 21,148"):
        read_all(tmp_path / "d.npz")


@pytest.mark.parametrize(("old", "new"), [(b"'shape': (17, 311)", b"'shape': ((7, 311)"), (b"'descr'", b"'descx'")])
def test_a_damaged_header_is_an_error(tmp_path: Path, old: bytes, new: bytes) -> None:
    save_database(tmp_path / "d.npz", MOTION)
    (tmp_path / "d.npz").write_bytes((tmp_path / "d.npz").read_bytes().replace(old, new))
    with pytest.raises(MotionError, match=r"expected an array as numpy\.savez writes it, but it cannot be read"):
        read_all(tmp_path / "d.npz")
