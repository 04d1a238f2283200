"""A GPU for machines without one: its tensors lie on 'pretended:0', are computed on the CPU, and do not mix.

What is checked so: that nothing on the way is made on the CPU, how often the processor waits for the device, that what
is recorded as a CUDA graph does the same when it is done again, and that what comes out is what comes out on the CPU.
What is not: the device's own arithmetic, its memory, and its speed.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_unflatten
from torch.utils.backend_registration import _setup_privateuseone_for_python_backend

from addressed_dynamics.base.torch_runtime import CPU
from addressed_dynamics.training import graphs

# A build without CUDA cannot even index what says that it is there; it can, what is on the backend left to others.
# It has to be known before the first backward pass of the process, which counts the devices.
_setup_privateuseone_for_python_backend("pretended")
GPU = torch.device("pretended", 0)
aten = torch.ops.aten
WAITING = {aten._local_scalar_dense.default, aten.nonzero.default, aten.bincount.default, aten.equal.default,
           aten.masked_select.default}  # fmt: skip
"""What the processor has to wait for, because it is a number, or as many as nobody knows before."""


class OnGpu(torch.Tensor):
    """A tensor of the pretended GPU."""

    held: torch.Tensor

    @staticmethod
    def __new__(cls, held: torch.Tensor) -> "OnGpu":
        made: OnGpu = torch.Tensor._make_wrapper_subclass(
            cls, held.shape, strides=held.stride(), storage_offset=held.storage_offset(), dtype=held.dtype, device=GPU
        )
        made.held = held
        return made

    __torch_function__ = torch._C._disabled_torch_function_impl

    @classmethod
    def __torch_dispatch__(cls, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        message = f"{function} was called of a tensor of the pretended GPU when there is none"
        raise RuntimeError(message)

    @property
    def data(self) -> "OnGpu":
        return OnGpu(self.held)

    @data.setter
    def data(self, other: "OnGpu") -> None:
        self.held = other.held

    def __repr__(self) -> str:  # type: ignore[override] # torch's has an argument
        return f"OnGpu({self.held!r})"


class PretendedGpu(TorchDispatchMode):
    """While it is entered, 'pretended:0' is a device."""

    def __init__(self) -> None:
        super().__init__()
        self.waits = 0
        """How often the processor has waited for the device."""
        self.launches = 0
        """How often it was given something to do."""
        self._recorded: list[tuple[Any, list[Any], list[Any], Any]] | None = None
        self._before: list[tuple[torch.Tensor, torch.Tensor]] = []

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        leaves, structure = tree_flatten((args, kwargs or {}))
        tensors = [each for each in leaves if isinstance(each, torch.Tensor)]
        ours = [each for each in tensors if isinstance(each, OnGpu)]
        target = (kwargs or {}).get("device")
        to_gpu = target is not None and torch.device(target) == GPU
        if function is aten._pin_memory.default:
            pinned = args[0].clone()
            pinned.pinned = True
            return pinned
        if not ours and not to_gpu:
            return function(*args, **(kwargs or {}))
        moves = function in (aten._to_copy.default, aten.copy_.default)
        from_cpu = [each for each in tensors if not isinstance(each, OnGpu)]
        if moves and from_cpu and not (target is not None and torch.device(target).type == "cpu"):
            source = args[-1] if function is aten.copy_.default else args[0]
            if not isinstance(source, OnGpu):
                self._wait(unless=getattr(source, "pinned", False) and (kwargs or {}).get("non_blocking", False))
        to_cpu = function is aten.copy_.default and not isinstance(args[0], OnGpu)
        if moves and (to_cpu or (target is not None and not to_gpu)):
            self._wait()
            ours_out = False
        else:
            ours_out = True
            if not moves and any(each.ndim for each in from_cpu):
                message = f"{function}: expected all tensors to be on the same device, but found {GPU} and cpu"
                raise RuntimeError(message)
        if any(isinstance(each, torch.Generator) for each in leaves):
            message = f"{function}: expected a generator of {GPU}"
            raise RuntimeError(message)
        of_mask = function in (aten.index.Tensor, aten.index_put_.default) and any(
            each is not None and each.dtype == torch.bool for each in args[1]
        )
        if function in WAITING or of_mask:
            self._wait()
        held = [
            each.held if isinstance(each, OnGpu) else CPU if isinstance(each, torch.device) else each for each in leaves
        ]
        inner, inner_kwargs = tree_unflatten(held, structure)
        self.launches += 1
        if self._recorded is not None:
            self._keep(function, inner, inner_kwargs)
        found = function(*inner, **inner_kwargs)
        if self._recorded is not None:
            self._recorded.append((function, held, structure, found))
        if not ours_out:
            return found
        names = {id(each.held): each for each in ours}
        out, shape = tree_flatten(found)
        return tree_unflatten(
            [names.get(id(each), OnGpu(each)) if isinstance(each, torch.Tensor) else each for each in out], shape
        )

    def capture(self, function: Callable[[], torch.Tensor]) -> tuple[Callable[[], object], torch.Tensor]:
        """Do what `graphs.capture` does: record, without doing it."""
        self._recorded, self._before = [], []
        try:
            result = function()
        finally:
            recorded, self._recorded = self._recorded, None
            for place, values in reversed(self._before):
                place.copy_(values)

        def replay() -> None:
            self.launches += 1
            with torch.no_grad():
                for again, leaves, structure, found in recorded:
                    inner, inner_kwargs = tree_unflatten(leaves, structure)
                    _put(again(*inner, **inner_kwargs), found)

        return replay, result

    def _keep(self, function: Any, inner: Any, inner_kwargs: Any) -> None:
        """Keep what a function is about to change, to be put back: what is recorded is not done."""
        for argument, value in zip(function._schema.arguments, inner, strict=False):
            if argument.alias_info is not None and argument.alias_info.is_write:
                self._before += [(each, each.clone()) for each in (value if isinstance(value, list) else [value])]
        for argument in function._schema.arguments:
            if argument.name in inner_kwargs and argument.alias_info is not None and argument.alias_info.is_write:
                value = inner_kwargs[argument.name]
                self._before.append((value, value.clone()))

    def _wait(self, *, unless: bool = False) -> None:
        if unless:
            return
        if self._recorded is not None:
            message = "a graph cannot be recorded of what the processor waits for"
            raise RuntimeError(message)
        self.waits += 1


def _put(computed: Any, found: Any) -> None:
    """Write what was computed again to where it was found first, unless it is there."""
    for new, place in zip(tree_flatten(computed)[0], tree_flatten(found)[0], strict=True):
        if isinstance(new, torch.Tensor) and new.untyped_storage().data_ptr() != place.untyped_storage().data_ptr():
            place.copy_(new)


@contextmanager
def pretended_gpu() -> Iterator[PretendedGpu]:
    """Let there be a GPU meanwhile."""
    with pytest.MonkeyPatch.context() as patch:
        gpu = PretendedGpu()
        patch.setattr(graphs, "capture", gpu.capture)
        with gpu:
            yield gpu


NO_GPU = "there is no GPU here, so what one computes itself is not looked at"
GPUS = pytest.mark.parametrize(
    "kind",
    ["pretended", pytest.param("real", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason=NO_GPU))],
)
"""For tests of a GPU that is pretended and of a real one."""


@contextmanager
def gpu(kind: str) -> Iterator[torch.device]:
    """Yield the device of that kind."""
    if kind == "pretended":
        with pretended_gpu():
            yield GPU
    else:
        yield torch.device("cuda", 0)
