"""Networks that are evaluated and not trained: plain tensors, ready for their products."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor, nn

from addressed_dynamics.networks.stacked import Activation, StackedMLP

Layer: TypeAlias = "tuple[Tensor, Tensor]"
"""Weights (in, out) and biases (out,)."""
_IN_PLACE: dict[Activation, Callable[[Tensor], Tensor]] = {
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
        self._activate = _IN_PLACE[stack.activation]
        self._multiply_adds = stack.multiply_adds(members=1)
        # What is made inside of torch.inference_mode could not be used outside of it.
        with torch.inference_mode(mode=False), torch.no_grad():
            weights, biases, self._linear = (
                [parameter.detach().clone() for parameter in parameters]
                for parameters in (stack.weights, stack.biases, stack.linear)
            )
        layers = list(zip(weights, biases, strict=True))
        self._shared: list[Layer] = [(weight[0], bias[0, 0]) for weight, bias in layers[: stack.shared]]
        self._own = layers[stack.shared :]
        self._of_member: list[list[Layer]] = [
            [(weight[member], bias[member, 0]) for weight, bias in self._own] for member in range(stack.members)
        ]
        self._activate_array = _OF_ARRAYS[stack.activation]
        self._arrays = [
            [(weight.numpy(), bias.numpy()) for weight, bias in [*self._shared, *of_member]]
            for of_member in self._of_member
        ]

    def forward_all(self, x: Float[Tensor, "sample input"]) -> Float[Tensor, "member sample output"]:
        """Return the outputs of all members."""
        hidden = self._after_shared(x)
        if self.members == 1:
            return self._one(hidden, x, 0).unsqueeze(0)
        hidden = hidden.expand(self.members, -1, -1)
        *inner, (last, last_bias) = self._own
        for weight, bias in inner:
            hidden = self._activate(torch.baddbmm(bias, hidden, weight))
        output = torch.baddbmm(last_bias, hidden, last)
        for weight in self._linear:
            output = torch.baddbmm(output, x.expand(self.members, -1, -1), weight)
        return output

    def forward_routed(
        self, x: Float[Tensor, "sample input"], member: Int64[Tensor, " sample"]
    ) -> Float[Tensor, "sample output"]:
        """Return each sample's output from its own member; only that member is evaluated for it."""
        hidden = self._after_shared(x)
        if self.members == 1:
            return self._one(hidden, x, 0)
        if len(x) == 1:
            return self._one(hidden, x, int(member))
        if (self.members - 1) * len(x) * self._multiply_adds < SORTING_COST:
            return self.forward_all(x)[member, torch.arange(len(x))]
        # Sorted by member, the samples of each lie together.
        order = member.argsort()
        sorted_x = x.index_select(0, order)
        sorted_hidden = hidden.index_select(0, order) if self._shared else sorted_x
        outputs, start = [], 0
        for index, count in enumerate(torch.bincount(member, minlength=self.members).tolist()):
            if count:
                rows = slice(start, start + count)
                outputs.append(self._one(sorted_hidden[rows], sorted_x[rows], index))
                start += count
        return x.new_empty(len(x), self._outputs).index_copy_(0, order, torch.cat(outputs))

    def forward_blended(
        self, x: Float[Tensor, "sample input"], coefficients: Float[Tensor, "sample member"]
    ) -> Float[Tensor, "sample output"]:
        """Return each sample's output from a network of its own whose weights are mixed with `coefficients`.

        They should add up to 1, as `StackedMLP.forward_blended` has it.
        """
        mix = coefficients.T.unsqueeze(-1)
        hidden = self._after_shared(x)
        *inner, (last, last_bias) = self._own
        for weight, bias in inner:
            mixed = (mix * torch.baddbmm(bias, hidden.expand(self.members, -1, -1), weight)).sum(dim=0)
            hidden = self._activate(mixed)
        output = torch.baddbmm(last_bias, hidden.expand(self.members, -1, -1), last)
        for weight in self._linear:
            output = torch.baddbmm(output, x.expand(self.members, -1, -1), weight)
        return (mix * output).sum(dim=0)

    def forward_one(self, x: Float32[np.ndarray, " input"], member: int) -> Float32[np.ndarray, " output"]:
        """Return the output of one member for one input, by NumPy, whose calls cost less than PyTorch's."""
        hidden = x
        *inner, (last, last_bias) = self._arrays[member]
        for weight, bias in inner:
            hidden = hidden @ weight
            hidden += bias
            hidden = self._activate_array(hidden)
        output: Float32[np.ndarray, " output"] = hidden @ last
        output += last_bias
        for weight in self._linear:
            output += x @ weight[member].numpy()
        return output

    def scores_of_one(self, x: Float32[np.ndarray, " input"]) -> Float32[np.ndarray, " member"]:
        """Return the same as `addressing_scores`, for one input, of networks that address others."""
        if self.members == 1:
            return self.forward_one(x, 0)
        return np.concatenate([self.forward_one(x, member) for member in range(self.members)])

    def _after_shared(self, x: Float[Tensor, "sample input"]) -> Float[Tensor, "sample hidden"]:
        for weight, bias in self._shared:
            x = self._activate(torch.addmm(bias, x, weight))
        return x

    def _one(
        self, hidden: Float[Tensor, "sample hidden"], x: Float[Tensor, "sample input"], member: int
    ) -> Float[Tensor, "sample output"]:
        """Return the output of one member, from the shared layers' outputs and the inputs."""
        *inner, (last, last_bias) = self._of_member[member]
        for weight, bias in inner:
            hidden = self._activate(torch.addmm(bias, hidden, weight))
        output = torch.addmm(last_bias, hidden, last)
        for weight in self._linear:
            output = torch.addmm(output, x, weight[member])
        return output
