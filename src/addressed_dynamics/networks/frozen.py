"""Networks that are evaluated and not trained: plain tensors, ready for their products."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor, nn

from addressed_dynamics.networks.layers import Activate
from addressed_dynamics.networks.stacked import Activation, StackedMLP

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

SORTING_COST = 1_000_000
"""Multiply-adds in the time that it takes to sort samples by member: up to so many, all members are evaluated."""


class FrozenMLP:
    """What a `StackedMLP` computes, without the bookkeeping of parameters: a quarter of the time for one input.

    The weights are copied when it is made.
    """

    def __init__(self, stack: StackedMLP) -> None:
        """Copy the weights of `stack`."""
        self.members = stack.members
        self._outputs = stack.widths[-1]
        self._multiply_adds = stack.multiply_adds(members=1)
        # What is made inside of torch.inference_mode could not be used outside of it.
        with torch.inference_mode(mode=False), torch.no_grad():
            weights, biases, linear = (
                [parameter.detach().clone() for parameter in parameters]
                for parameters in (stack.weights, stack.biases, stack.linear)
            )
        self._layers = stack.layers_of(weights, biases, linear, _IN_PLACE[stack.activation])
        self._of_member = [self._layers.of_member(member) for member in range(stack.members)]
        self._activate_array = _OF_ARRAYS[stack.activation]
        self._arrays = [
            (
                [(weight.numpy(), bias.numpy()) for weight, bias in [*self._layers.shared, *layers]],
                None if linear is None else linear.numpy(),
            )
            for layers, linear, _ in self._of_member
        ]

    def forward_all(self, x: Float[Tensor, "sample input"]) -> Float[Tensor, "member sample output"]:
        """Return the outputs of all members."""
        if self.members == 1:
            return self._of_member[0].forward(self._layers.after_shared(x), x).unsqueeze(0)
        return self._layers.forward_all(x)

    def forward_routed(
        self, x: Float[Tensor, "sample input"], member: Int64[Tensor, " sample"]
    ) -> Float[Tensor, "sample output"]:
        """Return each sample's output from its own member; only that member is evaluated for it."""
        if self.members == 1 or len(x) == 1:
            chosen = 0 if self.members == 1 else int(member)
            return self._of_member[chosen].forward(self._layers.after_shared(x), x)
        if (self.members - 1) * len(x) * self._multiply_adds < SORTING_COST:
            return self.forward_all(x)[member, torch.arange(len(x))]
        # Sorted by member, the samples of each lie together.
        order = member.argsort()
        sorted_x = x.index_select(0, order)
        sorted_hidden = self._layers.after_shared(sorted_x)
        outputs, start = [], 0
        for index, count in enumerate(torch.bincount(member, minlength=self.members).tolist()):
            if count:
                rows = slice(start, start + count)
                outputs.append(self._of_member[index].forward(sorted_hidden[rows], sorted_x[rows]))
                start += count
        return x.new_empty(len(x), self._outputs).index_copy_(0, order, torch.cat(outputs))

    def forward_blended(
        self, x: Float[Tensor, "sample input"], coefficients: Float[Tensor, "sample member"]
    ) -> Float[Tensor, "sample output"]:
        """Return the same as `Layers.forward_blended`: each sample's output from a network of mixed weights."""
        return self._layers.forward_blended(x, coefficients)

    def forward_one(self, x: Float32[np.ndarray, " input"], member: int) -> Float32[np.ndarray, " output"]:
        """Return the output of one member for one input, by NumPy, whose calls cost less than PyTorch's."""
        hidden = x
        (*inner, (last, last_bias)), linear = self._arrays[member]
        for weight, bias in inner:
            hidden = hidden @ weight
            hidden += bias
            hidden = self._activate_array(hidden)
        output: Float32[np.ndarray, " output"] = hidden @ last
        output += last_bias
        if linear is not None:
            output += x @ linear
        return output

    def scores_of_one(self, x: Float32[np.ndarray, " input"]) -> Float32[np.ndarray, " member"]:
        """Return the same as `addressing_scores`, for one input, of networks that address others."""
        if self.members == 1:
            return self.forward_one(x, 0)
        return np.concatenate([self.forward_one(x, member) for member in range(self.members)])
