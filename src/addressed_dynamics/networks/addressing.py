"""The network that picks a member, in its two forms, and what it says of an input."""

from typing import Literal

from jaxtyping import Float
from torch import Tensor

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.networks.stacked import StackedMLP

Use = Literal["argmax", "sample", "mixture", "blend", "phase"]
"""How a step uses networks: by the scores that address them, or by the phase."""


def addressing_scores(network: StackedMLP, x: Float[Tensor, "sample input"]) -> Float[Tensor, "sample member"]:
    """Return the score of every member: its probability is the softmax of the scores.

    Args:
        network: either one network with one output for each member, or a trunk that all share with one head of one
            output for each member (the paper's for Acrobot).
        x: inputs.
    """
    output = network.forward_all(x)
    return output[0] if network.members == 1 else output.squeeze(-1).T


def addressed_members(network: StackedMLP) -> int:
    """Return the number of members that the addressing network `network` tells apart, in either of its forms.

    Zero if it is an addressing network of neither form: several networks of several outputs.
    """
    if network.members == 1:
        return network.widths[-1]
    return network.members if network.widths[-1] == 1 else 0


def multiply_adds_a_step(
    networks: StackedMLP,
    addressing: StackedMLP | None,
    mode: Use,
) -> int:
    """Return the multiply-adds of one prediction, those of the addressing network included.

    Counted as `StackedMLP.multiply_adds` does, without encoding, decoding and the softmax.

    Args:
        networks: what predicts.
        addressing: what addresses it, evaluated whole in every mode; None if there is nothing to choose, or if the
            phase mixes the networks (the spline's few products are not counted).
        mode: `argmax` and `sample` evaluate one member; `mixture` all of them, and weighs their outputs; `blend` and
            `phase` evaluate one network whose parameters are mixed of all, as `StackedMLP.forward_blended` does.

    Raises:
        ModelError: there is no such mode.
    """
    scores = 0 if addressing is None else addressing.multiply_adds()
    match mode:
        case "argmax" | "sample":
            return scores + networks.multiply_adds(members=1)
        case "mixture":
            return scores + networks.multiply_adds() + networks.members * networks.widths[-1]
        case "blend" | "phase":
            return scores + networks.multiply_adds_blended
        case _:
            message = f"there is no addressing mode '{mode}' (modes: argmax, sample, mixture, blend, phase)"
            raise ModelError(message)
