"""What is measured, as one long table: a row is a number with all that says what it is.

A measure without a place of its own is a module in the sub-package `measures` of a kind, for instance
`evaluation/transitions/measures/explained.py`. Its docstring is what a reader is told; `measure(candidate, held_out)`
yields its rows. It is measured of every candidate, stands in the table and is shown by the report, without an edit
anywhere else.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, Protocol

import pyarrow as pa
import pyarrow.parquet as pq

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.base.files import atomic_path

MEASURES = "measures.parquet"
"""Name of the file with the table."""


@dataclass(frozen=True)
class Row:
    """One number that was measured."""

    measure: str
    """What was measured, for instance `one_step`."""
    candidate: str
    """Of what, for instance `ensemble/argmax`."""
    quantity: str
    """Which quantity, for instance a dimension of the state; empty if there is one alone."""
    statistic: str
    """Which statistic of it, for instance `mean`."""
    value: float
    unit: str = ""
    """Unit of the value; empty if it has none or if it is not known."""
    meaning: str = ""
    """What a reader is told of a measure that has no section of its own in the report; else empty."""


class Named(Protocol):
    """Something that is measured."""

    @property
    def name(self) -> str:
        """Its name, of which there is one."""


def rows_of(candidates: Mapping[str, Any]) -> Iterator[Row]:
    """Yield a row for each number in the results of candidates, as evaluation.json has them.

    The first key is the measure, the last the statistic, and what is between them the quantity; where a list holds
    results with a `name`, that stands for its place, and its `unit` counts.
    """
    for name, results in candidates.items():
        for measure, found in results.items():
            for path, value, unit in _numbers(found):
                *quantity, statistic = path or ("value",)
                yield Row(measure, name, ".".join(quantity), statistic, value, unit)


def _numbers(found: Any, path: tuple[str, ...] = (), unit: str = "") -> Iterator[tuple[tuple[str, ...], float, str]]:
    if isinstance(found, bool):
        return
    if isinstance(found, int | float):
        yield path, float(found), unit
    elif isinstance(found, Mapping):
        for key, value in found.items():
            yield from _numbers(value, (*path, str(key)), found.get("unit", unit))
    elif isinstance(found, list | tuple):
        for index, value in enumerate(found):
            name = value.get("name", index) if isinstance(value, Mapping) else index
            yield from _numbers(value, (*path, str(name)), unit)


def further_rows(package: str, candidates: Iterable[Named], held_out: Any) -> list[Row]:
    """Measure every candidate by every module of a sub-package.

    Args:
        package: name of the package, for instance `addressed_dynamics.evaluation.transitions.measures`.
        candidates: what is measured.
        held_out: what it is measured on, as the kind of data has it.

    Raises:
        EvaluationError: a module has no docstring, or yields a row of another measure or candidate.
    """
    candidates, rows = list(candidates), list[Row]()
    for found in sorted(iter_modules(import_module(package).__path__), key=lambda each: each.name):
        module = import_module(f"{package}.{found.name}")
        meaning = (module.__doc__ or "").partition("\n\n")[0].replace("\n", " ").strip()
        if not meaning:
            message = f"{package}.{found.name}: a measure needs a docstring: it is what the report says of it"
            raise EvaluationError(message)
        for candidate in candidates:
            for row in module.measure(candidate, held_out):
                if (row.measure, row.candidate) != (found.name, candidate.name):
                    message = (
                        f"{package}.{found.name}: asked for '{candidate.name}', it measured '{row.measure}' of "
                        f"'{row.candidate}'; a measure has the name of its module"
                    )
                    raise EvaluationError(message)
                rows.append(Row(**asdict(row) | {"meaning": meaning}))
    return rows


def write_rows_of_measures(path: Path, rows: Sequence[Row]) -> None:
    """Write the table as Parquet."""
    types = {"value": pa.float64()}
    schema = pa.schema([(field.name, types.get(field.name, pa.string())) for field in fields(Row)])
    with atomic_path(path) as temporary:
        pq.write_table(pa.Table.from_pylist([asdict(row) for row in rows], schema), temporary, compression="zstd")


def read_rows_of_measures(path: Path) -> list[Row]:
    """Read the table.

    Raises:
        EvaluationError: it is missing or damaged.
    """
    try:
        return [Row(**row) for row in pq.ParquetFile(path).read().to_pylist()]
    except FileNotFoundError as error:
        message = f"{path}: missing; run the evaluate stage again"
        raise EvaluationError(message) from error
    except (OSError, pa.ArrowException, TypeError) as error:
        message = f"{path}: not the table of measures that the evaluate stage writes ({error}); run it again"
        raise EvaluationError(message) from error
