"""One update of all members of a stack: forward, backward by hand, Adam on one flat tensor.

Hand-written because autograd's bookkeeping costs more than the arithmetic at these sizes; a test holds it to autograd.
"""

import math
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from addressed_dynamics.models.stacked import ACTIVATIONS, Activation, StackedMLP
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
        self._flat.grad = torch.zeros_like(self._flat)
        shapes = [parameter.shape for parameter in stack.parameters()]
        views, gradients = _views(self._flat, shapes), _views(self._flat.grad, shapes)
        for parameter, view in zip(stack.parameters(), views, strict=True):
            parameter.data = view
        layers = len(stack.weights)
        self._weights, self._biases = views[:layers], views[layers:]
        self._weight_gradients, self._bias_gradients = gradients[:layers], gradients[layers:]
        self._adam = torch.optim.Adam([self._flat], lr=optimiser.learning_rate, betas=optimiser.betas, fused=True)

    @torch.no_grad()
    def update(
        self, x: Float[Tensor, "member sample input"], target: Tensor, weight: Float[Tensor, "member sample"]
    ) -> Float[Tensor, " member"]:
        """Train every member on its own batch; return the members' losses before the update."""
        losses = self.gradients(x, target, weight)
        self._adam.param_groups[0]["lr"] = self.learning_rate
        self._adam.step()
        self.updates += 1
        return losses

    @torch.no_grad()
    def gradients(
        self, x: Float[Tensor, "member sample input"], target: Tensor, weight: Float[Tensor, "member sample"]
    ) -> Float[Tensor, " member"]:
        """Compute the gradient of the summed loss by all weights and biases; return the members' losses."""
        activate, derive = ACTIVATIONS[self.stack.activation], _DERIVATIVES[self.stack.activation]
        layer_inputs = [x]
        for weights, bias in zip(self._weights[:-1], self._biases[:-1], strict=True):
            layer_inputs.append(activate(torch.baddbmm(bias, layer_inputs[-1], weights)))
        output = torch.baddbmm(self._biases[-1], layer_inputs[-1], self._weights[-1])
        losses, derivative = self._loss(output, target, weight)
        for layer in range(len(self._weights) - 1, -1, -1):
            torch.bmm(layer_inputs[layer].transpose(1, 2), derivative, out=self._weight_gradients[layer])
            torch.sum(derivative, dim=1, keepdim=True, out=self._bias_gradients[layer])
            if layer:
                derivative = derive(torch.bmm(derivative, self._weights[layer].transpose(1, 2)), layer_inputs[layer])
        return losses

    @property
    def learning_rate(self) -> float:
        """The learning rate of the next update: half a cosine from the peak to the final share of it."""
        done = min(self.updates / max(self._total_updates, 1), 1.0)
        share = self._schedule.final_share + (1.0 - self._schedule.final_share) * 0.5 * (1.0 + math.cos(math.pi * done))
        return self._schedule.learning_rate * share

    def state(self) -> dict[str, Tensor]:
        """Return all that is needed to go on from here, as copies."""
        adam = self._adam.state.get(self._flat)
        moments = (adam["exp_avg"], adam["exp_avg_sq"]) if adam else (torch.zeros_like(self._flat),) * 2
        return {
            "parameters": self._flat.clone(),
            "first_moment": moments[0].clone(),
            "second_moment": moments[1].clone(),
            "updates": torch.tensor(self.updates),
        }

    def restore(self, state: dict[str, Tensor]) -> None:
        """Go on from what `state` returned."""
        self._flat.copy_(state["parameters"])
        self.updates = int(state["updates"])
        self._adam.state[self._flat] = {
            "step": torch.tensor(float(self.updates)),
            "exp_avg": state["first_moment"].clone(),
            "exp_avg_sq": state["second_moment"].clone(),
        }


def _views(flat: Tensor, shapes: list[torch.Size]) -> list[Tensor]:
    """Return views of consecutive parts of `flat` with the given shapes."""
    parts = torch.split(flat, [shape.numel() for shape in shapes])
    return [part.view(shape) for part, shape in zip(parts, shapes, strict=True)]


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
