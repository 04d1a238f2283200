"""What may be done to a batch before a network sees it, so that it learns to do without what it cannot rely on."""

from collections.abc import Callable

import torch
from torch import Tensor

Augment = Callable[[Tensor, Tensor, torch.Generator], tuple[Tensor, Tensor]]
"""(inputs (..., input), targets (..., output), source of randomness) -> new inputs and targets of the same shapes."""
