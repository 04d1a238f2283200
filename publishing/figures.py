"""The figures that the documents show: of a run, thinned into small files that are in Git."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.base.files import write_text
from addressed_dynamics.base.params.experiments import parse_params
from addressed_dynamics.evaluation.motion.records import Candidate, MotionEvaluation
from addressed_dynamics.evaluation.transitions.horizons import percent_of_range
from addressed_dynamics.evaluation.transitions.records import CandidateResult, Evaluation
from addressed_dynamics.evaluation.transitions.trust_records import TrustRecord
from addressed_dynamics.reporting.common.reading import Columns, columns_of, read_json, read_rows

Figures = dict[str, Any]
"""What a file holds: JSON-compatible."""
SCALES = {"params.yaml": "quick", "params/paper.yaml": "paper", "params/clips.yaml": "clips"}
"""Folder of the figures of a run, by its params file."""
CLIPS = "clips"
"""That of the few real clips, whose figures are in one file, lowest to highest over the seeds."""
KINDS = {
    "mountaincar": "transitions",
    "acrobot": "transitions",
    "pfnn": "motion",
    "pendulum": "transitions",
    "hopper": "transitions",
}
"""Experiments that the documents speak of, with their kinds of data."""
DIGITS = 4
"""Significant digits that are kept."""
SECONDS = (1.0, 10.0)
"""Times after which the error of rollouts is shown."""
SUMMARY = "summary"
"""Key of what `summary.json` of the run's report says."""
UNSHOWN = ("ensemble/guesses", "ensemble/mean", "ensemble/sample")
"""Candidates that no document speaks of."""
GROUPS = ("all", "no_wall")
"""Groups of rollouts that documents speak of."""
TWIN = "simulator/twin"
"""Two true simulations that begin a little apart."""
MEASURED = "measured_at"
"""Key of when, and at which commit, a file's figures were measured."""


def collect(run: Path, target: Path) -> list[Path]:
    """Keep the figures of each experiment that a finished run has evaluated.

    Args:
        run: the root of the repository in which it ran.
        target: folder of the figures, with one folder a scale.

    Returns:
        The files, those included that say the same as before.

    Raises:
        ReportError: there is no evaluation, its files are damaged, or the run's params file is none of `SCALES`.
    """
    params = run / "params.yaml"
    params_file = parse_params(params, params.read_text(encoding="utf-8")).get("params_file")
    if params_file not in SCALES:
        message = f"{params}: params_file should be one of {', '.join(SCALES)}, but is {params_file}"
        raise ReportError(message)
    found = [name for name in KINDS if (run / "data" / "evaluation" / name / "evaluation.json").is_file()]
    if not found:
        message = f"{run / 'data' / 'evaluation'}: nothing has been evaluated there; run 'make run' first"
        raise ReportError(message)
    read: Mapping[str, Callable[[Path, str], Figures]] = {"transitions": _transitions, "motion": _motion}
    if SCALES[params_file] == CLIPS:
        return [keep(target / f"{CLIPS}.json", _clips(run), measured_at(run, "pfnn"))]
    return [
        keep(target / SCALES[params_file] / f"{name}.json", read[KINDS[name]](run, name), measured_at(run, name))
        for name in found
    ]


def keep(path: Path, figures: Figures, measured: Mapping[str, str]) -> Path:
    """Write figures, with when they were measured: when they were first, if the file holds the same ones."""
    # What is in Git elsewhere is kept to the last digit, so that a test can compare it.
    figures = {key: value if key == SUMMARY else rounded(value) for key, value in figures.items()}
    before = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    if before.get(MEASURED) and {**before, MEASURED: None} == {**figures, MEASURED: None}:
        return path
    write_text(path, in_lines({MEASURED: dict(measured), **figures}))
    return path


def stamp(folder: Path, root: Path) -> None:
    """Say of figures that a program has just written when, and at which commit of `root`, they were measured."""
    for path in sorted(folder.glob("*.json")):
        figures = json.loads(path.read_text(encoding="utf-8"))
        if MEASURED not in figures:
            keep(path, figures, {"commit": _commit(root), "date": _date(path)})


def measured_at(run: Path, experiment: str) -> dict[str, str]:
    """Return the commit of a run, and the day on which its evaluation ended."""
    return {"commit": _commit(run), "date": _date(run / "data" / "evaluation" / experiment / "evaluation.json")}


def rounded(value: Any) -> Any:
    """Return JSON-compatible values with every number rounded to `DIGITS` significant digits, counts excepted."""
    if isinstance(value, Mapping):
        return {key: rounded(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(each) for each in value]
    return float(f"{value:.{DIGITS - 1}e}") if isinstance(value, float) else value


def in_lines(figures: Figures) -> str:
    """Return JSON in which what is two levels deep stands on a line of its own."""

    def entry(key: str, value: Any) -> str:
        name = json.dumps(key)
        if isinstance(value, dict) and any(isinstance(each, dict) for each in value.values()):
            inner = ",\n  ".join(f"{json.dumps(k)}: {json.dumps(v, ensure_ascii=False)}" for k, v in value.items())
            return f"{name}: {{\n  {inner}\n }}"
        return f"{name}: {json.dumps(value, ensure_ascii=False)}"

    return "{\n " + ",\n ".join(entry(key, value) for key, value in figures.items()) + "\n}\n"


def _transitions(run: Path, name: str) -> Figures:
    """Return what the documents show of an experiment with transitions."""
    folder = run / "data" / "evaluation" / name
    found = read_json(folder / "evaluation.json", Evaluation)
    data = read_json(run / "data" / "figures" / name / "convert" / "data.json", dict[str, Any])
    courses = _courses(folder / "horizon.csv")
    scale = {key: _range(each) for key, each in data["ranges"].items()}
    step = found.trust.step_seconds if found.trust else None
    return {
        SUMMARY: read_json(run / "data" / "reports" / name / "summary.json", dict[str, float]),
        "recorded": data["transitions"],
        "test": {"transitions": found.test.transitions, "episodes": found.test.episodes},
        "rollouts": {"steps": found.rollouts.steps, "number": _rollouts(found.own)},
        "seeds": len(found.seeds),
        "choice": found.choice.candidate,
        "recommended": found.recommendation.candidate if found.recommendation else None,
        "table": _table(found),
        "candidates": {
            key: _candidate(each, courses.get(key, {}), scale, step)
            if _is_first(key) or key == found.choice.candidate
            else _another(each, scale)
            for key, each in found.candidates.items()
            if key not in UNSHOWN
        },
        "apart": _apart(found),
        "trust": _trust(found.trust),
    }


def _courses(path: Path) -> dict[str, Columns]:
    """Return the errors of rollouts against the horizon, over all of them, by candidate."""
    rows = [row for row in read_rows(path, ("model", "group", "horizon")) if row.pop("group") == "all"]
    return columns_of(path, rows, "model")


def _range(dimension: Mapping[str, Any]) -> float:
    bounded = dimension["low"] is not None and dimension["high"] is not None
    low, high = ("low", "high") if bounded else ("min", "max")
    return float(dimension[high] - dimension[low])


def _rollouts(candidate: CandidateResult) -> int | None:
    """Return how many rollouts there are; those of results of earlier versions are of one episode each."""
    if candidate.errors_after:
        return candidate.errors_after[0].rollouts
    return candidate.rollouts.all.episodes if candidate.rollouts else None


def _table(found: Evaluation) -> Figures:
    """Return Table 1, and how the samples are shared."""
    table, test = found.table, found.specialisation.test
    return {
        "selected": [each.selected for each in table.members],
        "not_selected": [each.not_selected for each in table.members],
        "misclassified_per_thousand": table.misclassified_per_thousand,
        "agreement": test.agreement,
        "agreement_train": found.specialisation.train.agreement,
        "least_share": min(test.addressed) / test.samples,
        "regret": table.regret.mean,
    }


def _is_first(name: str) -> bool:
    return "/seed-" not in name or name.endswith("/seed-0")


def _another(candidate: CandidateResult, scale: Mapping[str, float]) -> Figures:
    """Return what the documents show of a candidate from another seed than the first."""
    squared = {each.name: each.squared.mean for each in candidate.one_step.dimensions}
    return {
        "label": candidate.label,
        "scaled": candidate.one_step.scaled.mean,
        "percent": _percent(squared, scale),
        "mse": squared,
    }


def _candidate(candidate: CandidateResult, course: Columns, scale: Mapping[str, float], step: float | None) -> Figures:
    one_step, rollouts = candidate.one_step, candidate.rollouts
    groups, beside = rollouts.groups if rollouts else {}, candidate.beside_ensemble
    return {
        "label": candidate.label,
        "parameters": candidate.parameters,
        "multiply_adds": candidate.multiply_adds,
        "scaled": one_step.scaled.mean,
        "scaled_median": one_step.scaled.median,
        "percent": _percent({each.name: each.squared.mean for each in one_step.dimensions}, scale),
        "mse": {each.name: each.squared.mean for each in one_step.dimensions},
        "mae": {each.name: each.absolute.mean for each in one_step.dimensions},
        "after": dict(_after(candidate, course, scale, step)),
        "rollouts": {
            group: {name: spread.median for name, spread in each.mse.items() if spread}
            for group, each in groups.items()
            if group in GROUPS
        },
        "lost_seconds": _lost_seconds(candidate),
        "horizon": rollouts.horizon.model_dump() if rollouts and rollouts.horizon else None,
        "beside": beside.model_dump(include={"one_step", "rollouts"}) if beside else None,
    }


def _after(
    candidate: CandidateResult, course: Columns, scale: Mapping[str, float], step: float | None
) -> Iterator[tuple[str, Figures]]:
    """Yield the errors of the median rollout after each of `SECONDS`: in % of the range, and of each dimension.

    Results of earlier versions lack the former, which is then put together from the medians of the dimensions.
    """
    if not course or step is None:
        return
    medians = {each.steps: each.median_percent for each in candidate.errors_after}
    for seconds in SECONDS:
        steps = round(seconds / step)
        rows = np.flatnonzero(course["horizon"] == steps)
        if len(rows):
            squared = {name: float(course[f"{name}_p50"][rows[0]]) for name in scale}
            own = {name: value**0.5 for name, value in squared.items()}
            yield f"{seconds:g}", {"percent": medians.get(steps, _percent(squared, scale)), **own}


def _percent(squared: Mapping[str, float], scale: Mapping[str, float]) -> float:
    return float(percent_of_range(np.array([squared[name] for name in scale]), np.array([*scale.values()])))


def _lost_seconds(candidate: CandidateResult) -> float | None:
    physics = candidate.rollouts.all.physics if candidate.rollouts else None
    return physics.lost_seconds.median if physics else None


def _apart(found: Evaluation) -> Figures | None:
    """Return what becomes of two true simulations that begin a little apart; None where there are none."""
    physics = found.rollouts.physics
    if physics is None or TWIN not in physics.simulations:
        return None
    lost = physics.simulations[TWIN].all.physics
    return {
        "start": physics.apart,
        "limit": physics.angle_limit,
        "never": lost.lost_seconds.never_share if lost else None,
    }


def _trust(trust: TrustRecord | None) -> Figures | None:
    if trust is None:
        return None
    return {
        "episodes": trust.episodes,
        "coverage": {f"{each.asked:g} {each.steps}": each.of_all for each in trust.coverage},
        "auroc": {name: shift.auroc for name, shift in trust.shifts.items()},
        "kinds": {name: shift.kind for name, shift in trust.shifts.items()},
        "trusted_share": trust.trusted_share,
        "trusted_seconds": _seconds(trust.trusted_steps, trust.step_seconds),
        "rollout_seconds": _seconds(trust.rollout_steps, trust.step_seconds),
        "break_even_seconds": _seconds(trust.break_even_steps, trust.step_seconds),
    }


def _seconds(steps: int | None, step: float | None) -> float | None:
    return None if steps is None or step is None else steps * step


def _motion(run: Path, name: str) -> Figures:
    """Return what the documents show of an experiment with motion."""
    found = read_json(run / "data" / "evaluation" / name / "evaluation.json", MotionEvaluation)
    phase = found.addressing.test.all
    return {
        SUMMARY: read_json(run / "data" / "reports" / name / "summary.json", dict[str, float]),
        "frames": found.splits,
        "seeds": len(found.groups[found.own_group]),
        "choice": found.own_name,
        "recorded_limb_speed": found.reference.of("all").limb_speed,
        "phase": {"share": phase.information_share, "chance": phase.chance_share},
        "candidates": {name: _mover(each) for name, each in found.candidates.items()},
    }


def _clips(run: Path) -> Figures:
    """Return what the documents show of a run on a few real clips: the spread of each model over its seeds."""
    folder = run / "data" / "evaluation" / "pfnn"
    found = read_json(folder / "evaluation.json", MotionEvaluation)
    trained = read_json(run / "data" / "figures" / "pfnn" / "baselines" / "baselines.json", dict[str, dict[str, float]])
    phase = found.addressing.test.all
    return {
        "frames": found.splits["train"],
        "updates": max(round(each["updates"]) for each in trained.values()),
        "commanded_speed": found.own.closed_loop.run.moving.commanded_speed,
        "phase": {"share": phase.information_share, "chance": phase.chance_share},
        "candidates": {group: _over_seeds(candidates) for group, candidates in found.groups.items()},
    }


def _over_seeds(candidates: Sequence[Candidate]) -> Figures:
    alive = sum(each.closed_loop.run.alive for each in candidates)
    speeds = [speed for each in candidates if (speed := each.closed_loop.run.moving.speed) is not None]
    return {
        "label": candidates[0].label,
        "seeds": len(candidates),
        "raw": _ends([each.test.raw for each in candidates]),
        "normalised": _ends([each.test.normalised for each in candidates]),
        "score": _ends([each.closed_loop.score for each in candidates]),
        "alive": {0: "none", len(candidates): "all"}.get(alive, f"{alive} of {len(candidates)}"),
        "speed": _ends(speeds),
    }


def _ends(values: Sequence[float]) -> list[float]:
    return [min(values), max(values)] if values else []


def _mover(candidate: Candidate) -> Figures:
    run = candidate.closed_loop.run
    return {
        "label": candidate.label,
        "group": candidate.group,
        "parameters": candidate.parameters,
        "multiply_adds": candidate.multiply_adds,
        "raw": candidate.test.raw,
        "normalised": candidate.test.normalised,
        "score": candidate.closed_loop.score,
        "alive": run.alive,
        "lived_seconds": run.lived_seconds,
        "limb_speed": run.all.limb_speed,
        "skate_speed": run.all.skate_speed,
        "speed": run.all.speed,
        "commanded_speed": run.all.commanded_speed,
    }


def _commit(root: Path) -> str:
    command = ["git", "-C", str(root), "rev-parse", "--short=7", "HEAD"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip()


def _date(path: Path) -> str:
    return datetime.fromtimestamp(path.stat().st_mtime, UTC).date().isoformat()
