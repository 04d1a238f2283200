"""From MCAP logs to Parquet tables with splits, statistics and a data report.

The logs are read twice, each time one per process: first for their episodes, because the split of a short segment
depends on all of its episodes; then to be written. Reading costs little, and no process ever holds a whole large log.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.base.files import atomic_path, remove_partial, write_json
from addressed_dynamics.base.processes import OrderedMap, worker_processes
from addressed_dynamics.episodes.bounds import display_range
from addressed_dynamics.episodes.coverage import Occupancy
from addressed_dynamics.episodes.findings import Finding, find, findings_to_json, refuse_useless
from addressed_dynamics.episodes.fingerprints import Buckets, Duplicates, fingerprint_writer, row_fingerprints
from addressed_dynamics.episodes.imports import ImportRecord, read_import_record
from addressed_dynamics.episodes.index import Episode, write_episodes
from addressed_dynamics.episodes.parquet import FOLDER, TransitionTable, split_writer
from addressed_dynamics.episodes.quality import Fences, Place, Quality, Tally, outlier_fences, outlier_sample
from addressed_dynamics.episodes.splits import file_names
from addressed_dynamics.episodes.statistics import Moments, Sample, column_names, column_values, moments_to_json
from addressed_dynamics.episodes.summary import data_report, split_sizes, write_learner_curve
from addressed_dynamics.episodes.transitions import LEARNED, SpaceSpec, Transitions
from addressed_dynamics.logs import EpisodeRecord, LogContents, read_episodes
from addressed_dynamics.sources.transitions.numbering import NumberedLog, renumber, unique_numbers
from addressed_dynamics.sources.transitions.params import ConvertParams
from addressed_dynamics.sources.transitions.pieces import Piece, Planned, block_figures, plan_pieces, take_pieces

FINGERPRINTS = "fingerprints"
"""Folder beside the tables, while they are made, of what finds rows that are equal across logs."""
LEARNER = "dqn"
"""The behaviour whose episodes make the learning curve."""
IMPORT_RECORD = "import.json"
"""What the import of foreign logs counted, beside the logs that it wrote."""
BLOCK_ROWS = 2**18
"""Transitions of a log that are in memory at once, up to the end of an episode."""
WORKER_BYTES = 8 * 2**20
"""A worker process for every so many bytes of logs: to start one takes as long as to convert about half of them."""


@dataclass(frozen=True)
class _LogSummary:
    """What the first reading of a log finds."""

    log: Path
    recording: str
    segment: str
    behaviour: str
    environment: str
    spec: SpaceSpec
    episodes: tuple[EpisodeRecord, ...]
    numbers: dict[int, int]
    """The identifiers of its episodes in the tables, by those in the log."""
    ranges: Moments
    """Range of the observations, those after a step included."""
    sample: Sample
    """Some of the observations, actions and exogenous inputs, to tell outliers by."""

    @staticmethod
    def join(blocks: Sequence[_LogSummary]) -> _LogSummary:
        """Add up what the blocks of one log hold, at least one."""
        return replace(
            blocks[0],
            episodes=tuple(episode for block in blocks for episode in block.episodes),
            numbers={own: number for block in blocks for own, number in block.numbers.items()},
            ranges=reduce(Moments.merge, [block.ranges for block in blocks]),
            sample=Sample.join([block.sample for block in blocks]),
        )


@dataclass(frozen=True)
class _Job:
    """One log to convert."""

    log: Path
    spec: SpaceSpec
    target: Path
    """Folder for the files of all splits, which are called like the log."""
    numbers: dict[int, int]
    """The identifiers of the log's episodes in the folder, by those in the log."""
    pieces: dict[int, tuple[Piece, ...]]
    """What becomes of each episode, by its identifier in the folder."""
    segment: str
    low: Float64[np.ndarray, " dimension"]
    high: Float64[np.ndarray, " dimension"]
    fences: Fences
    """Where outliers begin."""
    fingerprints: Path
    """Where the fingerprints of the log's rows go."""
    row_group_rows: int


@dataclass(frozen=True)
class _Figures:
    """What the second reading adds to the statistics and the data report."""

    rows: int
    columns: list[str]
    train: Moments
    occupancy: Occupancy
    quality: Quality
    blocks: list[Episode]
    """What the list of episodes says of blocks of episodes."""

    def merge(self, other: _Figures) -> _Figures:
        """Add the figures of a later block of the same log."""
        return replace(
            self,
            rows=self.rows + other.rows,
            train=self.train.merge(other.train),
            occupancy=self.occupancy.merge(other.occupancy),
            quality=self.quality.merge(other.quality),
            blocks=self.blocks + other.blocks,
        )


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

    The logs may be of different recordings, each with episodes from 0: see `numbering.unique_numbers`. The names of
    episodes do not depend on their numbers.

    Args:
        recording: folder of logs.
        tables: folder for `transitions/<split>/<log>.parquet`, `episodes.parquet` and `statistics.json`; replaced
            whole, at the end.
        reports: folder for `data.json` and `learner.csv`.
        params: how episodes are split, and the size of row groups.
        cores: the most logs to work on at once.
        progress: called with the number of transitions written since its last call.

    Raises:
        LogError: there are no logs, one is damaged, or holds predictions where `params` allows none, or they do not fit
            together: their spaces differ, two of one recording have the same episode, or one is a copy of another.
        TableError: a table cannot be written, a split would be empty, or something is wrong with the data that makes
            training on it useless.
    """
    logs = _logs(recording)
    with atomic_path(tables) as folder, worker_processes(_processes(logs, cores)) as ordered_map:
        summaries = _summaries(recording, logs, ordered_map)
        if not params.predictions:
            _refuse_predictions(summaries)
        imported = read_import_record(recording / IMPORT_RECORD)
        planned = plan_pieces(recording, _episodes(summaries, _log_names(summaries, imported)), params)
        ranges = reduce(Moments.merge, [summary.ranges for summary in summaries])
        jobs = _jobs(summaries, planned, ranges, folder, params.row_group_rows)
        buckets = Buckets(folder / FINGERPRINTS / "buckets", sum(each.whole.length for each in planned))
        figures = []
        for job, found in zip(jobs, ordered_map(_convert, jobs), strict=True):
            buckets.add_file(job.fingerprints)
            figures.append(found)
            progress(found.rows)
        duplicates = buckets.find()
        shutil.rmtree(folder / FINGERPRINTS)
        remove_partial(folder)
        episodes = _table_episodes(planned, figures)
        sizes = split_sizes(episodes)
        write_episodes(folder / "episodes.parquet", episodes)
        write_json(folder / "statistics.json", _statistics(sizes, figures))
        findings = _findings(summaries, figures, duplicates, imported)
        refuse_useless(recording, findings)
        recorded = [each.whole for each in planned]
        report = _report(summaries, recorded, sizes, ranges, figures, duplicates)
        if params.split == "blocks":
            report["blocks"] = block_figures(planned, params.gap_steps).to_json()
        report |= {"quality": findings_to_json(findings)} | ({"import": imported.to_json()} if imported else {})
        write_json(reports / "data.json", report)
        _write_learner(reports / "learner.csv", summaries, recorded)


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
    for summary in summaries:
        if summary.spec != summaries[0].spec:
            message = (
                f"{summary.log}: its spaces differ from those of {summaries[0].log.name}; "
                "keep one environment per experiment"
            )
            raise LogError(message)
    numbers = unique_numbers([NumberedLog(each.log, each.recording, tuple(each.numbers)) for each in summaries])
    return [_numbered(summary, own) for summary, own in zip(summaries, numbers, strict=True)]


def _refuse_predictions(summaries: Sequence[_LogSummary]) -> None:
    for summary in summaries:
        if summary.environment == LEARNED:
            message = (
                f"{summary.log}: it was recorded in a learned model ({LEARNED}), so it holds what a model predicted "
                "and nothing that happened; take it out of the folder, or say 'convert: {predictions: true}'"
            )
            raise LogError(message)


def _numbered(summary: _LogSummary, numbers: dict[int, int]) -> _LogSummary:
    episodes = tuple(replace(each, episode=numbers[each.episode]) for each in summary.episodes)
    return replace(summary, episodes=episodes, numbers=numbers)


def _summarise(log: Path) -> _LogSummary:
    return _LogSummary.join([_summary_of(log, block) for block in read_episodes(log, at_least=BLOCK_ROWS)])


def _summary_of(log: Path, block: LogContents) -> _LogSummary:
    transitions = block.transitions
    return _LogSummary(
        log=log,
        recording=block.recording,
        segment=block.run.segment or log.stem,
        behaviour=block.run.behaviour,
        environment=block.run.environment,
        spec=transitions.spec,
        episodes=block.episodes,
        numbers={each.episode: each.episode for each in block.episodes},
        ranges=Moments.of(transitions.observation).merge(Moments.of(transitions.next_observation)),
        sample=outlier_sample(transitions),
    )


def _log_names(summaries: Sequence[_LogSummary], imported: ImportRecord | None) -> list[str]:
    """Return a name for each log that does not depend on the others: an imported one is called like its origin.

    The logs of an import are numbered, so that one more file gives others new names.
    """
    origins = imported.origins if imported else {}
    return file_names([PurePath(origins.get(summary.log.name, summary.log.name)) for summary in summaries])


def _episodes(summaries: Sequence[_LogSummary], names: Sequence[str]) -> list[Episode]:
    """Return the episodes of all logs, which have no splits yet."""
    return [
        _episode(record, f"{name}#{number}", summary.segment)
        for summary, name in zip(summaries, names, strict=True)
        for number, record in enumerate(summary.episodes)
    ]


def _episode(record: EpisodeRecord, name: str, segment: str) -> Episode:
    return Episode(
        episode=record.episode,
        name=name,
        segment=segment,
        split=None,
        seed=record.seed,
        length=record.length,
        total_reward=record.episode_return,
        ended=record.ended,
        end_time_ns=record.end_time_ns,
    )


def _jobs(
    summaries: Sequence[_LogSummary], planned: Sequence[Planned], ranges: Moments, folder: Path, row_group_rows: int
) -> list[_Job]:
    pieces = {each.whole.episode: each.pieces for each in planned}
    low, high = display_range(summaries[0].spec.observation, ranges.minimum, ranges.maximum)
    fences = outlier_fences(summaries[0].spec, Sample.join([summary.sample for summary in summaries]))
    return [
        _Job(
            log=summary.log,
            spec=summary.spec,
            target=folder / FOLDER,
            numbers=summary.numbers,
            pieces={record.episode: pieces[record.episode] for record in summary.episodes},
            segment=summary.segment,
            low=low,
            high=high,
            fences=fences,
            fingerprints=folder / FINGERPRINTS / str(number),
            row_group_rows=row_group_rows,
        )
        for number, summary in enumerate(summaries)
    ]


def _convert(job: _Job) -> _Figures:
    spec, figures = job.spec, list[_Figures]()
    with (
        split_writer(job.target, f"{job.log.stem}.parquet", spec, row_group_rows=job.row_group_rows) as write,
        fingerprint_writer(job.fingerprints) as write_fingerprints,
    ):
        for block in read_episodes(job.log, at_least=BLOCK_ROWS):
            transitions = _numbered_block(job, block.transitions)
            kept, splits, blocks = take_pieces(transitions, job.pieces)
            table = TransitionTable(kept, splits, job.segment)
            write(table)
            write_fingerprints(row_fingerprints(transitions.observation, transitions.action, transitions.exogenous))
            figures.append(_figures_of(job, transitions, table, blocks))
    return reduce(_Figures.merge, figures)


def _numbered_block(job: _Job, transitions: Transitions) -> Transitions:
    """Return transitions of the log with the identifiers that its episodes have in the folder."""
    try:
        return renumber(transitions, job.numbers)
    except KeyError as error:
        message = f"{job.log}: episode {error} has transitions but no record of its end; run the record stage again"
        raise LogError(message) from error


def _figures_of(job: _Job, transitions: Transitions, table: TransitionTable, blocks: list[Episode]) -> _Figures:
    """Return the figures on all transitions, also those that the table leaves out; only `train` is of the table."""
    states = Occupancy.of(transitions.observation, job.low, job.high)
    return _Figures(
        rows=len(transitions),
        columns=column_names(transitions),
        train=Moments.of(column_values(table.only("train"))),
        occupancy=states.merge(Occupancy.of(transitions.next_observation, job.low, job.high)),
        quality=Quality.of(transitions, log=job.log.name, fences=job.fences),
        blocks=blocks,
    )


def _table_episodes(planned: Sequence[Planned], figures: Sequence[_Figures]) -> list[Episode]:
    """Return the episodes of the tables; of blocks as they were when their steps were read."""
    read = {block.episode: block for each in figures for block in each.blocks}
    pieces = [piece.episode for each in planned for piece in each.pieces]
    return [read.get(episode.episode, episode) for episode in pieces]


def _statistics(sizes: Mapping[str, Any], figures: Sequence[_Figures]) -> dict[str, Any]:
    train = reduce(Moments.merge, [each.train for each in figures])
    return {"splits": sizes, "train": moments_to_json(figures[0].columns, train)}


def _report(
    summaries: Sequence[_LogSummary],
    episodes: Sequence[Episode],
    sizes: Mapping[str, Mapping[str, int]],
    ranges: Moments,
    figures: Sequence[_Figures],
    duplicates: Duplicates,
) -> dict[str, Any]:
    spec, found = summaries[0].spec, reduce(Quality.merge, [each.quality for each in figures]).ranges
    return data_report(
        spec,
        episodes,
        {summary.segment: summary.behaviour for summary in summaries},
        splits=sizes,
        ranges=[(float(low), float(high)) for low, high in zip(ranges.minimum, ranges.maximum, strict=True)],
        occupancy=reduce(Occupancy.merge, [each.occupancy for each in figures]),
        duplicates=duplicates.count,
        exogenous=[found[f"exogenous.{dimension.name}"] for dimension in spec.exogenous],
    )


def _write_learner(path: Path, summaries: Sequence[_LogSummary], episodes: Sequence[Episode]) -> None:
    behaviours = {summary.segment: summary.behaviour for summary in summaries}
    learner = [episode for episode in episodes if behaviours[episode.segment] == LEARNER]
    write_learner_curve(path, learner, step_seconds=summaries[0].spec.step_seconds)


def _findings(
    summaries: Sequence[_LogSummary],
    figures: Sequence[_Figures],
    duplicates: Duplicates,
    imported: ImportRecord | None,
) -> list[Finding]:
    return find(
        reduce(Quality.merge, [each.quality for each in figures]),
        summaries[0].spec,
        duplicates=_placed(summaries, duplicates),
        occupancy=reduce(Occupancy.merge, [each.occupancy for each in figures]),
        imported=imported.files if imported else {},
        other_rates=imported.other_rates if imported else {},
    )


def _placed(summaries: Sequence[_LogSummary], duplicates: Duplicates) -> Tally:
    """Place the first row of all logs that is equal to an earlier one by the lengths of episodes."""
    place, row = None, -1 if duplicates.first is None else duplicates.first
    for summary in summaries:
        for episode in summary.episodes:
            if place is None and 0 <= row < episode.length:
                place = Place(summary.log.name, episode.episode)
            row -= episode.length
    return Tally(duplicates.count, duplicates.of, place)
