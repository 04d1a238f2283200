"""Import what somebody else recorded: one of our logs for each of their files, and an account of what was done.

Recordings that do not depend on each other but for what they have to agree in are read at the same time, by processes
of this machine or by Ray: the first one alone, the others by what it has shown. One for which that was not enough,
because a file in between has shown something else that it depends on, is read again in its turn.
"""

from __future__ import annotations

import importlib.metadata
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from addressed_dynamics.base.cluster import engine
from addressed_dynamics.base.errors import AddressedDynamicsError, LogError
from addressed_dynamics.base.failures import Failure
from addressed_dynamics.base.files import atomic_path, remove_partial, write_json
from addressed_dynamics.base.params.source import (
    EpisodePerFile,
    LerobotSource,
    McapSource,
    MinariSource,
    SourceParams,
    TableSource,
)
from addressed_dynamics.base.processes import OrderedMap, worker_processes
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.lerobot import read_info
from addressed_dynamics.importing.precision import LostSteps, Precision, lost_steps
from addressed_dynamics.importing.samples import (
    EPISODES_PER_FILE,
    Episodes,
    dimension_columns,
    find_episodes,
    out_of_range,
    transition_blocks,
)
from addressed_dynamics.importing.signals import Signals, signals_of
from addressed_dynamics.importing.stores import COPIES, Remote, copied, find_remote, is_url, said
from addressed_dynamics.importing.units import Unit, read_unit, units_of
from addressed_dynamics.logs import RunInfo, write_log

ACCOUNT = "import.json"
"""Name of the file that says what was read, dropped, late and held."""
SEGMENT = "imported"
"""The name that all imported logs have where recordings have the segment of their plan."""
WORKER_BYTES = 2 * 2**20
"""A worker process for every so many bytes of files: to start one takes as long as to import about half of them."""
WORKER_TABLE_BYTES = 32 * 2**20
"""The same of tables, whose numbers are read much faster than messages."""


@dataclass(frozen=True)
class _Job:
    """Recordings to import one after the other."""

    source: SourceParams
    unit: Unit
    first: int
    """The number of the first of them among all of the source."""
    run: RunInfo
    folder: Path
    """Where the logs go."""
    remote: tuple[Remote, ...] = ()
    """Objects in stores to copy before, and to remove after: those of the unit that nobody has copied yet."""


@dataclass(frozen=True)
class _Imported:
    """The account of one recording."""

    origin: str
    counts: dict[str, int]
    details: dict[str, Any]
    lost: LostSteps
    copied: dict[str, dict[str, Any]]
    """What stores say of the objects that it was copied from, by their URLs."""


@dataclass(frozen=True)
class _Attempt:
    """What came of a job that was done before its turn."""

    after: Agreement
    """What was known after it."""
    recordings: tuple[_Imported, ...]
    """Nothing if it failed."""
    failure: Failure | None = None

    @property
    def transitions(self) -> int:
        """Number of transitions that it wrote."""
        return sum(each.counts["transitions"] for each in self.recordings)


def import_logs(
    source: SourceParams, folder: Path, *, name: str, progress: Callable[[int], object], cores: int = 1
) -> None:
    """Import `source` into `folder`; the same files make the same bytes.

    Args:
        source: which files, and which of their fields make a transition.
        folder: where the logs go, one for each file, and `import.json`.
        name: what is imported, for the people who find the logs.
        progress: called with the number of transitions written since its last call.
        cores: the most recordings to read at once.

    Raises:
        ParamsError: `source` has a malformed path or slice, or says something of a topic that no field is of.
        SpaceError: a dimension has a name that a log cannot hold.
        LogError: there are no files, one is damaged or lacks what `source` names, they do not agree, or there is no
            episode in them.
        TableError: the same of a table; or float32 swallows most steps of a dimension.
    """
    try:
        _import_all(source, folder, name, progress, cores)
    except AddressedDynamicsError as error:
        if said(str(error), folder) == str(error):
            raise
        raise type(error)(said(str(error), folder)) from error
    finally:
        shutil.rmtree(folder / COPIES, ignore_errors=True)


def _import_all(source: SourceParams, folder: Path, name: str, progress: Callable[[int], object], cores: int) -> None:
    signals = wanted_signals(source)
    precision = Precision(signals)
    run = RunInfo(
        environment=name,
        segment=SEGMENT,
        behaviour=source.kind,
        versions={"addressed-dynamics": importlib.metadata.version("addressed-dynamics")},
    )
    remote = {each.copy: each for each in _remote(source, folder)}
    counts: dict[str, dict[str, int]] = {}
    details: dict[str, dict[str, Any]] = {}
    with ExitStack() as stack:
        one_by_one = _one_by_one(source)
        copies = {} if one_by_one else stack.enter_context(copied([*remote.values()]))
        units = units_of(source, signals, remote)
        wanted = [tuple(remote[file] for file in unit if one_by_one and file in remote) for unit in units]
        jobs = [
            _Job(source, unit, number, run, folder, each)
            for number, (unit, each) in enumerate(zip(units, wanted, strict=True))
        ]
        processes = _processes(source, units, remote, cores)
        together = len(units) > 1 and (processes > 1 or engine() is not None)
        ordered_map = stack.enter_context(worker_processes(processes)) if together else None
        for each in _in_order(jobs, ordered_map, progress):
            lost = precision.add(each.lost, each.origin)
            counts[each.origin], details[each.origin] = each.counts, each.details
            copies |= each.copied
            if lost:
                counts[each.origin]["swallowed"] = sum(lost.values())
                details[each.origin]["swallowed"] = lost
    remove_partial(folder)
    names = dict.fromkeys(name for each in counts.values() for name in each)
    totals = {name: sum(each.get(name, 0) for each in counts.values()) for name in names}
    if not totals["episodes"]:
        message = _no_episodes(source, _rate_hz(source, signals), totals, details)
        raise LogError(message)
    precision.refuse_swallowed()
    account = {"totals": totals, "files": counts, "details": details} | ({"copied": copies} if copies else {})
    write_json(folder / ACCOUNT, _settings(source, signals) | said(account, folder))


def wanted_signals(source: SourceParams) -> Signals:
    """Return what `source` asks for, at the rate that it or its dataset names.

    Raises:
        ParamsError: as in `signals_of`.
        TableError: the dataset does not say its rate, or another one than `source`.
    """
    return signals_of(source, read_info(source).fps if isinstance(source, LerobotSource) else None)


def _one_by_one(source: SourceParams) -> bool:
    """Whether no file is looked at before it is read: no episode goes on in the next one, and no time orders them."""
    ordered = isinstance(source, TableSource) and source.clock is not None and source.clock.column is not None
    return isinstance(getattr(source, "episode", None), EpisodePerFile) and not ordered


def _remote(source: SourceParams, folder: Path) -> list[Remote]:
    patterns = source.files if isinstance(source, McapSource | TableSource) else ()
    return [each for pattern in patterns if is_url(pattern) for each in find_remote(pattern, folder)]


def _processes(source: SourceParams, units: Sequence[Unit], remote: Mapping[Path, Remote], cores: int) -> int:
    files = {file for unit in units for file in unit}
    # A file that has gone meanwhile is told by who reads it.
    size = sum(file.stat().st_size for file in files - remote.keys() if file.exists())
    size += sum(each.size for each in remote.values())
    worthwhile = size // (WORKER_BYTES if isinstance(source, McapSource) else WORKER_TABLE_BYTES)
    return max(1, min(cores, len(units), worthwhile))


def _in_order(
    jobs: Sequence[_Job], ordered_map: OrderedMap | None, progress: Callable[[int], object]
) -> Iterator[_Imported]:
    """Do the jobs, with a map several at once, and yield what comes of doing one after the other."""
    agreement = Agreement()
    alone = 1 if ordered_map else len(jobs)
    for job in jobs[:alone]:
        yield from _import(job, agreement, progress)
    if not ordered_map:
        return
    given = agreement.copy()
    for job, attempt in zip(jobs[alone:], ordered_map(partial(_attempt, given), jobs[alone:]), strict=True):
        if not agreement.learn(attempt.after, given):
            shutil.rmtree(_place(job), ignore_errors=True)
            yield from _import(job, agreement, progress)
            continue
        if attempt.failure:
            raise attempt.failure.exception()
        for path in sorted(_place(job).iterdir()):
            path.replace(job.folder / path.name)
        _place(job).rmdir()
        progress(attempt.transitions)
        yield from attempt.recordings


def _attempt(given: Agreement, job: _Job) -> _Attempt:
    """Do a job by what the first one has shown, into a folder of its own, which appears when it is done."""
    agreement = given.copy()
    try:
        with atomic_path(_place(job)) as folder:
            folder.mkdir()
            recordings = tuple(_import(replace(job, folder=folder), agreement, lambda _: None))
    except AddressedDynamicsError as error:
        return _Attempt(agreement, (), Failure.of(error))
    return _Attempt(agreement, recordings)


def _place(job: _Job) -> Path:
    return job.folder / f"{job.first:04d}"


def _import(job: _Job, agreement: Agreement, progress: Callable[[int], object]) -> Iterator[_Imported]:
    with copied(job.remote) as copies:
        yield from _import_unit(job, agreement, progress, copies)


def _import_unit(
    job: _Job, agreement: Agreement, progress: Callable[[int], object], copies: dict[str, dict[str, Any]]
) -> Iterator[_Imported]:
    signals = wanted_signals(job.source)
    for number, (origin, recorded) in enumerate(read_unit(job.source, job.unit, signals, agreement), job.first):
        episodes = find_episodes(recorded, job.source.min_length)
        outside = out_of_range(recorded, signals.spec)
        lost = lost_steps(recorded, signals)
        log = job.folder / f"{number:04d}-{Path(origin).stem}.mcap"
        if episodes.slices:
            transitions = transition_blocks(recorded, episodes, signals, number * EPISODES_PER_FILE)
            write_log(log, _reported(transitions, progress), run=job.run, topic=f"/{SEGMENT}")
        counts = recorded.counts | _counts(episodes, sum(outside.values()))
        details = recorded.details | {"out_of_range": outside, "log": log.name if episodes.slices else None}
        yield _Imported(origin, counts, details, lost, copies)


def _reported(blocks: Iterable[Transitions], progress: Callable[[int], object]) -> Iterator[Transitions]:
    for block in blocks:
        yield block
        progress(len(block))


def _counts(episodes: Episodes, outside: int) -> dict[str, int]:
    lengths = [each.stop - each.start for each in episodes.slices]
    return {
        "samples": sum(lengths) + episodes.short_samples,
        "out_of_range": outside,
        "episodes": len(lengths),
        "short": episodes.short,
        "dropped": episodes.short_samples,
        "transitions": sum(lengths) - len(lengths),
    }


def _settings(source: SourceParams, signals: Signals) -> dict[str, Any]:
    settings = {"kind": source.kind, "rate_hz": _rate_hz(source, signals), "min_length": source.min_length}
    every = {each.name: signals.all[each.column].offset for each in dimension_columns(signals.spec)}
    offsets = {name: offset for name, offset in every.items() if offset}
    settings |= {"tolerance_s": source.tolerance_s} if isinstance(source, McapSource) else {}
    return settings | ({"offsets": offsets} if offsets else {})


def _rate_hz(source: SourceParams, signals: Signals) -> float:
    # The inverse of the step may differ from what was written by rounding.
    return source.rate_hz or float(f"{1.0 / signals.spec.step_seconds:.12g}")


def _no_episodes(
    source: SourceParams, rate_hz: float, totals: dict[str, int], details: dict[str, dict[str, Any]]
) -> str:
    match source:
        case MinariSource():
            where = source.dataset
        case LerobotSource():
            where = source.folder
        case _:
            where = ", ".join(source.files)
    found = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in totals.items())
    advice = "lower min_length, raise the tolerance, or see why samples are dropped"
    if not isinstance(source, McapSource):
        advice = "lower min_length, or see why rows are dropped or do not follow each other"
    measured = next((each["measured_hz"] for each in details.values() if "measured_hz" in each), None)
    if measured is not None and totals.get("off_rate"):
        advice = f"the rows come at {measured:g} Hz, but rate_hz is {rate_hz:g}; correct it, or {advice}"
    return f"{where}: expected episodes of at least {source.min_length} samples, but there is none ({found}); {advice}"
