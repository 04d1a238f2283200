"""What training asks of the process it runs in: threads, a device, denormal numbers, named sources of randomness.

Where there is a GPU, the environment variable `ADDRESSED_DYNAMICS_DEVICE` lets work be done on it. It is no param: what
comes out is the same up to rounding (docs/decisions/0037-device.md).
"""

import hashlib
import os
import re

import torch
from torch import Tensor

from addressed_dynamics.base.cluster import ENGINE, engine
from addressed_dynamics.base.errors import DeviceError, ParamsError

DEVICE = "ADDRESSED_DYNAMICS_DEVICE"
"""Environment variable: `cpu`, as without it; `cuda`, for the first GPU; `cuda:1`, for another."""
MOST_GPUS = 128
"""PyTorch keeps a GPU's number in 8 bits: it would take number 300 for 44."""
CPU = torch.device("cpu")
"""Where everything is computed unless something else is asked for."""


def prepare_torch(threads: int) -> None:
    """Set torch's threads on purpose, and let denormal numbers be zero.

    Adam's averages of units that have died decay into the denormal range, where this kind of processor is ten times
    slower (measured: docs/decisions/0004-denormals.md).

    Products are of float32, not of TF32, whose ten bits are fewer than a loss differs by. Where a GPU is asked for, it
    adds up in the same order every time, wherever torch has such a way.

    Raises:
        ParamsError: the environment asks for a device of another kind.
    """
    asked = _asked_device()
    torch.set_num_threads(threads)
    torch.set_flush_denormal(True)
    torch.set_float32_matmul_precision("highest")
    if asked.type == "cuda":
        # cuBLAS reads it when it is first used.
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
        # What has no such way is said by a warning. Memory is written before it is read: to fill it costs launches.
        torch.use_deterministic_algorithms(True, warn_only=True)
        torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined] # set on the module


def computing_device() -> torch.device:
    """Return the device that the environment asks for: the CPU, or a GPU, which is there.

    Raises:
        ParamsError: the environment asks for a device of another kind, for a GPU and Ray, or for no engine that is.
        DeviceError: this build of torch has no GPUs, or the machine has no such GPU.
    """
    device, cluster = _asked_device(), engine()
    if device.type != "cpu" and cluster is not None:
        message = f"{DEVICE} is '{device}', but tasks of Ray are given no GPU; unset it, or {ENGINE}"
        raise ParamsError(message)
    return checked_device(device, DEVICE, f"unset {DEVICE}")


def named_device(name: str, asked_by: str = "device=") -> torch.device:
    """Return the device of a name, whether it is there or not.

    Args:
        name: `cpu`, `cuda`, or `cuda:1` for another GPU than the first.
        asked_by: what asks for it, for the message.

    Raises:
        ParamsError: there is no device of this name.
    """
    found = re.fullmatch(r"cpu|cuda(?::(\d+))?", name)
    if found is None or int(found[1] or 0) >= MOST_GPUS:
        message = f"{asked_by} should be 'cpu', 'cuda' or 'cuda:NUMBER', but is '{name}'"
        if found is not None:
            message += f"; PyTorch counts GPUs from 0 to {MOST_GPUS - 1}"
        raise ParamsError(message)
    return CPU if name == "cpu" else torch.device("cuda", int(found[1] or 0))


def checked_device(
    device: torch.device | str, asked_by: str = "device=", otherwise: str = "leave device= out"
) -> torch.device:
    """Return a device that is there, with its number.

    Args:
        device: which one, for instance `cuda`.
        asked_by: what asks for it, for the message.
        otherwise: what to do to get the CPU, for the message.

    Raises:
        ParamsError: there is no device of this name.
        DeviceError: this build of torch has no GPUs, or the machine has no such GPU.
    """
    device = named_device(device, asked_by) if isinstance(device, str) else device
    if device.type != "cuda":
        return device
    device = torch.device("cuda", device.index or 0)
    cpu = f"or {otherwise} for the CPU"
    built = torch.version.cuda or torch.version.hip
    if built is None:
        message = (
            f"{asked_by} asks for '{device}', but torch {torch.__version__} is a build without CUDA; install one with "
            f"it (https://pytorch.org/get-started/locally), {cpu}"
        )
        raise DeviceError(message)
    if not torch.cuda.is_available():
        message = (
            f"{asked_by} asks for '{device}', but torch {torch.__version__} (CUDA {built}) finds no GPU that it can "
            f"use; look at what 'nvidia-smi' says of driver and GPUs, {cpu}"
        )
        raise DeviceError(message)
    count = torch.cuda.device_count()
    if device.index >= count:
        message = (
            f"{asked_by} asks for '{device}', but there are GPUs 0 to {count - 1} only; ask for one of them, {cpu}"
        )
        raise DeviceError(message)
    return device


def sent(tensor: Tensor, device: torch.device) -> Tensor:
    """Return a tensor of the CPU on a device, without waiting for what that has still to do."""
    # From memory that may be swapped out a GPU copies only when it has done everything else.
    return tensor if device.type == "cpu" else tensor.pin_memory().to(device, non_blocking=True)


def named_generator(seed: int, name: str) -> torch.Generator:
    """Return a random generator for one purpose, independent of those with other names and seeds.

    It is one of the CPU, wherever what it draws is used: so the same is drawn on every device.
    """
    digest = hashlib.blake2b(f"{seed}/{name}".encode(), digest_size=8).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest, "little") >> 1)


def _asked_device() -> torch.device:
    return named_device(os.environ.get(DEVICE, "cpu"), DEVICE)
