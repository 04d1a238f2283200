"""What training asks of the process it runs in: threads, denormal numbers, named sources of randomness."""

import hashlib

import torch


def prepare_torch(threads: int) -> None:
    """Set torch's threads on purpose, and let denormal numbers be zero.

    Adam's averages of units that have died decay into the denormal range, where this kind of processor is ten times
    slower (measured: docs/decisions/0004-denormals.md).
    """
    torch.set_num_threads(threads)
    torch.set_flush_denormal(True)


def named_generator(seed: int, name: str) -> torch.Generator:
    """Return a random generator for one purpose, independent of those with other names and seeds."""
    digest = hashlib.blake2b(f"{seed}/{name}".encode(), digest_size=8).digest()
    return torch.Generator().manual_seed(int.from_bytes(digest, "little") >> 1)
