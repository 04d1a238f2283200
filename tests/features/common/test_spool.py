import io
import os
import pickle
import platform
import resource
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.reduction import ForkingPickler
from pathlib import Path

import pytest
import torch

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.features.common.samples import Samples, Windows
from addressed_dynamics.features.common.spool import Mapped, Sink, Spool, beside, map_file, release

X = torch.arange(60, dtype=torch.float32).view(20, 3)


def write(sink: Sink) -> None:
    for part in X.split(7):
        sink.add(x=part, number=part[:, 0].to(torch.int32))


def mapped(folder: Path, name: str = "a") -> dict[str, torch.Tensor]:
    return Spool(folder, 0).columns(name, 1000, write)[0]


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """What a full disk is to a writer: no file may grow beyond so many bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_columns_that_were_written_part_by_part_are_tensors_in_files(tmp_path: Path) -> None:
    columns = mapped(tmp_path)
    assert torch.equal(columns["x"], X)
    assert torch.equal(columns["number"], X[:, 0].to(torch.int32))
    assert isinstance(columns["x"], Mapped)
    assert type(columns["x"][torch.tensor([3, 1])]) is torch.Tensor
    release(columns["x"], Windows(columns["x"], columns["number"], torch.ones(2, 1)), X)
    assert torch.equal(columns["x"], X)


def test_what_is_there_is_not_written_again(tmp_path: Path) -> None:
    first = mapped(tmp_path)

    def no_more(_: Sink) -> None:
        raise AssertionError

    again, folder = Spool(tmp_path, 0).columns("a", 1000, no_more)
    assert torch.equal(first["x"], again["x"])
    assert folder.parent == tmp_path
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize("pickler", [ForkingPickler, pickle.Pickler])
def test_another_process_is_given_the_file_and_not_its_content(tmp_path: Path, pickler: type[pickle.Pickler]) -> None:
    values = mapped(tmp_path)["x"]
    file = io.BytesIO()
    pickler(file).dump(values)
    assert len(file.getvalue()) < 1000
    found = pickle.loads(file.getvalue())
    found[2] = 100.0
    assert torch.equal(values, found)


def test_a_worker_that_does_not_see_the_file_says_so_in_one_line(tmp_path: Path) -> None:
    sent = pickle.dumps(mapped(tmp_path)["x"])
    (tmp_path / "spool-a").rename(tmp_path / "elsewhere")
    with pytest.raises(TrainingError, match=r"cannot read .*x\.bin \(No such file.*all workers have to see") as caught:
        pickle.loads(sent)
    assert "\n" not in str(caught.value)


def test_a_file_of_another_size_is_refused(tmp_path: Path) -> None:
    mapped(tmp_path)
    with pytest.raises(TrainingError, match="should have 264 bytes of samples, but has 240"):
        map_file(tmp_path / "spool-a" / "x.bin", "float32", (22, 3))


def test_a_disk_that_is_full_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    with (
        files_of_at_most(100),
        pytest.raises(TrainingError, match=r"0\.0 GB of samples that memory does not hold cannot be written there"),
    ):
        mapped(tmp_path)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(TrainingError, match=r"GB are free\); make room, or let ADDRESSED_DYNAMICS_MEMORY be larger"):
        Spool(tmp_path, 0).columns("a", 2**60, write)
    assert torch.equal(mapped(tmp_path)["x"], X)


@pytest.mark.parametrize("name", [None, "profiles"])
def test_what_is_as_large_as_samples_lies_beside_them(tmp_path: Path, name: str | None) -> None:
    columns = mapped(tmp_path)
    zeros = torch.zeros(20, dtype=torch.int64)
    in_files, in_memory = (Samples(x, columns["x"], zeros, zeros) for x in (columns["x"], X))
    assert type(beside(in_memory, name)((20, 2), dtype=torch.float64)) is torch.Tensor
    made = beside(in_files, name)((20, 2), dtype=torch.float64)
    assert isinstance(made, Mapped)
    assert made.shape == (20, 2)
    made.fill_(3.0)
    assert (tmp_path / "spool-a" / "profiles.bin").exists() == (name is not None)
    with files_of_at_most(100), pytest.raises(TrainingError, match="cannot be written there"):
        beside(in_files, "more")(200, dtype=torch.uint8)
    assert not (tmp_path / "spool-a" / "more.bin").exists()
    with files_of_at_most(100), pytest.raises(TrainingError, match="cannot be written there"):
        Spool(tmp_path, 199).scratch(200)(200, dtype=torch.uint8)


def test_what_a_killed_process_had_begun_is_removed(tmp_path: Path) -> None:
    ended = subprocess.Popen(["true"])
    ended.wait()
    begun, alive = (tmp_path / f".spool-b.{platform.node()}-{pid}.partial" for pid in (ended.pid, os.getpid()))
    begun.mkdir()
    alive.mkdir()
    mapped(tmp_path)
    assert not begun.exists()
    assert alive.exists()
