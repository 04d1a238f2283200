"""Import what somebody else recorded: one of our logs for each of their files, and an account of what was done."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.base.files import write_json
from addressed_dynamics.base.params.source import (
    EpisodeByGap,
    EpisodePerFile,
    McapSource,
    MinariSource,
    SourceParams,
    TableSource,
)
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.columns import read_table_file
from addressed_dynamics.importing.mcap_logs import read_mcap
from addressed_dynamics.importing.minari_data import read_minari
from addressed_dynamics.importing.paths import parse_path
from addressed_dynamics.importing.recordings import Recording, recordings
from addressed_dynamics.importing.samples import (
    EPISODES_PER_FILE,
    Episodes,
    Samples,
    find_episodes,
    make_transitions,
    out_of_range,
)
from addressed_dynamics.importing.signals import Signals, signals_of
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
        ParamsError: `source` has a malformed path or slice.
        SpaceError: a dimension has a name that a log cannot hold.
        LogError: there are no files, one is damaged or lacks what `source` names, they do not agree, or there is no
            episode in them.
        TableError: the same of a table.
    """
    signals = signals_of(source)
    run = RunInfo(
        environment=name,
        segment=SEGMENT,
        behaviour=source.kind,
        versions={"addressed-dynamics": importlib.metadata.version("addressed-dynamics")},
    )
    counts: dict[str, dict[str, int]] = {}
    details: dict[str, dict[str, Any]] = {}
    for index, (origin, samples) in enumerate(read_samples(source, signals)):
        episodes = find_episodes(samples.follows, source.min_length)
        outside = out_of_range(samples.values, signals.spec)
        counts[origin] = samples.counts | _counts(samples, episodes, sum(outside.values()))
        details[origin] = samples.details | {"out_of_range": outside, "log": None}
        if episodes.slices:
            transitions = make_transitions(samples, episodes, signals, index * EPISODES_PER_FILE)
            log = folder / f"{index:04d}-{Path(origin).stem}.mcap"
            write_log(log, transitions, run=run, topic=f"/{SEGMENT}")
            details[origin]["log"] = log.name
            progress(len(transitions))
    totals = {name: sum(each[name] for each in counts.values()) for name in next(iter(counts.values()))}
    if not totals["episodes"]:
        message = _no_episodes(source, totals)
        raise LogError(message)
    write_json(folder / ACCOUNT, {**_settings(source), "totals": totals, "files": counts, "details": details})


def read_samples(source: SourceParams, signals: Signals) -> Iterator[tuple[str, Samples]]:
    """Yield the samples of each recording, under the name of its first file.

    Raises:
        ParamsError: as in `import_logs`.
        LogError: as in `import_logs`.
        TableError: as in `import_logs`.
    """
    agreement = Agreement()
    match source:
        case McapSource():
            paths = [parse_path(signal.field) for signal in signals.all]
            for files in _recordings(source):
                yield files[0].as_posix(), read_mcap(files, source, signals, paths, agreement)
        case TableSource():
            for file in _files(source.files):
                yield file.as_posix(), read_table_file(file, source.kind, signals, agreement)
        case MinariSource():
            yield source.dataset, read_minari(source.dataset, signals, agreement)


def _recordings(source: McapSource) -> list[Recording]:
    files = _files(source.files)
    match source.episode:
        case EpisodePerFile():
            return [(file,) for file in files]
        case EpisodeByGap(seconds=seconds):
            return recordings(files, round(seconds * 1e9))
        case _:
            return recordings(files, round(source.tolerance_s * 1e9))


def _files(patterns: tuple[str, ...]) -> list[Path]:
    found: set[Path] = set()
    for pattern in patterns:
        root = Path(Path(pattern).anchor)
        matches = {file for file in root.glob(str(Path(pattern).relative_to(root))) if file.is_file()}
        if not matches:
            message = f"no file matches '{pattern}' in {Path.cwd()}; correct the 'files' of the source"
            raise LogError(message)
        found |= matches
    return sorted(found)


def _counts(samples: Samples, episodes: Episodes, outside: int) -> dict[str, int]:
    lengths = [each.stop - each.start for each in episodes.slices]
    return {
        "samples": len(samples.follows),
        "out_of_range": outside,
        "episodes": len(lengths),
        "short": episodes.short,
        "dropped": episodes.short_samples,
        "transitions": sum(lengths) - len(lengths),
    }


def _settings(source: SourceParams) -> dict[str, Any]:
    settings = {"kind": source.kind, "rate_hz": source.rate_hz, "min_length": source.min_length}
    return {**settings, "tolerance_s": source.tolerance_s} if isinstance(source, McapSource) else settings


def _no_episodes(source: SourceParams, totals: dict[str, int]) -> str:
    where = source.dataset if isinstance(source, MinariSource) else ", ".join(source.files)
    found = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in totals.items())
    return (
        f"{where}: expected episodes of at least {source.min_length} samples, but there is none ({found}); "
        "lower min_length, raise the tolerance, or see why samples are dropped"
    )
