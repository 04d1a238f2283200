"""What models take: tensors, arrays or lists, of many samples or of one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from torch import Tensor, from_numpy

from addressed_dynamics.base.errors import ModelError

Plain: TypeAlias = "np.ndarray | Sequence[Any]"
"""Arrays and lists, which are answered with arrays."""
Values: TypeAlias = "Plain | Tensor"
"""These, and tensors, which are answered with tensors."""


def as_tensor(values: Values) -> Tensor:
    """Return the values as a tensor.

    Raises:
        ModelError: they are no numbers, or lists of different lengths.
    """
    if isinstance(values, Tensor):
        return values
    try:
        array = np.array(values, order="C")
    except ValueError as error:
        message = "a model takes tensors, arrays or lists of numbers, but was given lists of different lengths"
        raise ModelError(message) from error
    if array.dtype.kind not in "biuf":
        message = f"a model takes tensors, arrays or lists of numbers, but was given values of type '{array.dtype}'"
        raise ModelError(message)
    return from_numpy(array)


def answer(result: Tensor, values: Values, *, single: bool) -> Tensor | np.ndarray:
    """Return a result, (B, …), as what was asked for with `values`: a tensor or an array, of one sample if one was."""
    shown = result[0] if single else result
    return shown if isinstance(values, Tensor) else shown.numpy()
