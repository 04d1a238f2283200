"""One update of all members of a stack: forward, backward by hand, Adam on one flat tensor.

Hand-written because autograd's bookkeeping costs more than the arithmetic at these sizes; a test holds it to autograd.
"""

from collections.abc import Callable
from functools import partial

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn

from addressed_dynamics.base.params.sections import OptimiserParams
from addressed_dynamics.base.params.training import Activation
from addressed_dynamics.base.torch_runtime import sent
from addressed_dynamics.features.common.courses import Courses
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.training.adam import FlatAdam
from addressed_dynamics.training.graphs import Repeated
from addressed_dynamics.training.losses import MemberLoss
from addressed_dynamics.training.shares import Shares


class StackTrainer:
    """Adam on all members of a stack. The members' losses are added, so each is trained as if it were alone.

    The stack's parameters become views of one flat tensor and change in place. They are updated where they are; on a
    GPU an update is one CUDA graph, and none waits for what it computes.
    """

    def __init__(
        self,
        stack: StackedMLP,
        loss: MemberLoss,
        optimiser: OptimiserParams,
        total_updates: int,
        *,
        dropout: float = 0.0,
        weight_decay: float = 0.0,
        generator: torch.Generator | None = None,
    ) -> None:
        """Prepare to train `stack` for `total_updates` updates, over which the learning rate follows its schedule.

        Args:
            stack: the networks.
            loss: what they minimise.
            optimiser: how.
            total_updates: number of updates to come.
            dropout: share of the inputs of every layer that are set to 0 in an update.
            weight_decay: share of the learning rate by which the layers' parameters shrink in an update.
            generator: which ones, one of the CPU; of no use without dropout.
        """
        self.stack = stack
        self._loss = loss
        self._keep = 1.0 - dropout
        self._generator = generator
        self._adam = FlatAdam(
            [*stack.weights, *stack.biases], optimiser, total_updates, weight_decay=weight_decay,
            undecayed=stack.linear,
        )  # fmt: skip
        layers = len(stack.weights)
        self._weights, self._biases, self._linear = _by_use(self._adam.values, layers)
        self._weight_gradients, self._bias_gradients, self._linear_gradients = _by_use(self._adam.gradients, layers)
        on_cpu = self._adam.gradient.is_cpu
        self._activate = (_ACTIVATE if on_cpu else _ACTIVATE_IN_ONE_LAUNCH)[stack.activation]
        self._change = self._gradients_and_change if on_cpu else Repeated(self._gradients_and_change)
        self._unrolled: tuple[tuple[Courses, int], Repeated] | None = None

    @torch.no_grad()
    def update(
        self, x: Float[Tensor, "member sample input"], target: Tensor, weight: Float[Tensor, "member sample"]
    ) -> Float[Tensor, " member"]:
        """Train every member on its own batch; return the members' losses before the update.

        If the stack has shared layers, all members are trained on one batch: `x` is (1, sample, input).
        """
        self._adam.begin()
        return self._change(x, target, weight, *self._masks(x))

    @torch.no_grad()
    def update_in_shares(
        self, compute: Callable[[slice], Tensor], samples: int, shares: Shares
    ) -> Float[Tensor, " member"]:
        """Train every member on a batch whose parts may be computed by several processes; return the members' losses.

        Args:
            compute: takes which samples of the batch are a part, computes the gradient, as `gradients` and
                `gradients_unrolled` do, and returns the members' losses; weights are those of the whole batch.
            samples: number of samples of the batch.
            shares: who computes which part.
        """
        members, gradient = self.stack.members, self._adam.gradient

        def found(part: slice) -> Float[Tensor, " value"]:
            if part.start == part.stop:
                return gradient.new_zeros(members + len(gradient))
            return torch.cat([compute(part), gradient])

        total = shares.summed(found, samples)
        gradient.copy_(total[members:])
        self._adam.step()
        return total[:members]

    def update_unrolled(
        self,
        courses: Courses,
        samples: Int64[Tensor, "member sample"],
        weight: Float[Tensor, "member sample"],
        horizon: int,
    ) -> Float[Tensor, " member"]:
        """Train every member on what its own predictions lead to; return the members' losses before the update.

        The loss of a sample is the mean over the steps from it that are known, `horizon` at most. Gradients are
        autograd's, through all steps. Nothing is dropped out.
        """
        self._adam.begin()
        change = partial(self._gradients_unrolled_and_change, courses, horizon)
        if samples.is_cpu:
            return change(samples, weight)
        if self._unrolled is None or self._unrolled[0][0] is not courses or self._unrolled[0][1] != horizon:
            self._unrolled = (courses, horizon), Repeated(change)
        return self._unrolled[1](samples, weight)

    def _gradients_unrolled_and_change(
        self, courses: Courses, horizon: int, samples: Tensor, weight: Tensor
    ) -> Float[Tensor, " member"]:
        losses = self.gradients_unrolled(courses, samples, weight, horizon)
        self._adam.change()
        return losses

    def gradients_unrolled(
        self,
        courses: Courses,
        samples: Int64[Tensor, "member sample"],
        weight: Float[Tensor, "member sample"],
        horizon: int,
    ) -> Float[Tensor, " member"]:
        """Compute the gradient of the summed loss of `update_unrolled`; return the members' losses."""
        parameters = [*self.stack.weights, *self.stack.biases, *self.stack.linear]
        known = courses.steps(samples).clamp(max=horizon).unsqueeze(1)
        steps = torch.arange(horizon, device=known.device).unsqueeze(1)
        share = (weight.unsqueeze(1) * (steps < known) / known).flatten(1, 2)
        with torch.enable_grad():
            output, target = (each.flatten(1, 2) for each in courses.unroll(self.stack.forward_all, samples, horizon))
            losses, derivative = self._loss(output.detach(), target.detach(), share)
            # What is right depends on the states before it, and so on the weights; a loss depends on the difference.
            computed = torch.autograd.grad(output - target, parameters, derivative)
        for place, gradient in zip(self._adam.gradients, computed, strict=True):
            place.copy_(gradient)
        return losses

    @torch.no_grad()
    def gradients(
        self, x: Float[Tensor, "member sample input"], target: Tensor, weight: Float[Tensor, "member sample"]
    ) -> Float[Tensor, " member"]:
        """Compute the gradient of the summed loss by all weights and biases; return the members' losses."""
        return self._gradients(x, target, weight, *self._masks(x))

    def _gradients_and_change(self, x: Tensor, target: Tensor, weight: Tensor, *kept: Tensor) -> Tensor:
        losses = self._gradients(x, target, weight, *kept)
        self._adam.change()
        return losses

    def _gradients(self, x: Tensor, target: Tensor, weight: Tensor, *kept: Tensor) -> Float[Tensor, " member"]:
        """Do what `gradients` does, with what `_masks` has drawn."""
        activate, derive = self._activate, _DERIVATIVES[self.stack.activation]
        members, shared, hidden = self.stack.members, self.stack.shared, x
        # What each layer is given, what that was before dropout, and by what it was multiplied.
        layer_inputs, activations, masks = list[Tensor](), list[Tensor](), list[Tensor | None]()
        for layer, (weights, bias) in enumerate(zip(self._weights, self._biases, strict=True)):
            if layer:
                hidden = activate(hidden)
            activations.append(hidden)
            mask = kept[layer].to(hidden.dtype).div_(self._keep) if kept else None
            if mask is not None:
                hidden = hidden * mask
            masks.append(mask)
            layer_inputs.append(hidden)
            if layer == shared:
                hidden = hidden.expand(members, -1, -1)
            hidden = torch.baddbmm(bias, hidden, weights)
        inputs = x.expand(members, -1, -1)
        for weights in self._linear:
            hidden = torch.baddbmm(hidden, inputs, weights)
        losses, derivative = self._loss(hidden, target, weight)
        for gradient in self._linear_gradients:
            torch.bmm(inputs.transpose(1, 2), derivative, out=gradient)
        for layer in range(len(self._weights) - 1, -1, -1):
            values, weights, mask = layer_inputs[layer], self._weights[layer], masks[layer]
            if layer >= shared:
                values = values.expand(members, -1, -1)
            torch.bmm(values.transpose(1, 2), derivative, out=self._weight_gradients[layer])
            torch.sum(derivative, dim=1, keepdim=True, out=self._bias_gradients[layer])
            if layer:
                derivative = torch.bmm(derivative, weights.transpose(1, 2))
                if layer == shared:
                    derivative = derivative.sum(dim=0, keepdim=True)
                if mask is not None:
                    derivative *= mask
                derivative = derive(derivative, activations[layer])
        return losses

    @property
    def updates(self) -> int:
        """Number of updates made so far."""
        return self._adam.updates

    @property
    def learning_rate(self) -> float:
        """The learning rate of the next update."""
        return self._adam.learning_rate

    def state(self) -> dict[str, Tensor]:
        """Return all that is needed to go on from here, as copies."""
        return self._adam.state()

    def parameters(self) -> Tensor:
        """Return all weights and biases as they are, as a copy in one tensor."""
        return self._adam.parameters()

    def replace(self, parameters: Tensor) -> None:
        """Put others, which `parameters` returned, in their place."""
        self._adam.replace(parameters)

    def restore(self, state: dict[str, Tensor]) -> None:
        """Go on from what `state` returned."""
        self._adam.restore(state)

    def _masks(self, x: Float[Tensor, "*member sample input"]) -> list[Bool[Tensor, "*member sample input"]]:
        """Draw which inputs of each layer are kept; those that are get a factor that keeps the expected sum.

        Nothing is drawn if all are kept. It is drawn on the CPU, by the one generator that draws batches, too.
        """
        if self._keep == 1.0:
            return []
        inner = [
            (1 if layer <= self.stack.shared else self.stack.members, x.shape[1], width)
            for layer, width in enumerate(self.stack.widths[1:-1], start=1)
        ]
        return [
            sent(torch.rand(shape, generator=self._generator) < self._keep, x.device)
            for shape in (tuple(x.shape), *inner)
        ]


def _by_use(tensors: list[Tensor], layers: int) -> tuple[list[Tensor], list[Tensor], list[Tensor]]:
    """Return what belongs to the weights, to the biases and to the linear part, of tensors in this order."""
    return tensors[:layers], tensors[layers : 2 * layers], tensors[2 * layers :]


def _tanh_(values: Tensor) -> Tensor:
    """Replace values by their tanh up to 2e-7, in a fifth of the time that torch.tanh takes."""
    return values.mul_(2.0).sigmoid_().mul_(2.0).sub_(1.0)


_ACTIVATE: dict[Activation, Callable[[Tensor], Tensor]] = {
    "relu": torch.relu_,
    "tanh": _tanh_,
    "elu": nn.functional.elu_,
}
"""The activation functions, in place."""
_ACTIVATE_IN_ONE_LAUNCH: dict[Activation, Callable[[Tensor], Tensor]] = {**_ACTIVATE, "tanh": torch.tanh_}
"""The same where a pass over the values costs more than what is computed of each."""


def _relu_derivative(derivative: Tensor, output: Tensor) -> Tensor:
    return torch.ops.aten.threshold_backward(derivative, output, 0.0)  # type: ignore[no-any-return] # untyped operator


def _tanh_derivative(derivative: Tensor, output: Tensor) -> Tensor:
    return torch.ops.aten.tanh_backward(derivative, output)  # type: ignore[no-any-return] # untyped operator


def _elu_derivative(derivative: Tensor, output: Tensor) -> Tensor:
    return torch.ops.aten.elu_backward(derivative, 1.0, 1.0, 1.0, True, output)  # type: ignore[no-any-return] # as above


_DERIVATIVES: dict[Activation, Callable[[Tensor, Tensor], Tensor]] = {
    "relu": _relu_derivative,
    "tanh": _tanh_derivative,
    "elu": _elu_derivative,
}
