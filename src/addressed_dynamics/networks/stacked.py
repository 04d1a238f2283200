"""n fully connected networks of the same shape as one stack of tensors: one batched matrix product per layer."""

import math
from collections.abc import Callable, Sequence
from itertools import islice, pairwise
from typing import Literal

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from addressed_dynamics.base.errors import ModelError

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

    The first `shared` layers may be the same for all members: a trunk, whose weights are (1, in, out), with one head
    for each member.

    With a linear part the output of a member is that of its layers plus the inputs times a matrix of its own.
    """

    def __init__(
        self,
        members: int,
        widths: Sequence[int],
        activation: Activation,
        generator: torch.Generator | None = None,
        *,
        shared: int = 0,
        linear: bool = False,
    ) -> None:
        """Make the networks, with weights and biases uniform in ±1/sqrt(inputs of the layer), as `nn.Linear` has them.

        Args:
            members: number of networks.
            widths: number of inputs, widths of the hidden layers, number of outputs.
            activation: nonlinearity after each hidden layer.
            generator: source of the initial weights; None leaves them zero, to be loaded.
            shared: number of first layers that are the same for all members.
            linear: whether every member has a linear part, whose weights are zero at first.

        Raises:
            ModelError: there are no members or fewer than two widths, or one of them is below 1; or no layer is left
                that is not shared.
        """
        super().__init__()
        if members < 1 or len(widths) < 2 or min(widths) < 1:
            message = (
                f"a stack needs members >= 1 and widths (in, ..., out) >= 1, but has {members} and {tuple(widths)}"
            )
            raise ModelError(message)
        if not 0 <= shared < len(widths) - 1:
            message = (
                f"of {len(widths) - 1} layers, 0 to {len(widths) - 2} can be shared by all members, but not {shared}"
            )
            raise ModelError(message)
        self.members = members
        self.widths = tuple(widths)
        self.activation: Activation = activation
        self.shared = shared
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        for layer, (inputs, outputs) in enumerate(pairwise(self.widths)):
            copies = 1 if layer < shared else members
            weight, bias = torch.zeros(copies, inputs, outputs), torch.zeros(copies, 1, outputs)
            if generator is not None:
                bound = 1.0 / math.sqrt(inputs)
                weight.uniform_(-bound, bound, generator=generator)
                bias.uniform_(-bound, bound, generator=generator)
            self.weights.append(nn.Parameter(weight))
            self.biases.append(nn.Parameter(bias))
        self.linear = nn.ParameterList()
        if linear:
            self.linear.append(nn.Parameter(torch.zeros(members, self.widths[0], self.widths[-1])))

    @property
    def parameters_per_member(self) -> int:
        """Number of weights and biases that one member computes with; those that are shared count for every member."""
        return sum(parameter[0].numel() for parameter in self.parameters())

    @property
    def parameters_total(self) -> int:
        """Number of weights and biases that all members have together; those that are shared count once."""
        return sum(parameter.numel() for parameter in self.parameters())

    def multiply_adds(self, members: int | None = None) -> int:
        """Return the multiply-adds of one input when so many members are evaluated for it, all of them if None.

        A multiply-add is a product with a weight; biases and activations are not counted. Layers that all members share
        are evaluated once.
        """
        evaluated = self.members if members is None else members
        linear = evaluated * self.widths[0] * self.widths[-1] if len(self.linear) else 0
        layers = enumerate(pairwise(self.widths))
        return linear + sum(
            width_in * width_out * (1 if k < self.shared else evaluated) for k, (width_in, width_out) in layers
        )

    @property
    def multiply_adds_blended(self) -> int:
        """Multiply-adds of one input in `forward_blended`: every member's layers, and mixing what they put out.

        To mix the weights instead and evaluate one network costs as many products, but for this mixing.
        """
        return self.multiply_adds() + self.members * sum(self.widths[1 + self.shared :])

    def forward_all(self, x: Float[Tensor, "*member sample input"]) -> Float[Tensor, "member sample output"]:
        """Return the outputs of all members, either for the same inputs (sample, input) or each for its own."""
        if x.shape[-1] != self.widths[0]:
            message = f"the network takes {self.widths[0]} inputs, but was given {x.shape[-1]}"
            raise ModelError(message)
        activate = ACTIVATIONS[self.activation]
        hidden = self._forward_shared(x)
        hidden = hidden if hidden.ndim == 3 else hidden.expand(self.members, -1, -1)
        *inner, last = self._own_layers()
        for weight, bias in inner:
            hidden = activate(torch.baddbmm(bias, hidden, weight))
        return self._with_linear(torch.baddbmm(last[1], hidden, last[0]), x)

    forward = forward_all

    def forward_routed(
        self, x: Float[Tensor, "sample input"], member: Int64[Tensor, " sample"]
    ) -> Float[Tensor, "sample output"]:
        """Return each sample's output from its own member; only that member is evaluated for it."""
        hidden = self._forward_shared(x)
        output = x.new_empty(len(x), self.widths[-1])
        for index in range(self.members):
            rows = torch.nonzero(member == index).squeeze(1)
            if len(rows):
                output[rows] = self._forward_member(hidden[rows], index)
                for weight in self.linear:
                    output[rows] += x[rows] @ weight[index]
        return output

    def forward_blended(
        self, x: Float[Tensor, "sample input"], coefficients: Float[Tensor, "sample member"]
    ) -> Float[Tensor, "sample output"]:
        """Return each sample's output from a network of its own whose weights are mixed with `coefficients`.

        Mixing weights before a layer is mixing the layer's linear outputs, so no network is built per sample. A layer
        that all members share is what it is, whatever the coefficients, which should add up to 1.
        """
        activate = ACTIVATIONS[self.activation]
        mix = coefficients.T.unsqueeze(-1)
        hidden = self._forward_shared(x)
        *inner, last = self._own_layers()
        for weight, bias in inner:
            hidden = activate((mix * torch.baddbmm(bias, hidden.expand(self.members, -1, -1), weight)).sum(dim=0))
        outputs = torch.baddbmm(last[1], hidden.expand(self.members, -1, -1), last[0])
        return (mix * self._with_linear(outputs, x)).sum(dim=0)

    def _with_linear(
        self, output: Float[Tensor, "member sample output"], x: Float[Tensor, "*member sample input"]
    ) -> Float[Tensor, "member sample output"]:
        """Return the outputs of the layers with those of the linear parts, if there are any."""
        for weight in self.linear:
            output = torch.baddbmm(output, x.expand(self.members, *x.shape[-2:]), weight)
        return output

    def _own_layers(self) -> list[tuple[Tensor, Tensor]]:
        """Return weight and bias of the layers that every member has for itself."""
        return list(zip(self.weights, self.biases, strict=True))[self.shared :]

    def _forward_shared(self, x: Float[Tensor, "*member sample input"]) -> Float[Tensor, "*member sample hidden"]:
        """Return what the shared layers make of `x`: the inputs of the others."""
        activate = ACTIVATIONS[self.activation]
        hidden = x
        for weight, bias in islice(zip(self.weights, self.biases, strict=True), self.shared):
            hidden = activate(nn.functional.linear(hidden, weight[0].T, bias[0, 0]))
        return hidden

    def _forward_member(self, hidden: Float[Tensor, "sample hidden"], index: int) -> Float[Tensor, "sample output"]:
        """Return what the layers of one member make of the outputs of the shared ones."""
        activate = ACTIVATIONS[self.activation]
        for layer, (weight, bias) in enumerate(self._own_layers()):
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
