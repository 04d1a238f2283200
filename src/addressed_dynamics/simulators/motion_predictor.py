"""What a model of motion is to the evaluation: a function."""

from collections.abc import Callable

from jaxtyping import Float
from torch import Tensor

MotionPredictor = Callable[[Float[Tensor, "run 342"], Float[Tensor, " run"]], Float[Tensor, "run 311"]]
"""(inputs as in `layout.INPUT`, phases in [0, 1)) -> outputs as in `layout.OUTPUT`; float32 and not normalised. Models
that do without the phase ignore it."""
