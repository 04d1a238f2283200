"""Updates on a GPU as CUDA graphs: what is launched kernel by kernel the first time is launched as one from then on.

An update of small networks is tens of kernels that each take less time than their launch.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import torch
from torch import Tensor

Replay: TypeAlias = "Callable[[], object]"
"""Does again what was captured, on the same memory."""


def capture(function: Callable[[], Tensor]) -> tuple[Replay, Tensor]:
    """Record what `function` does on a GPU without doing it; return how it is done, and where its result will be."""
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        result = function()
    return graph.replay, result


class Repeated:
    """A function that is called with tensors of the same shapes again and again, and then costs a GPU one launch.

    The first call of each shape is made as it is: libraries make ready what they need, which cannot be recorded. The
    second is recorded. From then on nothing of the function is run but what it does on the device: numbers that change
    have to be in tensors that stay where they are.
    """

    def __init__(self, function: Callable[..., Tensor]) -> None:
        """Prepare to repeat `function`, which takes tensors of one device and returns one."""
        self._function = function
        self._known: dict[tuple[torch.Size, ...], tuple[Replay, list[Tensor], Tensor] | None] = {}

    def __call__(self, *given: Tensor) -> Tensor:
        """Return what the function does."""
        shapes = tuple(each.shape for each in given)
        if shapes not in self._known:
            self._known[shapes] = None
            return self._function(*given)
        known = self._known[shapes]
        if known is None:
            places = [each.clone(memory_format=torch.contiguous_format) for each in given]
            replay, result = capture(partial(self._function, *places))
            known = self._known[shapes] = (replay, places, result)
        else:
            replay, places, result = known
            for place, each in zip(places, given, strict=True):
                place.copy_(each)
        replay()
        # The next call writes to the same place.
        return result.clone()
