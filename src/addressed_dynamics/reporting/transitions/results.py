"""What the earlier stages measured of an experiment with transitions, read and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.evaluation.transitions.records import Evaluation
from addressed_dynamics.reporting.common.missing import remedy_of
from addressed_dynamics.reporting.common.reading import Columns, columns_of, read_csv_if_there, read_rows
from addressed_dynamics.reporting.common.results import Results, read_results
from addressed_dynamics.reporting.transitions.policy_results import PolicyResult, read_policy
from addressed_dynamics.reporting.transitions.recorded import DataResult


@dataclass(frozen=True)
class Arrays:
    """arrays.npz: what the figures show of the addressed ensemble."""

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
    exogenous: Float[np.ndarray, "sample exogenous"] | None = None
    """Exogenous inputs during the steps of the test transitions, in their own units; None if there are none."""
    pair_profile: Float[np.ndarray, "2 sample"] | None = None
    """Losses of the test transitions under a small ensemble of two, for Fig. 2; None, like the next, without one."""
    pair_profile_untrained: Float[np.ndarray, "2 sample"] | None = None
    """The same before its training."""
    trust_map: Float[np.ndarray, "vertical horizontal"] | None = None
    """Mean trust of the test transitions in cells of the plane of two dimensions; None, like the next, without one."""
    trust_map_edges: Float[np.ndarray, "2 edge"] | None = None
    """Edges of these cells, of the horizontal dimension and of the vertical one."""


@dataclass(frozen=True)
class TransitionResults(Results[DataResult, Evaluation, Arrays]):
    """All that a report is made from."""

    learner: Mapping[str, Columns]
    """learner.csv by segment: every finished episode with its `return`."""
    horizon: Mapping[str, Mapping[str, Columns]]
    """horizon.csv by group of rollouts, then by model."""
    policy: PolicyResult | None = None
    """What is known of the policy that was learned in the model; None if there is none."""


def load_results(figures: Path, evaluation: Path, policies: Path | None = None) -> TransitionResults:
    """Read what the stages before the report wrote.

    Args:
        figures: folder of what the stages before the evaluation found, one folder a stage.
        evaluation: folder of what the evaluation found.
        policies: folder of the policy; None, or one that is not there, for none.

    Raises:
        ReportError: a file is missing or malformed.
    """
    results = TransitionResults(
        **read_results(figures, evaluation, DataResult, Evaluation, _arrays),
        learner=read_csv_if_there(figures / "convert" / "learner.csv", by="segment", needed=("return",)),
        horizon=_read_horizon(evaluation / "horizon.csv"),
        policy=None if policies is None else read_policy(policies),
    )
    found = results.evaluation
    delivered = results.addressing.delivered | {str(found.delivered.seed): found.delivered.variant}
    for seed, variant in delivered.items():
        if variant not in found.seeds.get(seed, {}) or "ensemble/argmax" not in found.candidates:
            what = f"seed {seed} with {variant} addressing was not measured"
            path = evaluation / "evaluation.json"
            message = f"{path}: {what}; run evaluate again ('{remedy_of(path)}')"
            raise ReportError(message)
    return results


def _read_horizon(path: Path) -> dict[str, dict[str, Columns]]:
    groups: dict[str, list[dict[str, str]]] = {"all": []}
    if not path.is_file():
        return {"all": {}}
    for row in read_rows(path, ("group", "model", "horizon")):
        groups.setdefault(row.pop("group"), []).append(row)
    return {group: columns_of(path, rows, "model") for group, rows in groups.items()}


def _arrays(file: Mapping[str, np.ndarray]) -> Arrays:
    return Arrays(**{field.name: file[field.name] for field in fields(Arrays) if _is_there(field, file)})


def _is_there(field: Field[Any], file: Mapping[str, np.ndarray]) -> bool:
    return field.default is MISSING or field.name in file
