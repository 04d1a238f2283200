"""The whole evaluation of an experiment: numbers for the report's tables, arrays for its figures."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64, Int64
from torch import Tensor

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.episodes.splits import Split
from addressed_dynamics.evaluation.common.specialisation import specialisation
from addressed_dynamics.evaluation.transitions.addressing_table import addressing_table
from addressed_dynamics.evaluation.transitions.candidates import Candidate, OtherRecipe
from addressed_dynamics.evaluation.transitions.errors_after import errors_after, moments
from addressed_dynamics.evaluation.transitions.horizons import median_course, one_step_percent, steps_until_lost
from addressed_dynamics.evaluation.transitions.one_step import (
    errors_per_dimension,
    predict_all,
    scaled_losses,
    summarise,
)
from addressed_dynamics.evaluation.transitions.paired import PairedErrors, paired_errors
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.rollouts import (
    evaluate_rollouts,
    evaluate_simulations,
    flown_off_share,
    squared_errors,
)
from addressed_dynamics.evaluation.transitions.summary import DELIVERED
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.features.transitions.windows import shorter_episodes
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.sources.transitions.params import EnvironmentRollouts, RecordedRollouts
from addressed_dynamics.training.losses import reported_loss


def evaluate_addressing(model: AddressedDynamics, points: Points, loss: str) -> dict[str, Any]:
    """Return Table 1 of one ensemble and addressing network."""
    return addressing_table(points.losses(model, loss), points.chosen(model), points.scratch)


def evaluate_specialisation(model: AddressedDynamics, points: Points, loss: str) -> dict[str, Any]:
    """Return how one ensemble divides the points among its members, and how sure its addressing network is."""
    return specialisation(points.losses(model, loss), points.probabilities(model), points.scratch)


def evaluate_other_recipe(other: OtherRecipe, points: Mapping[Split, Points]) -> dict[str, Any]:
    """Return the settings of the recipe that was not chosen, and how its ensemble divides the points by its own loss.

    Args:
        other: the ensemble with that recipe.
        points: by split; the other is given as many frames as the delivered model.
    """
    features, loss = other.model.features, reported_loss(other.ensemble.loss)
    sections = {"features": features.params, "ensemble": other.ensemble, "addressing": other.addressing}
    return {
        "name": other.name,
        "recipe": {name: section.model_dump(mode="json") for name, section in sections.items()},
        "specialisation": {split: evaluate_specialisation(other.model, part, loss) for split, part in points.items()},
    }


def held_out(points: Points) -> dict[str, Any]:
    """Return the size of what is predicted one step ahead, and of what is not, for want of frames."""
    return {
        "transitions": len(points),
        "episodes": len(points.begins) - 1,
        "dropped": asdict(shorter_episodes(points.lengths, points.features.history)),
    }


def baseline_losses(candidates: Sequence[Candidate], points: Points, loss: str) -> dict[str, float]:
    """Return the mean loss of every single network among the candidates, of what it says, as in `Points.losses`."""
    single = {
        each.name: each.model for each in candidates if each.model is not None and each.model.ensemble.members == 1
    }
    return {name: float(points.losses(model, loss).mean()) for name, model in single.items()}


def one_step_errors(predicted: Float[Tensor, "point observation"], points: Points, loss: str) -> dict[str, Any]:
    """Return the one-step errors of predicted next states: of states scaled to [0, 1], in %, and of each dimension."""
    dimensions = errors_per_dimension(predicted, points)
    return {
        "scaled": summarise(scaled_losses(predicted, points, loss), points.scratch),
        "percent": one_step_percent(dimensions, np.array(points.features.scale)),
        "dimensions": dimensions,
    }


def measure_horizon(
    predicted: Float32[np.ndarray, "episode step state"], truth: TrueRollouts, features: FeatureSpec
) -> dict[str, Any]:
    """Return after how long the median rollout of a candidate is lost, or how long rollouts are if it is not."""
    steps = steps_until_lost(median_course(squared_errors(predicted, truth), np.array(features.scale)))
    return {"seconds": (steps or truth.steps) * features.spaces.step_seconds, "lost": steps is not None}


def evaluate_candidate(candidate: Candidate, points: Points, loss: str) -> dict[str, Any]:
    """Return the label, size and one-step errors of one candidate.

    Raises:
        EvaluationError: it is given more or fewer frames than the points have.
    """
    return _candidate_result(candidate, predicted_states(candidate, points), points, loss)


def predicted_states(candidate: Candidate, points: Points) -> Float[Tensor, "point observation"]:
    """Return the next states that a candidate predicts.

    Raises:
        EvaluationError: it is given more or fewer frames than the points have.
    """
    given = points.features.history if candidate.model is None else candidate.model.features.history
    if given != points.features.history:
        message = (
            f"all candidates should be given as many frames as the delivered model, {points.features.history}, but "
            f"'{candidate.name}' is given {given}: make features.history the same in both recipes"
        )
        raise EvaluationError(message)
    return predict_all(candidate.predictor, points)


def _candidate_result(
    candidate: Candidate, predicted: Float[Tensor, "point observation"], points: Points, loss: str
) -> dict[str, Any]:
    return {
        "label": candidate.label,
        "parameters": candidate.parameters,
        "multiply_adds": candidate.multiply_adds,
        "one_step": one_step_errors(predicted, points, loss),
    }


def evaluate_candidates(
    candidates: Sequence[Candidate],
    points: Points,
    truth: TrueRollouts,
    rollouts: EnvironmentRollouts | RecordedRollouts,
    loss: str,
    predicted: Mapping[str, Float32[np.ndarray, "episode step state"]],
    seen: Float64[np.ndarray, "2 state"],
    halves: Mapping[str, Float64[np.ndarray, "episode step state"]],
) -> tuple[dict[str, Any], dict[str, Any], list[dict[str, Any]], PairedErrors]:
    """Measure all candidates one step ahead and, where they can be rolled out, in free-running rollouts.

    Args:
        candidates: what is measured.
        points: transitions to predict one step ahead.
        truth: what the rollouts are held against.
        rollouts: how they were asked for.
        loss: `mse` or `mae`.
        predicted: what the candidates predict in their rollouts, by their names (`roll_out`).
        seen: range of the states that they were trained on (`seen_range`).
        halves: half of the intervals around what is predicted (`half_widths`), of those that have some.

    Returns:
        The errors of every candidate by its name; what the rollouts are held against; rows of errors against horizon;
        the errors by episode.
    """
    spaces, scale = points.features.spaces, np.array(points.features.scale)
    physics, horizon = evaluate_simulations(rollouts, truth, spaces, scale)
    at = moments(spaces.step_seconds, truth.steps)
    results, losses = dict[str, Any](), dict[str, Tensor]()
    for candidate in candidates:
        states = predicted_states(candidate, points)
        losses[candidate.name] = scaled_losses(states, points, loss)
        results[candidate.name] = _candidate_result(candidate, states, points, loss)
        if candidate.name in predicted:
            found, half = predicted[candidate.name], halves.get(candidate.name)
            measured, rows = evaluate_rollouts(
                candidate.name, found, truth, spaces, scale, physics=physics is not None, half=half
            )
            measured["horizon"] = measure_horizon(found, truth, points.features)
            measured["flown_off_share"] = flown_off_share(found, seen)
            results[candidate.name] |= {
                "rollouts": measured,
                "errors_after": errors_after(at, squared_errors(found, truth), scale, spaces.observation_names, half),
            }
            horizon += rows
    paired = paired_errors(losses, points, predicted, truth)
    for name, ratios in paired.beside(DELIVERED, spaces.observation_names, points.features.scale).items():
        results[name]["beside_ensemble"] = ratios
    names = [dimension.name for dimension in spaces.exogenous]
    source = {
        "kind": rollouts.kind,
        "steps": truth.steps,
        "steps_wanted": rollouts.steps,
        "too_short": dict(truth.too_short),
        "dropped": asdict(truth.dropped),
        **({"overlapping": True} if truth.overlapping else {}),
        "physics": physics,
        **({"exogenous": names} if names else {}),
    }
    return results, source, horizon, paired


def figure_arrays(
    model: AddressedDynamics,
    untrained: StackedMLP,
    points: Points,
    truth: TrueRollouts,
    predicted: Float32[np.ndarray, "episode step state"],
    loss: str,
) -> dict[str, np.ndarray]:
    """Return what the figures show: test points with their loss profiles and choices, and typical rollouts.

    Args:
        model: what is delivered.
        untrained: its ensemble before the training.
        points: what it predicts one step ahead.
        truth: what really happened.
        predicted: what the model makes of that in the mode `argmax`.
        loss: `mse` or `mae`.

    Arrays: `observation`, `action`, `episode`, `step`, `next_observation`, `predicted` (argmax), `chosen`, `best`,
    `profile` and `profile_untrained` (member, point), `rollout_true` and `rollout_predicted` (episode, T + 1, d),
    `rollout_actions` (episode, T, ...), `rollout_group` (episode); and `exogenous`, if there are such inputs.
    """
    losses, chosen = points.losses(model, loss), points.chosen(model)
    fresh = AddressedDynamics(model.features, untrained, model.addressing)
    typical = _typical_episodes(truth)
    shown = list(typical.values())
    first = truth.states[shown, 0].astype(np.float32)
    return {
        "observation": points.observation,
        "action": points.action,
        "episode": points.episode,
        "step": points.step,
        "next_observation": points.next_observation,
        "predicted": _decoded(model, points, chosen).numpy(),
        "chosen": chosen.numpy(),
        "best": points.each(lambda rows: losses[:, rows].argmin(dim=0)).numpy(),
        "profile": losses.numpy(),
        "profile_untrained": points.losses(fresh, loss).numpy(),
        "rollout_true": truth.states[shown],
        "rollout_predicted": np.concatenate([first[:, None], predicted[shown]], axis=1),
        "rollout_actions": truth.actions[shown],
        "rollout_group": np.array(list(typical)),
        **({"exogenous": points.exogenous} if model.features.spaces.exogenous else {}),
    }


def pair_arrays(pair: StackedMLP, untrained: StackedMLP, points: Points, loss: str) -> dict[str, np.ndarray]:
    """Return the loss profiles of a small ensemble of two: `pair_profile` and `pair_profile_untrained` (2, point)."""
    networks = {"pair_profile": pair, "pair_profile_untrained": untrained}
    return {name: points.losses(_unaddressed(network, points), loss).numpy() for name, network in networks.items()}


def _unaddressed(network: StackedMLP, points: Points) -> AddressedDynamics:
    """Return an ensemble of which only what its members say is asked."""
    nothing = StackedMLP(1, (points.features.inputs, network.members), "relu")
    return AddressedDynamics(points.features, network, nothing)


def _decoded(
    model: AddressedDynamics, points: Points, member: Int64[Tensor, " point"]
) -> Float[Tensor, "point observation"]:
    """Return the states that each point's member predicts."""
    outputs = points.outputs(model)

    def decoded(rows: slice) -> Tensor:
        output = outputs[member[rows], torch.arange(rows.start, rows.stop)]
        return model.features.decode(output, torch.from_numpy(points.observation[rows]))

    return points.each(decoded)


def _typical_episodes(truth: TrueRollouts) -> dict[str, int]:
    """Return the middle episode of each group in the order of recording; of `all`, if there is no other group."""
    groups = {name: np.flatnonzero(members) for name, members in truth.groups.items() if members.any()}
    return {name: int(group[len(group) // 2]) for name, group in groups.items() if name != "all" or len(groups) == 1}
