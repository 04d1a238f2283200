"""n fully connected networks of the same shape as one stack of tensors: one batched matrix product per layer."""

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Self

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.params.training import Activation
from addressed_dynamics.features.common.spool import release
from addressed_dynamics.networks.layers import Activate, Layer, Layers

ACTIVATIONS: dict[str, Activate] = {
    "relu": torch.relu,
    "tanh": torch.tanh,
    "elu": nn.functional.elu,
}
"""The activation functions a network can have, by name."""

CHUNK_ROWS = 8192
"""Rows that `in_chunks` passes through a network at once: enough to keep the processor busy, small enough to stay in
its cache."""
BLOCKS_HELD = 128
"""After so many blocks, pages of files that were read or written are let go."""


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

    def on(self, device: torch.device) -> Self:
        """Return these networks on a device: themselves if that is where they are, else a copy."""
        if self.weights[0].device == device:
            return self
        other = type(self)(
            self.members, self.widths, self.activation, shared=self.shared, linear=bool(len(self.linear))
        )
        for own, copies in ((self.weights, other.weights), (self.biases, other.biases), (self.linear, other.linear)):
            for index, parameter in enumerate(own):
                copies[index] = nn.Parameter(parameter.detach().to(device), parameter.requires_grad)
        return other

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
        return self.layers.forward_all(x)

    forward = forward_all

    def forward_routed(
        self, x: Float[Tensor, "sample input"], member: Int64[Tensor, " sample"]
    ) -> Float[Tensor, "sample output"]:
        """Return each sample's output from its own member; only that member is evaluated for it."""
        layers = self.layers
        hidden = layers.after_shared(x)
        output = x.new_empty(len(x), self.widths[-1])
        for index in range(self.members):
            rows = torch.nonzero(member == index).squeeze(1)
            if len(rows):
                output[rows] = layers.of_member(index).forward(hidden[rows], x[rows])
        return output

    def forward_blended(
        self, x: Float[Tensor, "sample input"], coefficients: Float[Tensor, "sample member"]
    ) -> Float[Tensor, "sample output"]:
        """Return the same as `Layers.forward_blended`: each sample's output from a network of mixed weights."""
        return self.layers.forward_blended(x, coefficients)

    @property
    def layers(self) -> Layers:
        """The layers, as they are evaluated: views of the parameters."""
        return self.layers_of(self.weights, self.biases, self.linear, ACTIVATIONS[self.activation])

    def layers_of(
        self, weights: Iterable[Tensor], biases: Iterable[Tensor], linear: Iterable[Tensor], activate: Activate
    ) -> Layers:
        """Return tensors in the place of the parameters as layers."""
        own = [Layer(*each) for each in zip(weights, biases, strict=True)]
        shared = [Layer(weight[0], bias[0, 0]) for weight, bias in own[: self.shared]]
        return Layers(shared, own[self.shared :], next(iter(linear), None), activate)


def in_chunks(function: Callable[[Tensor], Tensor], x: Float[Tensor, "sample input"], *, sample_dim: int) -> Tensor:
    """Apply `function` to blocks of rows of `x` without gradients and join the results along `sample_dim`."""
    return in_blocks(lambda rows: function(x[rows]), range(len(x)), sample_dim=sample_dim)


def in_blocks(
    function: Callable[[slice], Tensor], rows: range, *, sample_dim: int = 0, make: Callable[..., Tensor] = torch.empty
) -> Float[Tensor, "..."]:
    """Apply `function` to blocks of consecutive rows, without gradients, and join the results, a row for each.

    Args:
        function: takes the rows of a block.
        rows: all rows.
        sample_dim: the dimension of the results that has an entry for each row.
        make: makes the tensor for the results (shape, dtype=, device=), if there is more than one block.
    """
    with torch.no_grad():
        result = function(slice(rows.start, min(rows.start + CHUNK_ROWS, rows.stop)))
        if len(rows) <= CHUNK_ROWS:
            return result
        # Written to their place at once: small results that are kept between large temporary tensors leave holes on the
        # heap into which the next temporary does not fit, and a million rows take a gigabyte.
        shape = list(result.shape)
        shape[sample_dim] = len(rows)
        joined = make(tuple(shape), dtype=result.dtype, device=result.device)
        joined.narrow(sample_dim, 0, CHUNK_ROWS).copy_(result)
        for first in range(CHUNK_ROWS, len(rows), CHUNK_ROWS):
            stop = min(first + CHUNK_ROWS, len(rows))
            block = function(slice(rows.start + first, rows.start + stop))
            joined.narrow(sample_dim, first, stop - first).copy_(block)
            if not first // CHUNK_ROWS % BLOCKS_HELD:
                release(joined)
        return joined
