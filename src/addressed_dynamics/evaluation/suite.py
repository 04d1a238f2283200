"""The whole evaluation of an experiment: numbers for the report's tables, arrays for its figures."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from addressed_dynamics.evaluation.addressing_table import addressing_table
from addressed_dynamics.evaluation.candidates import Candidate
from addressed_dynamics.evaluation.one_step import errors_per_dimension, predict_all, scaled_losses, summarise
from addressed_dynamics.evaluation.rollouts import error_against_horizon, rollout_errors, summarise_rollouts
from addressed_dynamics.evaluation.truth import TrueRollouts
from addressed_dynamics.models.addressed import AddressedDynamics
from addressed_dynamics.models.stacked import StackedMLP, in_chunks
from addressed_dynamics.transitions import Transitions

HORIZON_STEP = 10
"""Most steps between two rows of the table of errors against the horizon."""
HORIZON_ROWS = 20
"""Rows that this table has at least, if the rollouts have as many steps."""


@dataclass(frozen=True)
class MemberLosses:
    """What each member of an ensemble makes of the test transitions."""

    losses: Float[Tensor, "member sample"]
    """Losses of states scaled to [0, 1]."""
    predicted: Float[Tensor, "member sample observation"]
    """Predicted next states, in the environment's units."""


def member_losses(model: AddressedDynamics, test: Transitions, loss: str) -> MemberLosses:
    """Return the loss of every test transition under every member."""
    observation, action = torch.from_numpy(test.observation), torch.from_numpy(test.action)
    predicted = in_chunks(
        lambda row: model.member_predictions(observation[row], action[row]), torch.arange(len(test)), sample_dim=1
    )
    return MemberLosses(scaled_losses(predicted, test, model.features.scale, loss), predicted)


def chosen_members(model: AddressedDynamics, test: Transitions) -> Tensor:
    """Return the member that the addressing network picks for every test transition, (N,)."""
    observation, action = torch.from_numpy(test.observation), torch.from_numpy(test.action)
    return in_chunks(lambda row: model.address(observation[row], action[row]), torch.arange(len(test)), sample_dim=0)


def evaluate_addressing(model: AddressedDynamics, test: Transitions, loss: str) -> dict[str, Any]:
    """Return Table 1 of one ensemble and addressing network."""
    return addressing_table(member_losses(model, test, loss).losses, chosen_members(model, test))


def one_step_errors(
    predicted: Float[Tensor, "sample observation"], test: Transitions, scale: tuple[float, ...], loss: str
) -> dict[str, Any]:
    """Return the one-step errors of predicted next states: of states scaled to [0, 1], and of each dimension."""
    return {
        "scaled": summarise(scaled_losses(predicted, test, scale, loss)),
        "dimensions": errors_per_dimension(predicted, test, test.spec.observation),
    }


def evaluate_candidate(candidate: Candidate, test: Transitions, scale: tuple[float, ...], loss: str) -> dict[str, Any]:
    """Return the label, size and one-step errors of one candidate."""
    errors = one_step_errors(predict_all(candidate.predictor, test), test, scale, loss)
    return {"label": candidate.label, "parameters": candidate.parameters, "one_step": errors}


def evaluate_oracle(model: AddressedDynamics, test: Transitions, loss: str) -> dict[str, Any]:
    """Return the same for the ensemble with the best member always picked: what addressing could reach."""
    members = member_losses(model, test, loss)
    predicted = members.predicted[members.losses.argmin(dim=0), torch.arange(len(test))]
    errors = one_step_errors(predicted, test, model.features.scale, loss)
    parameters = model.ensemble.members * model.ensemble.parameters_per_member
    return {"label": "ensemble, best member (oracle)", "parameters": parameters, "one_step": errors}


def evaluate_rollouts(candidate: Candidate, truth: TrueRollouts) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the rollout errors of one candidate, and rows of its error against the horizon."""
    if candidate.model is None:
        message = f"candidate '{candidate.name}' cannot be rolled out"
        raise ValueError(message)
    dimensions = candidate.model.features.spaces.observation
    squared, predicted = rollout_errors(candidate.model, truth, candidate.mode)
    every = min(HORIZON_STEP, max(1, truth.steps // HORIZON_ROWS))
    rows = error_against_horizon(squared, dimensions, every)
    summary = summarise_rollouts(squared, predicted, truth, dimensions)
    return summary, [{"model": candidate.name, **row} for row in rows]


def figure_arrays(
    model: AddressedDynamics, untrained: StackedMLP, test: Transitions, truth: TrueRollouts, loss: str
) -> dict[str, np.ndarray]:
    """Return what the figures show: test transitions with their loss profiles and choices, and typical rollouts.

    Arrays: `observation`, `action`, `episode`, `step`, `next_observation`, `predicted` (argmax), `chosen`, `best`,
    `profile` and `profile_untrained` (member, sample), `rollout_true` and `rollout_predicted` (episode, T + 1, d),
    `rollout_group` (episode).
    """
    members = member_losses(model, test, loss)
    fresh = AddressedDynamics(model.features, untrained, model.addressing)
    chosen = chosen_members(model, test)
    typical = _typical_episodes(truth)
    shown = list(typical.values())
    first = truth.states[shown, 0].astype(np.float32)
    predicted = model.rollout(first, truth.actions[shown])
    return {
        "observation": test.observation,
        "action": test.action,
        "episode": test.episode,
        "step": test.step,
        "next_observation": test.next_observation,
        "predicted": members.predicted[chosen, torch.arange(len(test))].numpy(),
        "chosen": chosen.numpy(),
        "best": members.losses.argmin(dim=0).numpy(),
        "profile": members.losses.numpy(),
        "profile_untrained": member_losses(fresh, test, loss).losses.numpy(),
        "rollout_true": truth.states[shown],
        "rollout_predicted": np.concatenate([first[:, None], predicted], axis=1),
        "rollout_group": np.array(list(typical)),
    }


def _typical_episodes(truth: TrueRollouts) -> dict[str, int]:
    """Return the middle episode of each group in the order of recording; of `all`, if there is no other group."""
    groups = {name: np.flatnonzero(members) for name, members in truth.groups.items() if members.any()}
    return {name: int(group[len(group) // 2]) for name, group in groups.items() if name != "all" or len(groups) == 1}
