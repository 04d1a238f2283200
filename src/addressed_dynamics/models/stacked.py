"""n fully connected networks of the same shape as one stack of tensors: one batched matrix product per layer."""

import math
from collections.abc import Callable, Sequence
from typing import Literal

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from addressed_dynamics.errors import ModelError

Activation = Literal["relu", "tanh", "elu"]
ACTIVATIONS: dict[str, Callable[[Tensor], Tensor]] = {
    "relu": torch.relu,
    "tanh": torch.tanh,
    "elu": nn.functional.elu,
}
"""The activation functions a network can have, by name."""

CHUNK_ROWS = 8192
"""Rows that `in_chunks` passes through a network at once: enough to keep the processor busy, small enough to stay in
its cache."""


class StackedMLP(nn.Module):
    """`members` fully connected networks with the same layer widths, evaluated together.

    The weights of layer l of all members are one tensor (member, in, out), so training all members at once costs one
    batched product per layer; it gives what training one after the other gives. A single network is a stack of one.
    """

    def __init__(
        self, members: int, widths: Sequence[int], activation: Activation, generator: torch.Generator | None = None
    ) -> None:
        """Make the networks, with weights and biases uniform in ±1/sqrt(inputs of the layer), as `nn.Linear` has them.

        Args:
            members: number of networks.
            widths: number of inputs, widths of the hidden layers, number of outputs.
            activation: nonlinearity after each hidden layer.
            generator: source of the initial weights; None leaves them zero, to be loaded.

        Raises:
            ModelError: there are no members or fewer than two widths, or one of them is below 1.
        """
        super().__init__()
        if members < 1 or len(widths) < 2 or min(widths) < 1:
            message = (
                f"a stack needs members >= 1 and widths (in, ..., out) >= 1, but has {members} and {tuple(widths)}"
            )
            raise ModelError(message)
        self.members = members
        self.widths = tuple(widths)
        self.activation: Activation = activation
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        for inputs, outputs in zip(self.widths, self.widths[1:], strict=False):
            weight, bias = torch.zeros(members, inputs, outputs), torch.zeros(members, 1, outputs)
            if generator is not None:
                bound = 1.0 / math.sqrt(inputs)
                weight.uniform_(-bound, bound, generator=generator)
                bias.uniform_(-bound, bound, generator=generator)
            self.weights.append(nn.Parameter(weight))
            self.biases.append(nn.Parameter(bias))

    @property
    def parameters_per_member(self) -> int:
        """Number of weights and biases of one network."""
        return sum(parameter[0].numel() for parameter in self.parameters())

    def forward_all(self, x: Float[Tensor, "*member sample input"]) -> Float[Tensor, "member sample output"]:
        """Return the outputs of all members, either for the same inputs (sample, input) or each for its own."""
        if x.shape[-1] != self.widths[0]:
            message = f"the network takes {self.widths[0]} inputs, but was given {x.shape[-1]}"
            raise ModelError(message)
        activate = ACTIVATIONS[self.activation]
        hidden = x if x.ndim == 3 else x.expand(self.members, -1, -1)
        *inner, last = zip(self.weights, self.biases, strict=True)
        for weight, bias in inner:
            hidden = activate(torch.baddbmm(bias, hidden, weight))
        return torch.baddbmm(last[1], hidden, last[0])

    forward = forward_all

    def forward_routed(
        self, x: Float[Tensor, "sample input"], member: Int64[Tensor, " sample"]
    ) -> Float[Tensor, "sample output"]:
        """Return each sample's output from its own member; only that member is evaluated for it."""
        output = x.new_empty(len(x), self.widths[-1])
        for index in range(self.members):
            rows = torch.nonzero(member == index).squeeze(1)
            if len(rows):
                output[rows] = self._forward_member(x[rows], index)
        return output

    def forward_blended(
        self, x: Float[Tensor, "sample input"], coefficients: Float[Tensor, "sample member"]
    ) -> Float[Tensor, "sample output"]:
        """Return each sample's output from a network of its own whose weights are mixed with `coefficients`.

        Mixing weights before a layer is mixing the layer's linear outputs, so no network is built per sample.
        """
        activate = ACTIVATIONS[self.activation]
        mix = coefficients.T.unsqueeze(-1)
        hidden = x
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if layer:
                hidden = activate(hidden)
            hidden = (mix * torch.baddbmm(bias, hidden.expand(self.members, -1, -1), weight)).sum(dim=0)
        return hidden

    def _forward_member(self, x: Float[Tensor, "sample input"], index: int) -> Float[Tensor, "sample output"]:
        activate = ACTIVATIONS[self.activation]
        hidden = x
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if layer:
                hidden = activate(hidden)
            hidden = torch.addmm(bias[index], hidden, weight[index])
        return hidden


def in_chunks(function: Callable[[Tensor], Tensor], x: Float[Tensor, "sample input"], *, sample_dim: int) -> Tensor:
    """Apply `function` to blocks of rows of `x` without gradients and join the results along `sample_dim`."""
    with torch.no_grad():
        first, *others = torch.split(x, CHUNK_ROWS)
        result = function(first)
        if not others:
            return result
        # Written to their place at once: small results that are kept between large temporary tensors leave holes on the
        # heap into which the next temporary does not fit, and a million rows take a gigabyte.
        shape = list(result.shape)
        shape[sample_dim] = len(x)
        joined = result.new_empty(shape)
        joined.narrow(sample_dim, 0, len(first)).copy_(result)
        for index, block in enumerate(others, start=1):
            joined.narrow(sample_dim, index * CHUNK_ROWS, len(block)).copy_(function(block))
        return joined
