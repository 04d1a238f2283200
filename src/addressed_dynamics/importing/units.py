"""What a source is made of: files that are read one after the other, or at the same time by several processes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from addressed_dynamics.base.errors import LogError, ParamsError
from addressed_dynamics.base.params.source import (
    EpisodeByGap,
    EpisodePerFile,
    LerobotSource,
    McapSource,
    MinariSource,
    SourceParams,
    TableSource,
)
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.lerobot import read_info, read_lerobot
from addressed_dynamics.importing.mcap_logs import read_mcap
from addressed_dynamics.importing.minari_data import read_minari
from addressed_dynamics.importing.paths import parse_path
from addressed_dynamics.importing.recordings import Recording, recordings
from addressed_dynamics.importing.ros_bags import bag_files, is_bag, whole_bags
from addressed_dynamics.importing.samples import Recorded, with_ends, without_offsets
from addressed_dynamics.importing.signals import Signals
from addressed_dynamics.importing.stores import is_url
from addressed_dynamics.importing.tables import in_order, natural_order, read_tables

Unit = tuple[Path, ...]
"""Files of which no episode goes on in others: a recording, a table, or all tables of a source. Empty for a dataset,
which knows its files."""


def units_of(source: SourceParams, signals: Signals, copies: Collection[Path] = ()) -> list[Unit]:
    """Return what a source is made of, in the order in which it is imported.

    Args:
        source: the section of the params.
        signals: what is imported.
        copies: where the files of object stores are, or will be while they are read, if any are.

    Raises:
        ParamsError: `source` has a malformed path, or says something of a topic that no field is of.
        LogError: there are no files.
        TableError: the time of a table cannot be read.
    """
    match source:
        case McapSource():
            _check_topics(source, {parse_path(signal.field).topic for signal in signals.all})
            return _recordings(source, copies)
        case TableSource(episode=EpisodePerFile()):
            return [(file,) for file in in_order(_files(source.files, copies), source)]
        case TableSource():
            return [tuple(_files(source.files, copies))]
        case _:
            return [()]


def read_unit(
    source: SourceParams, unit: Unit, signals: Signals, agreement: Agreement
) -> Iterator[tuple[str, Recorded]]:
    """Yield the samples of each recording in a unit, under the name of its first file.

    Raises:
        LogError: a file is damaged, lacks what `source` names, or does not agree with those before.
        TableError: the same of a table.
    """
    for origin, recorded in _read(source, unit, signals, agreement):
        yield origin, without_offsets(with_ends(recorded, signals), signals)


def read_samples(source: SourceParams, signals: Signals) -> Iterator[tuple[str, Recorded]]:
    """Yield the samples of all recordings, in order.

    Raises:
        ParamsError: as in `units_of`.
        LogError: as in `units_of` and `read_unit`.
        TableError: as in `units_of` and `read_unit`.
    """
    agreement = Agreement()
    for unit in units_of(source, signals):
        yield from read_unit(source, unit, signals, agreement)


def _read(source: SourceParams, unit: Unit, signals: Signals, agreement: Agreement) -> Iterator[tuple[str, Recorded]]:
    match source:
        case McapSource():
            paths = [parse_path(signal.field) for signal in signals.all]
            yield unit[0].as_posix(), read_mcap(unit, source, signals, paths, agreement)
        case TableSource():
            for origin, samples in read_tables(unit, source, signals, agreement):
                yield origin, Recorded.of(samples)
        case LerobotSource():
            for origin, samples in read_lerobot(read_info(source), signals, agreement):
                yield origin, Recorded.of(samples)
        case MinariSource():
            yield source.dataset, Recorded.of(read_minari(source.dataset, signals, agreement))


def _check_topics(source: McapSource, used: set[str]) -> None:
    unknown = sorted(source.topics.keys() - used)
    if unknown:
        message = (
            f"source.topics: '{unknown[0]}' is the topic of no field, so what is said of it would not count; the "
            f"topics of the fields are: {', '.join(sorted(used))}"
        )
        raise ParamsError(message)


def _recordings(source: McapSource, copies: Collection[Path]) -> list[Recording]:
    found = whole_bags(_files(source.files, copies, or_if=is_bag))
    whole = [bag_files(path) if is_bag(path) else (path,) for path in found]
    match source.episode:
        case EpisodePerFile():
            return whole
        case EpisodeByGap(seconds=seconds):
            return recordings(whole, round(seconds * 1e9))
        case _:
            return recordings(whole, round(source.tolerance_s * 1e9))


def _files(
    patterns: tuple[str, ...], copies: Collection[Path], or_if: Callable[[Path], bool] = Path.is_file
) -> list[Path]:
    found: set[Path] = set(copies)
    for pattern in patterns:
        if is_url(pattern):
            if not copies:
                message = f"'{pattern}' is in an object store, which only an import reads; name files of this machine"
                raise LogError(message)
            continue
        root = Path(Path(pattern).anchor)
        matches = {file for file in root.glob(str(Path(pattern).relative_to(root))) if file.is_file() or or_if(file)}
        if not matches:
            message = f"no file matches '{pattern}' in {Path.cwd()}; correct the 'files' of the source"
            raise LogError(message)
        found |= matches
    return sorted(found, key=natural_order)
