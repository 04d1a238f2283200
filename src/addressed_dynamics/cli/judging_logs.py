"""What `addressed-dynamics trust` says: whether logs are like those that a model was made of."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from rich.console import Group, RenderableType
from rich.text import Text

from addressed_dynamics.base.errors import TransitionsError
from addressed_dynamics.cli.terminal import column_table, safe_text
from addressed_dynamics.episodes.transitions import SpaceSpec
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.sources.transitions.reading import read_transitions

MOST_EPISODES = 20
"""Episodes that are shown, the most surprising first."""
BLOCK_ROWS = 8192
MEANING = (
    "On data like the validation episodes trust is 0.5 and surprise 1 on average. Little trust: states or actions that "
    "are far from the training data. Much surprise: the next states are not those of what was recorded for training."
)


@dataclass(frozen=True)
class EpisodeTrust:
    """What a model says of one episode of a log."""

    episode: int
    steps: int
    trust: float
    """Mean over the steps."""
    unknown_share: float
    """Share of the steps with trust 0: beyond all validation points."""
    surprise: float
    """Mean over the steps."""

    def to_json(self) -> dict[str, float | int]:
        """Return it as JSON-compatible values."""
        return dict(self.__dict__)


def judge_logs(models: Path, logs: Path, candidate: str | None) -> list[EpisodeTrust]:
    """Return what a model says of logs of transitions, one entry for each episode that is long enough for its history.

    Args:
        models: folder of an experiment's models.
        logs: logs or tables, as `read_transitions` takes them.
        candidate: which model; None for the delivered one.

    Raises:
        AddressedDynamicsError: the model or the logs cannot be read, nobody calibrated the model, or the logs have
            other spaces.
    """
    model = AddressedDynamics.load(models, candidate=candidate)
    transitions = read_transitions(logs)
    ours, theirs = model.features.spaces, transitions.spec
    for what, wanted, found in (
        ("states", ours.observation_names, theirs.observation_names),
        ("actions", ours.action, theirs.action),
        ("exogenous inputs", ours.exogenous, theirs.exogenous),
    ):
        if wanted != found:
            message = f"{logs}: the model's {what} are {wanted}, but those of these logs are {found}"
            raise TransitionsError(message)
    if otherwise := _other_units(ours, theirs):
        message = f"{logs}: the model's {otherwise} in these logs"
        raise TransitionsError(message)
    points = Points.of(transitions, model.features)
    if not len(points):
        message = f"{logs}: no episode has the {model.features.history} steps that the model is given"
        raise TransitionsError(message)
    trust, surprise = np.empty(len(points)), np.empty(len(points))
    after = torch.from_numpy(points.next_observation)
    for rows in torch.split(torch.arange(len(points)), BLOCK_ROWS):
        observation, action = points.inputs(rows)
        exogenous = points.exogenous_inputs(rows) if ours.exogenous else None
        trust[rows] = model.trust(observation, action, exogenous=exogenous).numpy()
        surprise[rows] = model.surprise(observation, action, after[rows], exogenous=exogenous).numpy()
    found_episodes, place = np.unique(points.episode, return_inverse=True)
    steps, trusts, unknown, surprises = (
        np.bincount(place, weights) for weights in (None, trust, (trust == 0.0).astype(float), surprise)
    )
    return [
        EpisodeTrust(int(episode), int(number), float(mean), float(share), float(high))
        for episode, number, mean, share, high in zip(
            found_episodes, steps, trusts / steps, unknown / steps, surprises / steps, strict=True
        )
    ]


def _other_units(ours: SpaceSpec, theirs: SpaceSpec) -> str | None:
    """Say in what states of the same names, or steps, are measured otherwise; None if in nothing that is known."""
    for own, other in zip(ours.observation, theirs.observation, strict=True):
        if own.unit and other.unit and own.unit != other.unit:
            return f"state '{own.name}' is in {own.unit}, but in {other.unit}"
    if not math.isclose(ours.step_seconds, theirs.step_seconds, rel_tol=1e-3):
        return f"step takes {ours.step_seconds:g} s, but {theirs.step_seconds:g} s"
    return None


def trust_view(logs: Path, found: list[EpisodeTrust]) -> RenderableType:
    """Return the episodes as a table, the most surprising first, and what the numbers mean."""
    table = column_table("Episode", steps=True, trust=True, beyond_all_data=True, surprise=True)
    shown = sorted(found, key=lambda each: -each.surprise)[:MOST_EPISODES]
    for each in shown:
        table.add_row(*map(safe_text, (each.episode, *_cells([each]))))
    table.add_section()
    table.add_row(*map(safe_text, (f"all {len(found):,}", *_cells(found))))
    return Group(safe_text(logs, style="bold"), table, Text(MEANING))


def _cells(found: list[EpisodeTrust]) -> tuple[str, ...]:
    steps = np.array([each.steps for each in found])
    means = [
        float((np.array(values) * steps).sum() / steps.sum())
        for values in zip(*((each.trust, each.unknown_share, each.surprise) for each in found), strict=True)
    ]
    return f"{steps.sum():,}", f"{means[0]:.2f}", f"{100 * means[1]:.1f} %", f"{means[2]:.2f}"
