"""From MCAP logs to Parquet tables with splits, statistics and a data report.

The logs are read twice, each time one per process: first for their episodes, because the split of a short segment
depends on all of its episodes; then to be written. Reading costs little, and no process ever holds two logs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt64

from addressed_dynamics.errors import LogError, TableError
from addressed_dynamics.files import atomic_path, write_json
from addressed_dynamics.logs import EpisodeRecord, read_log
from addressed_dynamics.params import ConvertParams
from addressed_dynamics.processes import OrderedMap, worker_processes
from addressed_dynamics.tables import SPLITS, Split, TransitionTable, assign_splits, write_table
from addressed_dynamics.tables.coverage import Occupancy, count_duplicates, row_fingerprints
from addressed_dynamics.tables.episodes import Episode, write_episodes
from addressed_dynamics.tables.statistics import Moments, column_names, column_values, moments_to_json
from addressed_dynamics.tables.summary import data_report, split_sizes, write_learner_curve
from addressed_dynamics.transitions import SpaceSpec

LEARNER = "dqn"
"""The behaviour whose episodes make the learning curve."""
WORKER_BYTES = 8 * 2**20
"""A worker process for every so many bytes of logs: to start one takes as long as to convert about half of them."""


@dataclass(frozen=True)
class _LogSummary:
    """What the first reading of a log finds."""

    log: Path
    segment: str
    behaviour: str
    spec: SpaceSpec
    episodes: tuple[EpisodeRecord, ...]
    ranges: Moments
    """Range of the observations, those after a step included."""


@dataclass(frozen=True)
class _Job:
    """One log to convert."""

    log: Path
    target: Path
    splits: dict[int, Split]
    """The split of each episode in the log."""
    segment: str
    low: Float64[np.ndarray, " dimension"]
    high: Float64[np.ndarray, " dimension"]
    row_group_rows: int


@dataclass(frozen=True)
class _Figures:
    """What the second reading adds to the statistics and the data report."""

    columns: list[str]
    train: Moments
    occupancy: Occupancy
    fingerprints: UInt64[np.ndarray, " step"]
    """Eight bytes per transition, so that duplicates are found across logs."""


def convert_recording(
    recording: Path,
    tables: Path,
    reports: Path,
    params: ConvertParams,
    *,
    cores: int,
    progress: Callable[[int], object],
) -> None:
    """Convert the logs in the folder `recording`; the same logs give the same bytes.

    Args:
        recording: folder of logs.
        tables: folder for `transitions/*.parquet`, `episodes.parquet` and `statistics.json`; replaced whole, at the
            end.
        reports: folder for `data.json` and `learner.csv`.
        params: shares of the splits, and the size of row groups.
        cores: the most logs to work on at once.
        progress: called with the number of transitions written since its last call.

    Raises:
        LogError: there are no logs, or one is damaged.
        TableError: a table cannot be written, or no episode is left to train on.
    """
    logs = _logs(recording)
    with atomic_path(tables) as folder, worker_processes(_processes(logs, cores)) as ordered_map:
        summaries = _summaries(recording, logs, ordered_map)
        episodes = _episodes(summaries, params)
        ranges = reduce(Moments.merge, [summary.ranges for summary in summaries])
        jobs = _jobs(summaries, episodes, ranges, folder, params.row_group_rows)
        figures = []
        for found in ordered_map(_convert, jobs):
            figures.append(found)
            progress(len(found.fingerprints))
        write_episodes(folder / "episodes.parquet", episodes)
        write_json(folder / "statistics.json", _statistics(episodes, figures, recording))
        _write_report(reports, summaries, episodes, ranges, figures)


def _logs(recording: Path) -> list[Path]:
    logs = sorted(recording.glob("*.mcap"))
    if not logs:
        message = f"{recording}: expected MCAP logs (*.mcap), but there are none; run the record stage first"
        raise LogError(message)
    return logs


def _processes(logs: Sequence[Path], cores: int) -> int:
    worthwhile = sum(log.stat().st_size for log in logs) // WORKER_BYTES
    return max(1, min(cores, len(logs), worthwhile))


def _summaries(recording: Path, logs: Sequence[Path], ordered_map: OrderedMap) -> list[_LogSummary]:
    summaries = [each for each in ordered_map(_summarise, logs) if each.episodes]
    if not summaries:
        message = f"{recording}: expected transitions, but all {len(logs)} logs are empty; run the record stage again"
        raise LogError(message)
    owners: dict[int, Path] = {}
    for summary in summaries:
        if summary.spec != summaries[0].spec:
            message = (
                f"{summary.log}: its spaces differ from those of {summaries[0].log.name}; "
                "keep one environment per experiment"
            )
            raise LogError(message)
        for episode in summary.episodes:
            other = owners.setdefault(episode.episode, summary.log)
            if other != summary.log:
                message = f"{summary.log}: episode {episode.episode} is also in {other.name}; keep recordings apart"
                raise LogError(message)
    return summaries


def _summarise(log: Path) -> _LogSummary:
    contents = read_log(log)
    transitions = contents.transitions
    return _LogSummary(
        log=log,
        segment=contents.run.segment or log.stem,
        behaviour=contents.run.behaviour,
        spec=transitions.spec,
        episodes=contents.episodes if len(transitions) else (),
        ranges=Moments.of(transitions.observation).merge(Moments.of(transitions.next_observation)),
    )


def _episodes(summaries: Sequence[_LogSummary], params: ConvertParams) -> list[Episode]:
    """Split the episodes of each segment by itself, so that each has its share of test episodes."""
    by_segment: dict[str, list[EpisodeRecord]] = {}
    for summary in summaries:
        by_segment.setdefault(summary.segment, []).extend(summary.episodes)
    episodes = []
    for segment, records in by_segment.items():
        splits = assign_splits(
            [record.episode for record in records],
            seed=params.split_seed,
            validation_share=params.validation_share,
            test_share=params.test_share,
        )
        episodes += [_episode(record, segment, split) for record, split in zip(records, splits, strict=True)]
    return episodes


def _episode(record: EpisodeRecord, segment: str, split: Split) -> Episode:
    return Episode(
        episode=record.episode,
        segment=segment,
        split=split,
        seed=record.seed,
        length=record.length,
        total_reward=record.episode_return,
        ended=record.ended,
        end_time_ns=record.end_time_ns,
    )


def _jobs(
    summaries: Sequence[_LogSummary], episodes: Sequence[Episode], ranges: Moments, folder: Path, row_group_rows: int
) -> list[_Job]:
    splits = {episode.episode: episode.split for episode in episodes}
    dimensions = summaries[0].spec.observation
    low = np.array([dimension.low for dimension in dimensions])
    high = np.array([dimension.high for dimension in dimensions])
    return [
        _Job(
            log=summary.log,
            target=folder / "transitions" / f"{summary.log.stem}.parquet",
            splits={record.episode: splits[record.episode] for record in summary.episodes},
            segment=summary.segment,
            low=np.where(np.isfinite(low), low, ranges.minimum),
            high=np.where(np.isfinite(high), high, ranges.maximum),
            row_group_rows=row_group_rows,
        )
        for summary in summaries
    ]


def _convert(job: _Job) -> _Figures:
    transitions = read_log(job.log).transitions
    identifiers, inverse = np.unique(transitions.episode, return_inverse=True)
    try:
        codes = [SPLITS.index(job.splits[int(identifier)]) for identifier in identifiers]
    except KeyError as error:
        message = f"{job.log}: episode {error} has transitions but no record of its end; run the record stage again"
        raise LogError(message) from error
    table = TransitionTable(transitions, np.array(codes, dtype=np.int8)[inverse], job.segment)
    write_table(job.target, table, row_group_rows=job.row_group_rows)
    states = Occupancy.of(transitions.observation, job.low, job.high)
    return _Figures(
        columns=column_names(transitions),
        train=Moments.of(column_values(table.only("train"))),
        occupancy=states.merge(Occupancy.of(transitions.next_observation, job.low, job.high)),
        fingerprints=row_fingerprints(transitions.observation, transitions.action),
    )


def _statistics(episodes: Sequence[Episode], figures: Sequence[_Figures], recording: Path) -> dict[str, Any]:
    train = reduce(Moments.merge, [each.train for each in figures])
    if not train.count:
        message = f"{recording}: none of its {len(episodes)} episodes is left to train on; record more episodes"
        raise TableError(message)
    return {"splits": split_sizes(episodes), "train": moments_to_json(figures[0].columns, train)}


def _write_report(
    reports: Path,
    summaries: Sequence[_LogSummary],
    episodes: Sequence[Episode],
    ranges: Moments,
    figures: Sequence[_Figures],
) -> None:
    behaviours = {summary.segment: summary.behaviour for summary in summaries}
    report = data_report(
        summaries[0].spec,
        episodes,
        behaviours,
        ranges=[(float(low), float(high)) for low, high in zip(ranges.minimum, ranges.maximum, strict=True)],
        occupancy=reduce(Occupancy.merge, [each.occupancy for each in figures]),
        duplicates=count_duplicates(np.concatenate([each.fingerprints for each in figures])),
    )
    write_json(reports / "data.json", report)
    learner = [episode for episode in episodes if behaviours[episode.segment] == LEARNER]
    write_learner_curve(reports / "learner.csv", learner, step_seconds=summaries[0].spec.step_seconds)
