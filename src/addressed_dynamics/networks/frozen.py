"""Networks that are evaluated and not trained: plain arrays and tensors, ready for their products."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from addressed_dynamics.base.params.training import Activation
from addressed_dynamics.networks.layers import Activate
from addressed_dynamics.networks.stacked import StackedMLP

_IN_PLACE: dict[Activation, Activate] = {
    "relu": torch.relu_,
    "tanh": torch.tanh_,
    "elu": lambda hidden: nn.functional.elu(hidden, inplace=True),
}

_ZERO = np.zeros((), np.float32)
_OF_ARRAYS: dict[Activation, Callable[[np.ndarray], np.ndarray]] = {
    "relu": lambda hidden: np.maximum(hidden, _ZERO, out=hidden),
    "tanh": lambda hidden: np.tanh(hidden, out=hidden),
    "elu": lambda hidden: np.where(hidden > 0, hidden, np.expm1(hidden)),
}

SMALL = 4 * 65_536
"""Multiply-adds of a layer up to which NumPy is the quicker: its calls cost less than PyTorch's. Up to here OpenBLAS,
whose threads are not those that `torch.set_num_threads` sets, does not use more than one."""

FEW = 16
"""Outputs below which MKL takes three times as long for rows times weights as for weights times columns."""


class FrozenLayer(NamedTuple):
    """One layer of one network, in two forms that share their memory."""

    weight: Float[np.ndarray, "input output"]
    bias: Float[np.ndarray, " output"]
    weight_tensor: Float[Tensor, "input output"]
    bias_tensor: Float[Tensor, " output"]
    transposed: Float[Tensor, "output input"] | None
    """A copy of the weights if there are few outputs."""

    @staticmethod
    def of(weight: Float[Tensor, "input output"], bias: Float[Tensor, " output"]) -> FrozenLayer:
        """Return a layer with these weights and biases."""
        few = weight.shape[1] < FEW
        return FrozenLayer(weight.numpy(), bias.numpy(), weight, bias, weight.T.contiguous() if few else None)

    def __call__(
        self, x: Float[np.ndarray, "sample input"], activation: Activation | None = None
    ) -> Float[np.ndarray, "sample output"]:
        """Return its outputs: those of the activation function, if it has one."""
        if len(x) * self.weight.size <= SMALL:
            output: np.ndarray = x.dot(self.weight)
            output += self.bias
            return output if activation is None else _OF_ARRAYS[activation](output)
        given = torch.from_numpy(x)
        if self.transposed is None:
            found = torch.addmm(self.bias_tensor, given, self.weight_tensor)
        else:
            found = torch.addmm(self.bias_tensor.unsqueeze(1), self.transposed, given.T).T
        return (found if activation is None else _IN_PLACE[activation](found)).numpy()


class FrozenMLP:
    """What a `StackedMLP` computes, without the bookkeeping of parameters: a quarter of the time for one input.

    The weights are copied when it is made. Where a method takes arrays, it has no gradient.
    """

    def __init__(self, stack: StackedMLP) -> None:
        """Copy the weights of `stack`."""
        self.members = stack.members
        self._outputs = stack.widths[-1]
        # What is made inside of torch.inference_mode could not be used outside of it.
        with torch.inference_mode(mode=False), torch.no_grad():
            weights, biases, linear = (
                [parameter.detach().clone() for parameter in parameters]
                for parameters in (stack.weights, stack.biases, stack.linear)
            )
            self._layers = stack.layers_of(weights, biases, linear, _IN_PLACE[stack.activation])
            self._shared = [FrozenLayer.of(*each) for each in self._layers.shared]
            self._own = [
                [FrozenLayer.of(*each) for each in self._layers.of_member(member).layers]
                for member in range(stack.members)
            ]
        self._linear = [each.numpy() for each in linear[0]] if linear else None
        self._activation = stack.activation

    def forward_all(self, x: Float[Tensor, "sample input"]) -> Float[Tensor, "member sample output"]:
        """Return the outputs of all members."""
        return self._layers.forward_all(x)

    def forward_blended(
        self, x: Float[Tensor, "sample input"], coefficients: Float[Tensor, "sample member"]
    ) -> Float[Tensor, "sample output"]:
        """Return the same as `Layers.forward_blended`: each sample's output from a network of mixed weights."""
        return self._layers.forward_blended(x, coefficients)

    def forward_member(self, x: Float[np.ndarray, "sample input"], member: int) -> Float[np.ndarray, "sample output"]:
        """Return the outputs of one member."""
        output = self._through(self._own[member], self._after_shared(x))
        if self._linear is not None:
            output += x @ self._linear[member]
        return output

    def forward_routed(
        self, x: Float[np.ndarray, "sample input"], member: Int[np.ndarray, " sample"]
    ) -> Float[np.ndarray, "sample output"]:
        """Return each sample's output from its own member; only that member is evaluated for it."""
        if self.members == 1 or len(x) == 1:
            return self.forward_member(x, 0 if self.members == 1 else int(member[0]))
        output = np.empty((len(x), self._outputs), x.dtype)
        # Integers of 16 bits are sorted in a third of the time.
        order, start = member.astype(np.uint16).argsort(kind="stable"), 0
        for index, count in enumerate(np.bincount(member, minlength=self.members).tolist()):
            if count:
                rows = order[start : start + count]
                output[rows] = self.forward_member(x.take(rows, axis=0), index)
                start += count
        return output

    def scores(self, x: Float[np.ndarray, "sample input"]) -> Float[np.ndarray, "sample member"]:
        """Return the same as `addressing_scores`, of networks that address others."""
        hidden = self._after_shared(x)
        each = [self._through(own, hidden) for own in self._own]
        return each[0] if self.members == 1 else np.concatenate(each, axis=1)

    def _after_shared(self, x: Float[np.ndarray, "sample input"]) -> Float[np.ndarray, "sample hidden"]:
        for layer in self._shared:
            x = layer(x, self._activation)
        return x

    def _through(
        self, layers: Sequence[FrozenLayer], hidden: Float[np.ndarray, "sample hidden"]
    ) -> Float[np.ndarray, "sample output"]:
        *inner, last = layers
        for layer in inner:
            hidden = layer(hidden, self._activation)
        return last(hidden)
