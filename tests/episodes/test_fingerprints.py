"""Equal rows are found in files as they are in memory, which is as a loop finds them."""

import tempfile
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.episodes import fingerprints
from addressed_dynamics.episodes.fingerprints import (
    Buckets,
    Duplicates,
    find_duplicates,
    fingerprint_writer,
    row_fingerprints,
)

# Few different ones, in the first bucket, in the last one, and between.
SOME = st.sampled_from([0, 1, 2**32, 2**62, 2**63, 2**63 + 1, 2**64 - 2, 2**64 - 1])
BLOCKS = st.lists(arrays(np.uint64, st.integers(0, 12), elements=SOME), min_size=1, max_size=6)


def naive(blocks: list[np.ndarray]) -> Duplicates:
    seen, count, first, rows = set[int](), 0, None, np.concatenate(blocks).tolist()
    for row, value in enumerate(rows):
        if value in seen:
            count += 1
            first = row if first is None else first
        seen.add(value)
    return Duplicates(count, len(rows), first)


@given(BLOCKS, st.integers(1, 40), st.integers(1, 20))
def test_what_is_found_in_files_is_what_is_found_in_memory(
    blocks: list[np.ndarray], waiting: int, bucket_rows: int
) -> None:
    with (
        tempfile.TemporaryDirectory() as name,
        mock.patch.multiple(fingerprints, WAITING_ROWS=waiting, BUCKET_ROWS=bucket_rows, MOST_BUCKETS=16),
    ):
        buckets = Buckets(Path(name) / "buckets", sum(map(len, blocks)))
        for number, block in enumerate(blocks):
            if number % 2:
                buckets.add(block)
            else:
                with fingerprint_writer(Path(name) / "log") as write:
                    write(block[:3])
                    write(block[3:])
                buckets.add_file(Path(name) / "log")
        found = buckets.find()
        assert [path.name for path in Path(name).iterdir()] == ["buckets"]
    assert found == naive(blocks) == find_duplicates(np.concatenate(blocks))


def test_a_file_has_about_as_many_rows_as_are_looked_through_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fingerprints, "BUCKET_ROWS", 2**10)
    buckets = Buckets(tmp_path, 2**14)
    buckets.add(row_fingerprints(np.arange(2**14)))
    assert buckets.find().count == 0
    rows = [path.stat().st_size / 16 for path in tmp_path.iterdir()]
    assert len(rows) == 16
    assert max(rows) < 1.2 * 2**10


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a file that is always full")
def test_a_disk_that_is_full_is_one_line(tmp_path: Path) -> None:
    buckets = Buckets(tmp_path, 2)
    for name in ("0000", "0001"):
        (tmp_path / name).symlink_to("/dev/full")
    buckets.add(np.array([1, 2], np.uint64))
    with pytest.raises(TableError, match=r"equal rows.* cannot be set aside there \(No space left on device\)"):
        buckets.find()
