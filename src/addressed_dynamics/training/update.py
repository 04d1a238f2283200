"""One update of all members of a stack: forward, backward by hand, Adam on one flat tensor.

Hand-written because autograd's bookkeeping costs more than the arithmetic at these sizes; a test holds it to autograd.
"""

import math
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.optim.adam import adam

from addressed_dynamics.models.stacked import Activation, StackedMLP
from addressed_dynamics.params import OptimiserParams
from addressed_dynamics.training.losses import MemberLoss


class StackTrainer:
    """Adam on all members of a stack. The members' losses are added, so each is trained as if it were alone.

    The stack's parameters become views of one flat tensor and change in place.
    """

    def __init__(self, stack: StackedMLP, loss: MemberLoss, optimiser: OptimiserParams, total_updates: int) -> None:
        """Prepare to train `stack` for `total_updates` updates, over which the learning rate follows its schedule."""
        self.stack = stack
        self._loss = loss
        self._schedule = optimiser
        self._total_updates = total_updates
        self.updates = 0
        self._flat = torch.cat([parameter.detach().flatten() for parameter in stack.parameters()])
        self._gradient = torch.zeros_like(self._flat)
        self._first_moment, self._second_moment = torch.zeros_like(self._flat), torch.zeros_like(self._flat)
        self._adam_step = torch.tensor(0.0)
        shapes = [parameter.shape for parameter in stack.parameters()]
        views, gradients = _views(self._flat, shapes), _views(self._gradient, shapes)
        for parameter, view in zip(stack.parameters(), views, strict=True):
            parameter.data = view
        layers = len(stack.weights)
        self._weights, self._biases = views[:layers], views[layers:]
        self._weight_gradients, self._bias_gradients = gradients[:layers], gradients[layers:]

    @torch.no_grad()
    def update(
        self, x: Float[Tensor, "member sample input"], target: Tensor, weight: Float[Tensor, "member sample"]
    ) -> Float[Tensor, " member"]:
        """Train every member on its own batch; return the members' losses before the update.

        If the stack has shared layers, all members are trained on one batch: `x` is (1, sample, input).
        """
        losses = self.gradients(x, target, weight)
        # The function that torch.optim.Adam calls: the class around it costs a small network as much as its products.
        adam(
            [self._flat], [self._gradient], [self._first_moment], [self._second_moment], [], [self._adam_step],
            fused=True, amsgrad=False, beta1=self._schedule.betas[0], beta2=self._schedule.betas[1],
            lr=self.learning_rate, weight_decay=0.0, eps=1e-8, maximize=False,
        )  # fmt: skip
        self.updates += 1
        return losses

    @torch.no_grad()
    def gradients(
        self, x: Float[Tensor, "member sample input"], target: Tensor, weight: Float[Tensor, "member sample"]
    ) -> Float[Tensor, " member"]:
        """Compute the gradient of the summed loss by all weights and biases; return the members' losses."""
        activate, derive = _ACTIVATE[self.stack.activation], _DERIVATIVES[self.stack.activation]
        members, shared, hidden = self.stack.members, self.stack.shared, x
        layer_inputs = list[Tensor]()
        for layer, (weights, bias) in enumerate(zip(self._weights, self._biases, strict=True)):
            if layer:
                hidden = activate(hidden)
            layer_inputs.append(hidden)
            if layer == shared:
                hidden = hidden.expand(members, -1, -1)
            hidden = torch.baddbmm(bias, hidden, weights)
        losses, derivative = self._loss(hidden, target, weight)
        for layer in range(len(self._weights) - 1, -1, -1):
            values, weights = layer_inputs[layer], self._weights[layer]
            if layer >= shared:
                values = values.expand(members, -1, -1)
            torch.bmm(values.transpose(1, 2), derivative, out=self._weight_gradients[layer])
            torch.sum(derivative, dim=1, keepdim=True, out=self._bias_gradients[layer])
            if layer:
                derivative = torch.bmm(derivative, weights.transpose(1, 2))
                if layer == shared:
                    derivative = derivative.sum(dim=0, keepdim=True)
                derivative = derive(derivative, layer_inputs[layer])
        return losses

    @property
    def learning_rate(self) -> float:
        """The learning rate of the next update: half a cosine from the peak to the final share of it."""
        done = min(self.updates / max(self._total_updates, 1), 1.0)
        share = self._schedule.final_share + (1.0 - self._schedule.final_share) * 0.5 * (1.0 + math.cos(math.pi * done))
        return self._schedule.learning_rate * share

    def state(self) -> dict[str, Tensor]:
        """Return all that is needed to go on from here, as copies."""
        return {
            "parameters": self._flat.clone(),
            "first_moment": self._first_moment.clone(),
            "second_moment": self._second_moment.clone(),
            "updates": torch.tensor(self.updates),
        }

    def restore(self, state: dict[str, Tensor]) -> None:
        """Go on from what `state` returned."""
        self._flat.copy_(state["parameters"])
        self._first_moment.copy_(state["first_moment"])
        self._second_moment.copy_(state["second_moment"])
        self.updates = int(state["updates"])
        self._adam_step.fill_(self.updates)


def _views(flat: Tensor, shapes: list[torch.Size]) -> list[Tensor]:
    """Return views of consecutive parts of `flat` with the given shapes."""
    parts = torch.split(flat, [shape.numel() for shape in shapes])
    return [part.view(shape) for part, shape in zip(parts, shapes, strict=True)]


def _tanh_(values: Tensor) -> Tensor:
    """Replace values by their tanh up to 2e-7, in a fifth of the time that torch.tanh takes."""
    return values.mul_(2.0).sigmoid_().mul_(2.0).sub_(1.0)


_ACTIVATE: dict[Activation, Callable[[Tensor], Tensor]] = {
    "relu": torch.relu_,
    "tanh": _tanh_,
    "elu": nn.functional.elu_,
}
"""The activation functions, in place."""


def _relu_derivative(derivative: Tensor, output: Tensor) -> Tensor:
    return torch.ops.aten.threshold_backward(derivative, output, 0.0)  # type: ignore[no-any-return] # untyped operator


def _tanh_derivative(derivative: Tensor, output: Tensor) -> Tensor:
    return torch.ops.aten.tanh_backward(derivative, output)  # type: ignore[no-any-return] # untyped operator


def _elu_derivative(derivative: Tensor, output: Tensor) -> Tensor:
    return torch.where(output > 0, derivative, derivative * (output + 1.0))


_DERIVATIVES: dict[Activation, Callable[[Tensor, Tensor], Tensor]] = {
    "relu": _relu_derivative,
    "tanh": _tanh_derivative,
    "elu": _elu_derivative,
}
