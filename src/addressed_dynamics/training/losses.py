"""Losses with their derivative by the output, for all members of a stack at once."""

from collections.abc import Callable
from typing import Literal

import torch
from jaxtyping import Float, Int64
from torch import Tensor

MemberLoss = Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]
"""(output (member, sample, output), target, weight (member, sample)) -> (loss that is reported (member,), derivative by
output of the loss that is trained). The two losses are the same but for `absolute_and_squared_error`.

The loss of a member is the sum over its samples of weight times the sample's loss; weights of 1/B make it the mean."""


def squared_error(
    output: Float[Tensor, "member sample output"],
    target: Float[Tensor, "member sample output"],
    weight: Float[Tensor, "member sample"],
) -> tuple[Float[Tensor, " member"], Float[Tensor, "member sample output"]]:
    """Return the mean squared error over dimensions, and its derivative."""
    error = output - target
    derivative = error * (weight.unsqueeze(-1) * (2.0 / output.shape[-1]))
    return 0.5 * (derivative * error).sum(dim=(1, 2)), derivative


def absolute_error(
    output: Float[Tensor, "member sample output"],
    target: Float[Tensor, "member sample output"],
    weight: Float[Tensor, "member sample"],
) -> tuple[Float[Tensor, " member"], Float[Tensor, "member sample output"]]:
    """Return the mean absolute error over dimensions, and its derivative (0 where the error is 0)."""
    error = output - target
    derivative = error.sign() * (weight.unsqueeze(-1) / output.shape[-1])
    return (derivative * error).sum(dim=(1, 2)), derivative


def absolute_and_squared_error(
    output: Float[Tensor, "member sample output"],
    target: Float[Tensor, "member sample output"],
    weight: Float[Tensor, "member sample"],
) -> tuple[Float[Tensor, " member"], Float[Tensor, "member sample output"]]:
    """Return the mean squared error over dimensions, and the derivative of its sum with the mean absolute error.

    The value is the one that `reported_loss` names, so that losses in training and in validation are of one unit. The
    absolute error goes on pulling where errors are small, which long rollouts need; the squared error does not give up
    on the rare large ones, at the walls (docs/decisions/0003-losses.md has the figures).
    """
    error = output - target
    share = weight.unsqueeze(-1) / output.shape[-1]
    derivative = (2.0 * error + error.sign()) * share
    return (error.square() * share).sum(dim=(1, 2)), derivative


def cross_entropy(
    output: Float[Tensor, "member sample output"],
    target: Int64[Tensor, "member sample"],
    weight: Float[Tensor, "member sample"],
) -> tuple[Float[Tensor, " member"], Float[Tensor, "member sample output"]]:
    """Return the cross-entropy of softmax(output) with a class for each sample, and its derivative."""
    log_probability = torch.log_softmax(output, dim=-1)
    chosen = log_probability.gather(-1, target.unsqueeze(-1)).squeeze(-1)
    derivative = log_probability.exp()
    if derivative.is_cpu:
        derivative.scatter_add_(-1, target.unsqueeze(-1), derivative.new_full((1,), -1.0).expand(*target.shape, 1))
    else:
        # The same; what torch makes of it on a GPU where the order of sums is to be fixed takes many launches.
        classes = torch.arange(output.shape[-1], device=output.device)
        derivative -= (target.unsqueeze(-1) == classes).to(derivative.dtype)
    return -(chosen * weight).sum(dim=1), derivative * weight.unsqueeze(-1)


def cross_entropy_of_heads(
    output: Float[Tensor, "member sample 1"],
    target: Int64[Tensor, "1 sample"],
    weight: Float[Tensor, "1 sample"],
) -> tuple[Float[Tensor, " 1"], Float[Tensor, "member sample 1"]]:
    """Return the same for a network whose outputs are the heads of a stack: one loss, for they learn together."""
    losses, derivative = cross_entropy(output.squeeze(-1).T.unsqueeze(0), target, weight)
    return losses, derivative[0].T.unsqueeze(-1).contiguous()


REGRESSION_LOSSES: dict[str, MemberLoss] = {
    "mse": squared_error,
    "mae": absolute_error,
    "mae+mse": absolute_and_squared_error,
}
"""The losses that params may name."""


def reported_loss(loss: str) -> Literal["mse", "mae"]:
    """Return the loss that a network trained on `loss` is judged by."""
    return "mae" if loss == "mae" else "mse"


def loss_profile(
    output: Float[Tensor, "member sample output"], target: Float[Tensor, "sample output"], loss: str
) -> Float[Tensor, "sample member"]:
    """Return each sample's loss under each member: its loss profile (the paper, Section 2)."""
    return loss_per_sample(output, target, loss).T.contiguous()


def loss_per_sample(
    output: Float[Tensor, "*batch output"], target: Float[Tensor, "*batch output"], loss: str
) -> Float[Tensor, "*batch"]:
    """Return the mean loss over dimensions."""
    error = output - target
    each = {"mse": error.square(), "mae": error.abs(), "mae+mse": error.square() + error.abs()}[loss]
    return each.mean(dim=-1)
