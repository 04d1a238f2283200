"""One row for each episode: where it comes from, how long it was, what it earned and how it ended."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Literal

import pyarrow as pa
import pyarrow.parquet as pq

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.episodes.splits import Split

Ended = Literal["terminated", "truncated", "cut"]

SCHEMA = pa.schema(
    {
        "episode": pa.int64(),
        "name": pa.string(),
        "segment": pa.string(),
        "split": pa.string(),
        "seed": pa.int64(),
        "length": pa.int64(),
        "return": pa.float64(),
        "ended": pa.string(),
        "end_time_ns": pa.int64(),
    }
)


@dataclass(frozen=True, slots=True)
class Episode:
    """What is known of an episode without its transitions; with slots, because there may be a million."""

    episode: int
    """Identifier, unique in a recording."""
    name: str
    """Stable name, which its split depends on: the name of its file and its number in it, for instance `run-7#0`; of a
    block of an episode also its number in that, `run-7#0.3`."""
    segment: str
    """Name of the part of the recording plan that it comes from."""
    split: Split | None
    """Whether it serves training, choosing or testing; None for an episode that is cut in blocks, which have their own.
    The tables hold the blocks alone."""
    seed: int | None
    """The seed that the environment was reset with; None if its generator went on."""
    length: int
    """Number of transitions."""
    total_reward: float
    """Sum of the rewards; the column `return`."""
    ended: Ended
    """`terminated` inside the task (at the goal), `truncated` by a limit, or `cut` by the end of recording or block."""
    end_time_ns: int
    """Simulated time of its last transition, in nanoseconds."""


def write_episodes(path: Path, episodes: list[Episode]) -> None:
    """Write `episodes` to the Parquet file `path`, atomically."""
    columns = [[getattr(episode, field.name) for episode in episodes] for field in fields(Episode)]
    arrays = [pa.array(column, kind.type) for column, kind in zip(columns, SCHEMA, strict=True)]
    with atomic_path(path) as temporary:
        pq.write_table(pa.table(arrays, schema=SCHEMA), temporary, compression="zstd")


def read_episodes(path: Path) -> list[Episode]:
    """Read what `write_episodes` wrote.

    Raises:
        TableError: the file is missing, damaged or of another form.
    """
    try:
        table = pq.read_table(path)
    except FileNotFoundError as error:
        message = f"{path}: no such table; run the convert stage first"
        raise TableError(message) from error
    except (pa.ArrowException, OSError) as error:
        reason = str(error).split("\n", maxsplit=1)[0]
        message = f"{path}: expected a table of episodes, but it cannot be read ({reason}); run the convert stage again"
        raise TableError(message) from error
    if table.schema.names != SCHEMA.names:
        message = f"{path}: expected the columns {', '.join(SCHEMA.names)}; found {', '.join(table.schema.names)}"
        raise TableError(message)
    names = [field.name for field in fields(Episode)]
    return [Episode(**dict(zip(names, row.values(), strict=True))) for row in table.to_pylist()]
