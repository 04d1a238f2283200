"""What `inspect` and `new` show of logs that are to be imported."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from rich.console import Group, RenderableType

from addressed_dynamics.cli.terminal import MISSING, column_table, fact_grid, safe_text
from addressed_dynamics.importing.assessing import Assessment
from addressed_dynamics.importing.looking import MOST_TEXTS, Field, Look
from addressed_dynamics.importing.proposing import Proposal

EPISODES_SHOWN = 30
"""Episodes that are shown; those to be used are left out first."""


def look_view(look: Look) -> RenderableType:
    """Return a line for each field that can be imported."""
    fields = column_table("Field", values=True, rate=True, lowest=True, highest=True, unit=False)
    for each in look.fields:
        fields.add_row(*map(safe_text, _field_cells(each)))
    parts: list[RenderableType] = [fields]
    if look.looked_at is not None:
        parts.append(safe_text(f"These are of the first {look.looked_at} files or episodes alone.", style="yellow"))
    parts += [safe_text(f"Topic {topic} cannot be read: {why}", style="red") for topic, why in look.unread.items()]
    if look.stamps:
        stamps = column_table("Own time of messages", logged_after_it=True, within=True)
        for stamp in look.stamps:
            stamps.add_row(*map(safe_text, (stamp.topic, f"{stamp.median_s:,.4g} s", f"{stamp.spread_s:,.4g} s")))
        parts.append(stamps)
    return Group(*parts)


def proposal_view(proposal: Proposal) -> RenderableType:
    """Return what would be imported, what of it was guessed and what is missing."""
    lines = [safe_text(f"Guessed {line}") for line in proposal.guessed]
    missing = " and ".join(f"--{name}" for name in proposal.unknown)
    return Group(*lines, *([safe_text(f"To be said: {missing}", style="yellow")] if missing else []))


def assessment_view(assessment: Assessment) -> RenderableType:
    """Return the verdict on each episode, what the actions do, and how much is noise."""
    return Group(*_assessment_parts(assessment))


def _assessment_parts(assessment: Assessment) -> Iterator[RenderableType]:
    verdicts = Counter(each.verdict for each in assessment.episodes)
    found = ", ".join(f"{verdicts[each]:,} to {each}" for each in ("use", "look", "leave") if verdicts[each])
    words = {name.replace("_", " "): count for name, count in assessment.counts.items() if count}
    yield fact_grid(
        {
            "Episodes": f"{len(assessment.episodes):,}" + (f": {found}" if found else ""),
            "Transitions": f"{assessment.transitions:,}",
            "Counted": ", ".join(f"{count:,} {name}" for name, count in words.items()),
        }
    )
    yield from (safe_text(f"Warning: {warning}", style="yellow") for warning in assessment.warnings)
    unusual = [each for each in assessment.episodes if each.verdict != "use"]
    shown = sorted([*unusual, *(each for each in assessment.episodes if each.verdict == "use")][:EPISODES_SHOWN],
                   key=lambda each: (each.file, each.number))  # fmt: skip
    episodes = column_table("Episode", begins=True, lasts=True, samples=True, verdict=False, reason=False)
    for each in shown:
        cells = (f"{each.file}#{each.number}", f"{each.start_s:,.2f} s", f"{each.seconds:,.2f} s", f"{each.samples:,}")
        episodes.add_row(*map(safe_text, (*cells, each.verdict, "; ".join(each.reasons) or MISSING)))
    if shown:
        yield episodes
    if len(shown) < len(assessment.episodes):
        yield safe_text(f"and {len(assessment.episodes) - len(shown):,} more")
    if assessment.excitations:
        yield _action_table(assessment)
    if assessment.noises:
        noises = column_table("State", noise=True, of_its_change=True)
        for noise in assessment.noises:
            noises.add_row(*map(safe_text, (noise.name, f"{noise.deviation:.3g}", f"{noise.share:.1%}")))
        yield noises


def _action_table(assessment: Assessment) -> RenderableType:
    delays = {each.action: each for each in assessment.delays}
    actions = column_table("Action", lowest=True, highest=True, changes=True, covered=True, moves=False, after=True)
    for each in assessment.excitations:
        delay = delays.get(each.name)
        moves, after = ("nothing found", MISSING) if delay is None else (delay.state, f"{delay.seconds:.3g} s")
        moved = f"{each.changing:.1%} of steps", f"{each.covered:.0%} of its range"
        actions.add_row(*map(safe_text, (each.name, f"{each.low:.4g}", f"{each.high:.4g}", *moved, moves, after)))
    return actions


def _field_cells(each: Field) -> tuple[str, ...]:
    rate = MISSING if each.rate_hz is None else f"{each.rate_hz:.4g} Hz"
    if each.texts:
        more = ", …" if len(each.texts) > MOST_TEXTS else ""
        texts = ", ".join(sorted(each.texts)[:MOST_TEXTS]) + more
        return each.field, f"{each.total:,}", rate, "text:", texts, ""
    low, high = (MISSING, MISSING) if each.range is None else map("{:.6g}".format, each.range)
    return each.field, f"{each.total:,}", rate, low, high, each.unit
