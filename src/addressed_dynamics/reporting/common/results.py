"""What the earlier stages measured, read and checked."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Float, Int
from pydantic import TypeAdapter, ValidationError

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.reporting.common.records import AddressingTrainings, DataResult, Evaluation

Value = TypeVar("Value")
Columns = dict[str, np.ndarray]
"""Columns of a CSV file; NaN where a row has no number."""


@dataclass(frozen=True)
class Arrays:
    """arrays.npz: what the figures show of the delivered model."""

    observation: Float[np.ndarray, "sample observation"]
    """States of the test transitions, in the environment's units."""
    action: np.ndarray
    """Actions: integers (sample,), or (sample, d_act)."""
    episode: Int[np.ndarray, " sample"]
    """Episodes the samples come from."""
    next_observation: Float[np.ndarray, "sample observation"]
    """True next states."""
    predicted: Float[np.ndarray, "sample observation"]
    """Next states as the selected member predicts them."""
    chosen: Int[np.ndarray, " sample"]
    """Member that the addressing network selects."""
    best: Int[np.ndarray, " sample"]
    """Member with the lowest loss."""
    profile: Float[np.ndarray, "member sample"]
    """Losses of states scaled to [0, 1] after training."""
    profile_untrained: Float[np.ndarray, "member sample"]
    """The same before training."""
    rollout_true: Float[np.ndarray, "rollout time observation"]
    """What really happened in a few rollouts."""
    rollout_predicted: Float[np.ndarray, "rollout time observation"]
    """What the model made of them."""
    rollout_group: np.ndarray
    """Group that each of them stands for: `no_wall` and `wall`, segments of the data, or `all`; text (rollout,)."""
    rollout_actions: np.ndarray | None = None
    """The actions of these rollouts: integers (rollout, step), or (rollout, step, d_act); None if they are unknown."""
    pair_profile: Float[np.ndarray, "2 sample"] | None = None
    """Losses of the test transitions under a small ensemble of two, for Fig. 2; None, like the next, without one."""
    pair_profile_untrained: Float[np.ndarray, "2 sample"] | None = None
    """The same before its training."""


@dataclass(frozen=True)
class Results:
    """All that a report is made from."""

    data: DataResult
    evaluation: Evaluation
    addressing: AddressingTrainings
    baselines: dict[str, dict[str, float]]
    """baselines.json: last metrics of each baseline, with `parameters`, `updates` and, if known, `samples`."""
    learner: Mapping[str, Columns]
    """learner.csv by segment: every finished episode with its `return`."""
    ensemble_curves: Mapping[str, Columns]
    """ensemble.csv by training."""
    addressing_curves: Mapping[str, Columns]
    """addressing.csv by training."""
    horizon: Mapping[str, Mapping[str, Columns]]
    """horizon.csv by group of rollouts, then by model."""
    arrays: Arrays


def load_results(figures: Path, evaluation: Path) -> Results:
    """Read what the stages before the report wrote.

    Args:
        figures: folder of what the stages before the evaluation found, one folder a stage.
        evaluation: folder of what the evaluation found.

    Raises:
        ReportError: a file is missing or malformed.
    """
    results = Results(
        data=read_json(figures / "convert" / "data.json", DataResult),
        evaluation=read_json(evaluation / "evaluation.json", Evaluation),
        addressing=read_json(figures / "addressing" / "addressing.json", AddressingTrainings),
        baselines=read_json(figures / "baselines" / "baselines.json", dict[str, dict[str, float]]),
        learner=read_csv(figures / "convert" / "learner.csv", by="segment", needed=("return",)),
        ensemble_curves=read_csv(figures / "ensemble" / "ensemble.csv", by="training", needed=("epoch", "loss/train")),
        addressing_curves=read_csv(
            figures / "addressing" / "addressing.csv", by="training", needed=("epoch", "agreement")
        ),
        horizon=_read_horizon(evaluation / "horizon.csv"),
        arrays=_read_arrays(evaluation / "arrays.npz"),
    )
    found = results.evaluation
    delivered = results.addressing.delivered | {str(found.delivered.seed): found.delivered.variant}
    for seed, variant in delivered.items():
        if variant not in found.seeds.get(seed, {}) or "ensemble/argmax" not in found.candidates:
            what = f"seed {seed} with {variant} addressing was not measured"
            message = f"{evaluation / 'evaluation.json'}: {what}; run evaluate again"
            raise ReportError(message)
    return results


def read_json(path: Path, kind: type[Value]) -> Value:
    """Read a JSON file of a kind.

    Raises:
        ReportError: it is missing or malformed.
    """
    try:
        return TypeAdapter(kind).validate_json(_read_text(path))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "the file"
        message = f"{path}: {place}: {first['msg']}; run the stage that writes it again"
        raise ReportError(message) from error


def read_csv(path: Path, *, by: str, needed: tuple[str, ...]) -> dict[str, Columns]:
    """Read the columns of a CSV file, apart for each value of the column `by`.

    Raises:
        ReportError: it is missing, one of the columns `needed` is, or a cell is not a number.
    """
    return _columns(path, _read_rows(path, (by, *needed)), by)


def _read_horizon(path: Path) -> dict[str, dict[str, Columns]]:
    groups: dict[str, list[dict[str, str]]] = {"all": []}
    for row in _read_rows(path, ("group", "model", "horizon")):
        groups.setdefault(row.pop("group"), []).append(row)
    return {group: _columns(path, rows, "model") for group, rows in groups.items()}


def _read_rows(path: Path, needed: tuple[str, ...]) -> list[dict[str, str]]:
    rows = list(csv.DictReader(_read_text(path).splitlines()))
    for name in needed:
        if rows and name not in rows[0]:
            message = f"{path}: there is no column '{name}'; run the stage that writes it again"
            raise ReportError(message)
    return rows


def _columns(path: Path, rows: list[dict[str, str]], by: str) -> dict[str, Columns]:
    groups: dict[str, list[dict[str, str]]] = {}
    for row in rows:
        groups.setdefault(row[by], []).append(row)
    try:
        return {
            key: {name: np.array([float(row[name] or "nan") for row in group]) for name in group[0] if name != by}
            for key, group in groups.items()
        }
    except (ValueError, TypeError) as error:
        message = f"{path}: a cell is not a number ({error}); run the stage that writes it again"
        raise ReportError(message) from error


def _read_arrays(path: Path) -> Arrays:
    try:
        with np.load(path, allow_pickle=False) as file:
            return Arrays(**{field.name: file[field.name] for field in fields(Arrays) if _is_there(field, file)})
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        message = f"{path}: not the arrays that the evaluate stage writes ({error}); run it again"
        raise ReportError(message) from error


def _is_there(field: Field[Any], file: Mapping[str, np.ndarray]) -> bool:
    return field.default is MISSING or field.name in file


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except (OSError, UnicodeDecodeError) as error:
        message = f"{path}: cannot be read ({error}); run the stage that writes it again"
        raise ReportError(message) from error


def missing_file(path: Path) -> ReportError:
    """Return the error that says so of `path`."""
    return ReportError(f"{path}: missing, so there is nothing to report; 'dvc repro' makes it")
