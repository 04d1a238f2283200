"""Import what somebody else recorded: one of our logs for each of their files, and an account of what was done."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from addressed_dynamics.base.errors import LogError, ParamsError
from addressed_dynamics.base.files import write_json
from addressed_dynamics.base.params.source import (
    EpisodeByGap,
    EpisodePerFile,
    LerobotSource,
    McapSource,
    MinariSource,
    SourceParams,
    TableSource,
)
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.lerobot import read_info, read_lerobot
from addressed_dynamics.importing.mcap_logs import read_mcap
from addressed_dynamics.importing.minari_data import read_minari
from addressed_dynamics.importing.paths import parse_path
from addressed_dynamics.importing.precision import Precision
from addressed_dynamics.importing.recordings import Recording, recordings
from addressed_dynamics.importing.ros_bags import bag_files, is_bag, whole_bags
from addressed_dynamics.importing.samples import (
    EPISODES_PER_FILE,
    Episodes,
    Recorded,
    dimension_columns,
    find_episodes,
    out_of_range,
    transition_blocks,
    with_ends,
    without_offsets,
)
from addressed_dynamics.importing.signals import Signals, signals_of
from addressed_dynamics.importing.tables import natural_order, read_tables
from addressed_dynamics.logs import RunInfo, write_log

ACCOUNT = "import.json"
"""Name of the file that says what was read, dropped, late and held."""
SEGMENT = "imported"
"""The name that all imported logs have where recordings have the segment of their plan."""


def import_logs(source: SourceParams, folder: Path, *, name: str, progress: Callable[[int], object]) -> None:
    """Import `source` into `folder`; the same files make the same bytes.

    Args:
        source: which files, and which of their fields make a transition.
        folder: where the logs go, one for each file, and `import.json`.
        name: what is imported, for the people who find the logs.
        progress: called with the number of transitions written since its last call.

    Raises:
        ParamsError: `source` has a malformed path or slice, or says something of a topic that no field is of.
        SpaceError: a dimension has a name that a log cannot hold.
        LogError: there are no files, one is damaged or lacks what `source` names, they do not agree, or there is no
            episode in them.
        TableError: the same of a table; or float32 swallows most steps of a dimension.
    """
    signals = wanted_signals(source)
    precision = Precision(signals)
    run = RunInfo(
        environment=name,
        segment=SEGMENT,
        behaviour=source.kind,
        versions={"addressed-dynamics": importlib.metadata.version("addressed-dynamics")},
    )
    counts: dict[str, dict[str, int]] = {}
    details: dict[str, dict[str, Any]] = {}
    for index, (origin, recorded) in enumerate(read_samples(source, signals)):
        episodes = find_episodes(recorded, source.min_length)
        outside = out_of_range(recorded, signals.spec)
        lost = precision.look_at(recorded, origin)
        counts[origin] = recorded.counts | _counts(episodes, sum(outside.values()))
        details[origin] = recorded.details | {"out_of_range": outside, "log": None}
        if lost:
            counts[origin]["swallowed"] = sum(lost.values())
            details[origin]["swallowed"] = lost
        if episodes.slices:
            transitions = transition_blocks(recorded, episodes, signals, index * EPISODES_PER_FILE)
            log = folder / f"{index:04d}-{Path(origin).stem}.mcap"
            write_log(log, _reported(transitions, progress), run=run, topic=f"/{SEGMENT}")
            details[origin]["log"] = log.name
    names = dict.fromkeys(name for each in counts.values() for name in each)
    totals = {name: sum(each.get(name, 0) for each in counts.values()) for name in names}
    if not totals["episodes"]:
        message = _no_episodes(source, _rate_hz(source, signals), totals, details)
        raise LogError(message)
    precision.refuse_swallowed()
    write_json(folder / ACCOUNT, {**_settings(source, signals), "totals": totals, "files": counts, "details": details})


def wanted_signals(source: SourceParams) -> Signals:
    """Return what `source` asks for, at the rate that it or its dataset names.

    Raises:
        ParamsError: as in `signals_of`.
        TableError: the dataset does not say its rate, or another one than `source`.
    """
    return signals_of(source, read_info(source).fps if isinstance(source, LerobotSource) else None)


def read_samples(source: SourceParams, signals: Signals) -> Iterator[tuple[str, Recorded]]:
    """Yield the samples of each recording, under the name of its first file.

    Raises:
        ParamsError: as in `import_logs`.
        LogError: as in `import_logs`.
        TableError: as in `import_logs`.
    """
    for origin, recorded in _read(source, signals):
        yield origin, without_offsets(with_ends(recorded, signals), signals)


def _read(source: SourceParams, signals: Signals) -> Iterator[tuple[str, Recorded]]:
    agreement = Agreement()
    match source:
        case McapSource():
            paths = [parse_path(signal.field) for signal in signals.all]
            _check_topics(source, {path.topic for path in paths})
            for files in _recordings(source):
                yield files[0].as_posix(), read_mcap(files, source, signals, paths, agreement)
        case TableSource():
            for origin, samples in read_tables(_files(source.files), source, signals, agreement):
                yield origin, Recorded.of(samples)
        case LerobotSource():
            for origin, samples in read_lerobot(read_info(source), signals, agreement):
                yield origin, Recorded.of(samples)
        case MinariSource():
            yield source.dataset, Recorded.of(read_minari(source.dataset, signals, agreement))


def _reported(blocks: Iterator[Transitions], progress: Callable[[int], object]) -> Iterator[Transitions]:
    for block in blocks:
        yield block
        progress(len(block))


def _check_topics(source: McapSource, used: set[str]) -> None:
    unknown = sorted(source.topics.keys() - used)
    if unknown:
        message = (
            f"source.topics: '{unknown[0]}' is the topic of no field, so what is said of it would not count; the "
            f"topics of the fields are: {', '.join(sorted(used))}"
        )
        raise ParamsError(message)


def _recordings(source: McapSource) -> list[Recording]:
    found = whole_bags(_files(source.files, or_if=is_bag))
    whole = [bag_files(path) if is_bag(path) else (path,) for path in found]
    match source.episode:
        case EpisodePerFile():
            return whole
        case EpisodeByGap(seconds=seconds):
            return recordings(whole, round(seconds * 1e9))
        case _:
            return recordings(whole, round(source.tolerance_s * 1e9))


def _files(patterns: tuple[str, ...], or_if: Callable[[Path], bool] = Path.is_file) -> list[Path]:
    found: set[Path] = set()
    for pattern in patterns:
        root = Path(Path(pattern).anchor)
        matches = {file for file in root.glob(str(Path(pattern).relative_to(root))) if file.is_file() or or_if(file)}
        if not matches:
            message = f"no file matches '{pattern}' in {Path.cwd()}; correct the 'files' of the source"
            raise LogError(message)
        found |= matches
    return sorted(found, key=natural_order)


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
