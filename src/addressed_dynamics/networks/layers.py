"""How fully connected networks of the same shape are evaluated, written once for all that keep their weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeAlias

import torch
from jaxtyping import Float
from torch import Tensor, nn

Activate: TypeAlias = "Callable[[Tensor], Tensor]"


class Layer(NamedTuple):
    """Weights (in, out) and biases (out,) of one network; or (member, in, out) and (member, 1, out) of many."""

    weight: Tensor
    bias: Tensor


class MemberLayers(NamedTuple):
    """The layers that one member has for itself."""

    layers: Sequence[Layer]
    linear: Float[Tensor, "input output"] | None
    """Its linear part, if it has one."""
    activate: Activate

    def forward(
        self, hidden: Float[Tensor, "sample hidden"], x: Float[Tensor, "sample input"]
    ) -> Float[Tensor, "sample output"]:
        """Return its outputs, from those of the shared layers and the inputs, which the linear part takes."""
        *inner, last = self.layers
        for weight, bias in inner:
            hidden = self.activate(torch.addmm(bias, hidden, weight))
        output = torch.addmm(last.bias, hidden, last.weight)
        return output if self.linear is None else torch.addmm(output, x, self.linear)


class Layers(NamedTuple):
    """The layers of all members."""

    shared: Sequence[Layer]
    """The first ones, which are the same for all members: of one network."""
    own: Sequence[Layer]
    """The others: of many."""
    linear: Float[Tensor, "member input output"] | None
    """The members' linear parts, if they have any."""
    activate: Activate

    @property
    def members(self) -> int:
        """Number of members."""
        return len(self.own[0].weight)

    def of_member(self, member: int) -> MemberLayers:
        """Return views of the layers that one member has for itself."""
        own = [Layer(weight[member], bias[member, 0]) for weight, bias in self.own]
        return MemberLayers(own, None if self.linear is None else self.linear[member], self.activate)

    def after_shared(self, x: Float[Tensor, "*member sample input"]) -> Float[Tensor, "*member sample hidden"]:
        """Return what the shared layers make of the inputs: the inputs of the others."""
        for weight, bias in self.shared:
            x = self.activate(nn.functional.linear(x, weight.T, bias))
        return x

    def forward_all(self, x: Float[Tensor, "*member sample input"]) -> Float[Tensor, "member sample output"]:
        """Return the outputs of all members, either for the same inputs (sample, input) or each for its own."""
        hidden = self._for_each(self.after_shared(x))
        *inner, last = self.own
        for weight, bias in inner:
            hidden = self.activate(torch.baddbmm(bias, hidden, weight))
        return self._with_linear(torch.baddbmm(last.bias, hidden, last.weight), x)

    def forward_blended(
        self, x: Float[Tensor, "sample input"], coefficients: Float[Tensor, "sample member"]
    ) -> Float[Tensor, "sample output"]:
        """Return each sample's output from a network of its own whose weights are mixed with `coefficients`.

        Mixing weights before a layer is mixing the layer's linear outputs, so no network is built per sample. A layer
        that all members share is what it is, whatever the coefficients, which should add up to 1.
        """
        mix = coefficients.T.unsqueeze(-1)
        hidden = self.after_shared(x)
        *inner, last = self.own
        for weight, bias in inner:
            hidden = self.activate((mix * torch.baddbmm(bias, self._for_each(hidden), weight)).sum(dim=0))
        outputs = torch.baddbmm(last.bias, self._for_each(hidden), last.weight)
        return (mix * self._with_linear(outputs, x)).sum(dim=0)

    def _for_each(self, x: Float[Tensor, "*member sample column"]) -> Float[Tensor, "member sample column"]:
        return x if x.ndim == 3 else x.expand(self.members, -1, -1)

    def _with_linear(
        self, output: Float[Tensor, "member sample output"], x: Float[Tensor, "*member sample input"]
    ) -> Float[Tensor, "member sample output"]:
        return output if self.linear is None else torch.baddbmm(output, self._for_each(x), self.linear)
