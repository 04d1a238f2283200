"""The errors of all candidates by held-out episode, and each in multiples of the addressed ensemble's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Float64, Int64
from torch import Tensor

from addressed_dynamics.evaluation.common.bootstrap import FEWEST_ROLLOUTS, Ratio, ratio_of_medians, ratios_of_sums
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.rollouts import squared_errors
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts


@dataclass(frozen=True)
class PairedErrors:
    """Errors of the candidates on the same episodes."""

    episode: Int64[np.ndarray, " episode"]
    """Numbers of the held-out episodes."""
    samples: Int64[np.ndarray, " episode"]
    """Points in each."""
    one_step: Mapping[str, Float64[np.ndarray, " episode"]]
    """Of each candidate, the sum over an episode's points of the loss of states scaled to [0, 1]."""
    rollout_episode: Int64[np.ndarray, " rollout"]
    """Episode that each rollout is from; beside an environment, its own."""
    rollouts: Mapping[str, Float64[np.ndarray, "rollout observation"]]
    """Of each candidate that can be rolled out, the mean squared error of each rollout, in units of the state."""

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all of it as named arrays; a row of the errors is a candidate."""
        return {
            "paired_episode": self.episode,
            "paired_samples": self.samples,
            "paired_candidates": np.array(list(self.one_step)),
            "paired_one_step": np.stack(list(self.one_step.values())),
            "paired_rollout_episode": self.rollout_episode,
            "paired_rollout_candidates": np.array(list(self.rollouts)),
            "paired_rollouts": np.stack(list(self.rollouts.values())),
        }

    def beside(self, own: str, names: tuple[str, ...], scale: tuple[float, ...]) -> dict[str, dict[str, Any]]:
        """Return each candidate's errors in multiples of the addressed ensemble's, as evaluation.json has them.

        Args:
            own: name of the addressed ensemble.
            names: of the dimensions of the state.
            scale: range of each.

        Returns:
            By candidate: `one_step`, the ratio of the mean losses; `rollouts`, that of the medians over rollouts of the
            mean squared error in ranges, over all dimensions; `dimensions`, the same of each alone. None where there
            are too few episodes or rollouts or nothing to divide by.
        """
        one_step = ratios_of_sums(self.one_step, self.one_step[own], self.episode)
        return {
            name: {
                "one_step": _written(one_step[name]),
                "rollouts": self._of_rollouts(name, own, np.array(scale) ** -2.0 / len(scale)),
                "dimensions": {
                    dimension: self._of_rollouts(name, own, np.eye(len(names))[index])
                    for index, dimension in enumerate(names)
                },
            }
            for name in self.one_step
        }

    def _of_rollouts(
        self, name: str, own: str, weights: Float64[np.ndarray, " observation"]
    ) -> dict[str, float] | None:
        if name not in self.rollouts or len(self.rollout_episode) < FEWEST_ROLLOUTS:
            return None
        errors, others = (self.rollouts[each] @ weights for each in (name, own))
        return _written(ratio_of_medians(errors, others, self.rollout_episode))


def paired_errors(
    losses: Mapping[str, Float[Tensor, " point"]],
    points: Points,
    predicted: Mapping[str, Float32[np.ndarray, "rollout step observation"]],
    truth: TrueRollouts,
) -> PairedErrors:
    """Return the errors by episode.

    Args:
        losses: of every point, by candidate.
        points: what they are of.
        predicted: what the candidates predict in their rollouts.
        truth: what really happened.
    """
    numbers = points.episode[points.begins[:-1]]
    order = np.argsort(numbers)
    sums = {name: by_episode(each, points)[order] for name, each in losses.items()}
    errors = {name: squared_errors(states, truth).mean(axis=1) for name, states in predicted.items()}
    own = np.arange(len(truth.states)) if truth.episode is None else truth.episode
    return PairedErrors(numbers[order], np.diff(points.begins)[order], sums, own, errors)


def by_episode(losses: Float[Tensor, " point"], points: Points) -> Float64[np.ndarray, " episode"]:
    """Return the sum of the losses of each episode's points, in the order of the points."""
    sums = np.zeros(len(points.begins) - 1)
    for rows in points.scratch.blocks(len(points)):
        # One after the other, so that it does not matter where a block ends.
        np.add.at(sums, points.run(rows), losses[rows].double().numpy())
    return sums


def _written(ratio: Ratio | None) -> dict[str, float] | None:
    return None if ratio is None else asdict(ratio)
