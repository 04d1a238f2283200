"""Transitions from wherever they are kept: MCAP logs or Parquet tables, a file or a folder."""

from pathlib import Path

from addressed_dynamics.base.errors import AddressedDynamicsError, LogError, TransitionsError
from addressed_dynamics.episodes.parquet import load_transitions, read_table
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.logs import read_log
from addressed_dynamics.sources.transitions.numbering import NumberedLog, renumber, unique_numbers


def read_transitions(path: Path | str) -> Transitions:
    """Read the transitions in an MCAP log, a Parquet table, or a folder of either.

    Logs of a folder may be of different recordings, each with episodes from 0, as recorders side by side leave them: if
    an identifier is in two recordings, all episodes of the folder get new ones, from 0 in the order in which they are
    read.

    Args:
        path: a `.mcap` or `.parquet` file, a folder of such files (read in the order of their names), or an
            experiment's folder of tables.

    Raises:
        LogError: a log is damaged, or the logs of a folder do not fit together: their spaces differ, two of one
            recording have the same episode, or one is a copy of another.
        TableError: a table is damaged, or the tables of a folder do not fit together.
        AddressedDynamicsError: nothing is at `path`, or it is something else.
    """
    path = Path(path)
    if path.is_dir():
        logs = sorted(path.glob("*.mcap"))
        return _join(path, logs) if logs else load_transitions(path)
    if not path.exists():
        message = f"{path}: expected an MCAP log, a Parquet table or a folder of them, but nothing is there"
        raise AddressedDynamicsError(message)
    match path.suffix:
        case ".mcap":
            return read_log(path).transitions
        case ".parquet":
            return read_table(path).transitions
        case suffix:
            message = f"{path}: expected a file that ends in .mcap or .parquet, found '{suffix}'"
            raise AddressedDynamicsError(message)


def _join(folder: Path, logs: list[Path]) -> Transitions:
    contents = [read_log(log) for log in logs]
    numbers = unique_numbers(
        [
            NumberedLog(log, each.recording, tuple(record.episode for record in each.episodes))
            for log, each in zip(logs, contents, strict=True)
        ]
    )
    try:
        return Transitions.concatenate(
            [renumber(each.transitions, own) for each, own in zip(contents, numbers, strict=True)]
        )
    except TransitionsError as error:
        message = f"{folder}: {error}"
        raise LogError(message) from error
