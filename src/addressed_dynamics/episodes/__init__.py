"""Transitions as Parquet tables: writing and reading them, splits, statistics and a short report on the data."""

from addressed_dynamics.episodes.parquet import (
    TransitionTable,
    load_transitions,
    read_table,
    split_writer,
    table_files,
    table_writer,
    write_table,
)
from addressed_dynamics.episodes.splits import SPLITS, Split, assign_splits, file_names

__all__ = [
    "SPLITS",
    "Split",
    "TransitionTable",
    "assign_splits",
    "file_names",
    "load_transitions",
    "read_table",
    "split_writer",
    "table_files",
    "table_writer",
    "write_table",
]
