"""What models take: tensors, arrays or lists, of many samples or of one; and what they answer with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from addressed_dynamics.base.errors import ModelError

Plain: TypeAlias = "np.ndarray | Sequence[Any]"
"""Arrays and lists, which are answered with arrays."""
Values: TypeAlias = "Plain | Tensor"
"""These, and tensors, which are answered with tensors."""
SHOWN_NAMES = 8
"""Names that the `repr` of a model shows of a kind."""
_TAKEN = "a model takes tensors, arrays or lists of numbers"


def as_tensor(values: Values) -> Tensor:
    """Return the values as a tensor that has no gradient.

    Raises:
        ModelError: they are no real numbers, lists of different lengths, or a tensor that is sparse or not on the CPU.
    """
    if isinstance(values, Tensor):
        return _checked(values)
    try:
        array = np.array(values, order="C")
    except (ValueError, TypeError, RuntimeError) as error:
        ragged = "lists of different lengths" if isinstance(error, ValueError) else f"something else ({error})"
        message = f"{_TAKEN}, but was given {ragged}"
        raise ModelError(message) from error
    if array.dtype.kind not in "biuf":
        message = f"{_TAKEN}, but was given values of type '{array.dtype}'"
        raise ModelError(message)
    if not array.size and not isinstance(values, np.ndarray):
        # An empty list says nothing of its type: NumPy calls it float64, which would be no action.
        array = array.astype(np.int64)
    # PyTorch knows neither other byte orders nor long doubles, and can do little with large unsigned integers.
    known = {"u": np.int64, "f": np.float64}.get(array.dtype.kind) if array.dtype.char not in "Befd" else None
    return torch.from_numpy(array.astype(array.dtype.newbyteorder("=") if known is None else known, copy=False))


def finite(values: Tensor, what: str) -> Float32[Tensor, ...]:
    """Return values as float32.

    Args:
        values: numbers, one row a sample.
        what: what they are, in the plural, for the error.

    Raises:
        ModelError: one is not finite, or too large for float32.
    """
    numbers = values.to(torch.float32)
    good = np.isfinite(numbers.numpy())
    if not good.all():
        place = tuple(np.argwhere(~good)[0].tolist())
        message = (
            f"{what} should be finite and fit float32, but [{', '.join(map(str, place))}] is {float(values[place]):g}; "
            "drop the sample, or fill in what is missing"
        )
        raise ModelError(message)
    return numbers


def answer(result: Tensor | np.ndarray, values: Values, *, single: bool, axis: int = 0) -> Tensor | np.ndarray:
    """Return a result as what was asked for with `values`: a tensor or an array, of one sample if one was given.

    Args:
        result: what a model says of a batch.
        values: what it was given.
        single: whether that was one sample.
        axis: that of samples in `result`.
    """
    array = result.numpy() if isinstance(result, Tensor) else result
    if single:
        array = (np.moveaxis(array, axis, 0) if axis else array)[0, ...]
    return torch.from_numpy(array) if isinstance(values, Tensor) else array


def shown_names(names: Sequence[str]) -> str:
    """Return names in a row, and of many only how many more there are."""
    left = len(names) - SHOWN_NAMES
    return ", ".join(names[:SHOWN_NAMES]) + (f" and {left} more" if left > 0 else "")


def _checked(values: Tensor) -> Tensor:
    if values.is_complex() or values.is_quantized or values.layout != torch.strided or values.device.type != "cpu":
        found = f"a tensor of {values.dtype}, {values.layout}, on '{values.device}'"
        message = f"{_TAKEN}, dense and on the CPU, but was given {found}; convert it first"
        raise ModelError(message)
    # PyTorch can do little with large unsigned integers.
    large = values.dtype in (torch.uint16, torch.uint32, torch.uint64)
    return values.detach().to(torch.int64) if large else values.detach()
