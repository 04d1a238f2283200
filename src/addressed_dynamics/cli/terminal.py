"""What `addressed-dynamics inspect` shows in a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from addressed_dynamics.cli.inspection import FileInspection, Inspection, Topic
from addressed_dynamics.episodes.experience import Experience, Spread

MISSING = "-"
_WALL_CLOCK_NS = 10**18
"""Times from here on (the year 2001) are dates; earlier ones are seconds since the start of a simulation."""


def file_view(file: FileInspection) -> RenderableType:
    """Return all that is known of one file."""
    return Group(*_file_parts(file))


def folder_view(inspection: Inspection, paths: Sequence[Path]) -> RenderableType:
    """Return a line for each file in these folders, and what all of them hold together."""
    table = column_table("File", size=True, messages=True, duration=True, transitions=True, episodes=True, state=False)
    parts: list[RenderableType] = [safe_text(", ".join(map(str, paths)), style="bold"), table]
    for file in inspection.files:
        inside = len(paths) == 1 and file.path.is_relative_to(paths[0])
        name = file.path.relative_to(paths[0]) if inside else file.path
        table.add_row(*map(safe_text, (name, *_summary(file))), style="red" if file.problem else "")
        if file.problem:
            parts.append(_line(f"{name}: {file.problem.message}"))
    totals = {
        "Files": f"{len(inspection.files):,}, {inspection.damaged:,} of them with a problem",
        "Size": _size(inspection.size),
        "Messages": f"{inspection.messages:,}",
    }
    if inspection.experience:
        totals |= _experience_facts(inspection.experience)
        parts += [fact_grid(totals), _range_table(inspection.experience)]
    else:
        parts.append(fact_grid(totals))
    return Group(*parts)


def _file_parts(file: FileInspection) -> Iterator[RenderableType]:
    yield safe_text(file.path, style="bold")
    facts = {"Size": _size(file.size), "Library": file.library, "Profile": file.profile}
    facts["Chunks"] = ", ".join(f"{count:,} {name}" for name, count in file.compression.items())
    if file.start_ns is not None and file.end_ns is not None:
        facts["Time"] = f"{_time(file.start_ns)} to {_time(file.end_ns)} ({_seconds(_duration(file))})"
    if file.run:
        facts["Environment"] = f"{file.run.environment} {dict(file.run.kwargs) or ''}".rstrip()
        facts["Recorded"] = ", ".join(filter(None, [file.run.segment, file.run.behaviour, file.run.started]))
        facts["Seed"] = "" if file.run.seed is None else str(file.run.seed)
        facts["Versions"] = ", ".join(f"{name} {version}" for name, version in file.run.versions.items())
        facts["Git commit"] = file.run.git_commit
    if file.experience:
        facts |= _experience_facts(file.experience)
    yield fact_grid(facts)
    if file.topics:
        yield _topic_table(file.topics)
    if file.experience and file.experience.ranges:
        yield _range_table(file.experience)
    if file.problem:
        yield _line(f"Problem: {file.problem.message}")


def column_table(first: str, **numeric: bool) -> Table:
    """Return an empty table: its first column, and the others with whether they hold numbers."""
    table = Table(box=box.SIMPLE_HEAD, header_style="dim", pad_edge=False)
    table.add_column(first, overflow="fold", no_wrap=True)
    for name, is_number in numeric.items():
        title = name.replace("_", " ")
        table.add_column(title, justify="right" if is_number else "left", overflow="fold", no_wrap=is_number)
    return table


def fact_grid(facts: dict[str, str]) -> Table:
    """Return a line for each fact that is not empty."""
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in facts.items():
        if value:
            table.add_row(name, safe_text(value))
    return table


def _topic_table(topics: tuple[Topic, ...]) -> Table:
    table = column_table("Topic", schema=False, encoding=False, messages=True, rate=True, longest_gap=True)
    for topic in topics:
        rate = MISSING if topic.rate_hz is None else f"{topic.rate_hz:.4g} Hz"
        cells = (topic.schema or MISSING, topic.encoding or MISSING, f"{topic.messages:,}", rate)
        table.add_row(*map(safe_text, (topic.name, *cells, _seconds(topic.longest_gap_seconds))))
    return table


def _range_table(experience: Experience) -> Table:
    table = column_table("Dimension", lowest=True, highest=True, unit=False)
    for name, (low, high) in experience.ranges.items():
        table.add_row(*map(safe_text, (name, f"{low:.6g}", f"{high:.6g}", experience.units.get(name, ""))))
    return table


def _experience_facts(experience: Experience) -> dict[str, str]:
    facts = {
        "Transitions": f"{experience.transitions:,}, one every {experience.spec.step_seconds:.4g} s",
        "Episodes": f"{len(experience.lengths):,} ("
        + ", ".join(f"{count:,} {how}" for how, count in sorted(experience.ended.items()))
        + ")",
        "Lengths": _spread(Spread.of(experience.lengths)),
        "Returns": _spread(Spread.of(experience.returns)),
    }
    missing = []
    if experience.late_starts:
        missing.append(f"episodes without their first steps: {experience.late_starts:,}")
    if experience.gaps:
        missing.append(f"gaps in time inside episodes: {experience.gaps:,}")
    return facts | {"Steps": "; ".join(missing) or "without gaps"}


def _spread(spread: Spread | None) -> str:
    if spread is None:
        return ""
    return f"{spread.low:.6g} to {spread.high:.6g}, median {spread.median:.6g}"


def _summary(file: FileInspection) -> tuple[str, ...]:
    experience = file.experience
    learning = (f"{experience.transitions:,}", f"{len(experience.lengths):,}") if experience else (MISSING, MISSING)
    state = "damaged" if file.problem else "whole"
    return _size(file.size), f"{file.messages:,}", _seconds(_duration(file)), *learning, state


def safe_text(value: object, style: str = "") -> Text:
    """Return a text in which nothing is a command to the terminal."""
    # Names in foreign files may hold anything, commands to the terminal included.
    return Text("".join(each if each.isprintable() else "?" for each in str(value)), style=style)


def _line(problem: str) -> Text:
    # Left to the terminal to wrap, so that the command in it can be copied.
    line = safe_text(problem, style="red")
    line.no_wrap, line.overflow = True, "ignore"
    return line


def _duration(file: FileInspection) -> float | None:
    return None if file.start_ns is None or file.end_ns is None else (file.end_ns - file.start_ns) / 1e9


def _size(size: int) -> str:
    value, unit = float(size), "B"
    for larger in ("KiB", "MiB", "GiB", "TiB"):
        if value < 1024:
            break
        value, unit = value / 1024, larger
    return f"{value:.4g} {unit}" if unit != "B" else f"{size} B"


def _seconds(seconds: float | None) -> str:
    return MISSING if seconds is None else f"{seconds:,.6g} s"


def _time(time_ns: int) -> str:
    if time_ns < _WALL_CLOCK_NS:
        return f"{time_ns / 1e9:.6g} s"
    try:
        return datetime.fromtimestamp(time_ns / 1e9, tz=UTC).isoformat(timespec="milliseconds")
    except (OverflowError, ValueError, OSError):
        return f"{time_ns / 1e9:.6g} s"
