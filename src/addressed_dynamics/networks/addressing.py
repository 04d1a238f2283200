"""The network that picks a member, in its two forms, and what it says of an input."""

from jaxtyping import Float
from torch import Tensor

from addressed_dynamics.networks.stacked import StackedMLP


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
