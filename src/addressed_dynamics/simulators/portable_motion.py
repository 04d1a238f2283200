"""A model of motion as one torch module from raw numbers to raw numbers."""

from typing import final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from addressed_dynamics.networks.spline import catmull_rom
from addressed_dynamics.simulators.motion import MotionMode, MotionModel
from addressed_dynamics.simulators.portable import check_function, combined_output


@final
class MotionModule(nn.Module):
    """Maps the inputs of frames (and phases, if the model has one) to their outputs, in the model's own mode.

    As `StepModule`, it evaluates every member; up to rounding, the result is that of `MotionModel.predict`.
    """

    def __init__(self, model: MotionModel) -> None:
        """Take a model apart.

        Raises:
            ModelError: its mode is `sample`, and what is drawn is no function.
        """
        super().__init__()
        check_function(model.mode, model.addressing)
        self.mode: MotionMode = model.mode
        self.features = model.features
        rows = torch.zeros(1, self.features.inputs)
        self.features.decode(
            torch.zeros(1, self.features.outputs), rows + self.features.encode(rows)
        )  # made before a tracer could
        self.networks = model.networks
        self.addressing = model.addressing

    def forward(self, x: Float[Tensor, "row 342"], phase: Tensor | None = None) -> Float[Tensor, "row 311"]:
        """Return outputs, (B, 311).

        Args:
            x: inputs, (B, 342), in their own units.
            phase: phases, (B,), in cycles, if the mode is `phase`; else None.
        """
        encoded = self.features.encode(x)
        if self.mode == "phase":
            assert phase is not None
            output = self.networks.forward_blended(encoded, catmull_rom(phase))
        else:
            output = combined_output(self.networks, self.addressing, self.mode, encoded)
        return self.features.decode(output, x)
