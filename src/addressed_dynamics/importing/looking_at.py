"""Look at files of any kind that can be imported."""

from __future__ import annotations

from addressed_dynamics.importing.finding import Found
from addressed_dynamics.importing.looking import Look, look_at_logs
from addressed_dynamics.importing.looking_at_tables import (
    look_at_csv,
    look_at_lerobot,
    look_at_minari,
    look_at_parquet,
)


def look_at(found: Found, types: tuple[str, ...] = ()) -> Look:
    """Look at all files that one source reads.

    Args:
        found: the files.
        types: folders or files with definitions of messages, for logs that do not carry them.

    Raises:
        LogError: a log is damaged, or definitions are missing.
        TableError: a table or a dataset is.
    """
    match found.kind:
        case "csv":
            return look_at_csv(found)
        case "parquet":
            return look_at_parquet(found)
        case "lerobot":
            return look_at_lerobot(found)
        case "minari":
            return look_at_minari(found)
        case _:
            return look_at_logs(found.files, types)
