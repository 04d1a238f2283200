"""Damaged tables and datasets raise nothing but the project's errors."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from foreign_logs import source
from foreign_tables import TABLE
from lerobot_data import frames, write_v2, write_v3
from test_import_lerobot import LEROBOT

from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.base.params.source import LerobotSource
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.importer import import_logs
from addressed_dynamics.importing.lerobot import read_info, read_lerobot
from addressed_dynamics.importing.signals import signals_of
from addressed_dynamics.importing.tables import read_tables

ROUNDS = 500
"""Damaged files of each kind."""
BY_COLUMN: dict[str, Any] = {"episode": {"by": "column", "column": "e"}, "clock": {"column": "t"}}


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Cut off, flip, insert, remove or overwrite one to three places."""
    result = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        place = int(rng.integers(0, max(1, len(result))))
        match int(rng.integers(0, 5)):
            case 0:
                del result[place:]
            case 1 if result:
                result[place % len(result)] ^= 1 << int(rng.integers(0, 8))
            case 2:
                result[place:place] = rng.integers(0, 256, 3, dtype=np.uint8).tobytes()
            case 3:
                del result[place : place + 4]
            case _:
                result[place : place + 4] = rng.choice([b'"', b"\n", b",,", b"\x00\xff", b"nan", b"9e999"])
    return bytes(result)


def tolerated(read: Callable[[], object]) -> bool:
    """Whether something was read; any error but the project's own is passed on."""
    try:
        read()
    except AddressedDynamicsError as error:
        message = str(error)
    else:
        return True
    assert "\n" not in message
    return False


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_damaged_table_raises_only_project_errors(tmp_path: Path, kind: str) -> None:
    rng = np.random.default_rng(7)
    index = np.arange(12)
    table = polars.DataFrame({"e": index // 4, "t": index / 20, "q": index / 3, "u": index % 3})
    file = tmp_path / f"a.{kind}"
    table.write_csv(file) if kind == "csv" else table.write_parquet(file)
    sound = file.read_bytes()
    asked = source(**TABLE | BY_COLUMN | {"kind": kind, "files": ["a"]})
    outcomes = set()
    for _ in range(ROUNDS):
        file.write_bytes(damaged(sound, rng))
        outcomes.add(tolerated(lambda: list(read_tables([file], asked, signals_of(asked), Agreement()))))
    assert outcomes == {True, False}


@pytest.mark.parametrize("write", [write_v2, write_v3])
def test_a_damaged_dataset_raises_only_project_errors(tmp_path: Path, write: Callable[..., None]) -> None:
    rng = np.random.default_rng(11)
    folder = tmp_path / "set"
    write(folder, frames(episodes=2, steps=4))
    files = {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
    asked = source(**LEROBOT | {"folder": str(folder), "tolerance_s": ...})
    assert isinstance(asked, LerobotSource)

    def read() -> None:
        dataset = read_info(asked)
        list(read_lerobot(dataset, signals_of(asked, dataset.fps), Agreement()))

    outcomes = set()
    for _ in range(ROUNDS):
        path = list(files)[int(rng.integers(len(files)))]
        path.write_bytes(damaged(files[path], rng))
        outcomes.add(tolerated(read))
        path.write_bytes(files[path])
    assert outcomes == {True, False}


def test_what_is_read_of_a_damaged_table_can_be_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(13)
    file = tmp_path / "a.csv"
    index = np.arange(12)
    polars.DataFrame({"q": index / 3, "u": index % 3}).write_csv(file)
    sound, outcomes = file.read_bytes(), set()
    asked = source(**TABLE | {"files": [str(file)]})
    for _ in range(50):
        file.write_bytes(damaged(sound, rng))
        out = tmp_path / "out"
        outcomes.add(tolerated(lambda out=out: import_logs(asked, out, name="arm", progress=lambda _: None)))
        shutil.rmtree(out, ignore_errors=True)
    assert True in outcomes
