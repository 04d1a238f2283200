"""One training on several machines: the work on a batch in shares, each done by the process whose it is.

The sum over the shares is always taken in their order, and what is computed of samples block by block is computed of
the same blocks. So what comes out depends on the number of shares, a param, and not on that of the processes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.distributed as dist
from jaxtyping import Float
from torch import Tensor

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.networks.stacked import CHUNK_ROWS


@dataclass(frozen=True)
class Shares:
    """Into how many parts a batch is divided, and which of them are this process's."""

    count: int = 1
    """Parts of a batch."""
    workers: int = 1
    """Processes that do them; their number divides that of the parts."""
    rank: int = 0
    """Which of the processes this is."""

    @staticmethod
    def here(count: int) -> Shares:
        """Return the shares of this process, as `torch.distributed` has it if it is initialised.

        Raises:
            TrainingError: so many processes cannot have as many shares each.
        """
        if not dist.is_available() or not dist.is_initialized():
            return Shares(count)
        workers = dist.get_world_size()
        if count % workers:
            message = (
                f"ensemble.shares is {count}, which {workers} workers cannot divide among them; set it to a multiple "
                f"of {workers}, or ask for as many workers as divide it"
            )
            raise TrainingError(message)
        return Shares(count, workers, dist.get_rank())

    @property
    def leads(self) -> bool:
        """Whether this process keeps what all of them find."""
        return self.rank == 0

    def summed(self, compute: Callable[[slice], Float[Tensor, " value"]], samples: int) -> Float[Tensor, " value"]:
        """Return the sum of what `compute` finds for each part of a batch of so many samples; some may be empty."""
        bounds = [part * samples // self.count for part in range(self.count + 1)]
        each = self.count // self.workers
        own = [
            compute(slice(bounds[part], bounds[part + 1])) for part in range(self.rank * each, (self.rank + 1) * each)
        ]
        first, *others = self._gathered(torch.stack(own)).unbind()
        total = first.clone()
        for other in others:
            total += other
        return total

    def of_all(
        self, compute: Callable[[range], Float[Tensor, "part value"]], samples: int
    ) -> Float[Tensor, "sample value"]:
        """Return what `compute` finds for all samples, each found by one of the processes.

        `compute` is given consecutive samples that begin with a block of `CHUNK_ROWS`: what it does block by block, it
        does for the same blocks whatever the number of processes.
        """
        if self.workers == 1:
            return compute(range(samples))
        blocks = -(-samples // CHUNK_ROWS)
        longest = -(-blocks // self.workers) * CHUNK_ROWS
        found = compute(range(samples)[self.rank * longest : (self.rank + 1) * longest])
        padded = found.new_zeros(longest, *found.shape[1:])
        padded[: len(found)] = found
        return self._gathered(padded)[:samples]

    def _gathered(self, own: Float[Tensor, "own ..."]) -> Float[Tensor, "all ..."]:
        """Return what all processes have, in the order of their ranks."""
        if self.workers == 1:
            return own
        # The group is one of processors.
        sent = own.cpu().contiguous()
        parts = [torch.empty_like(sent) for _ in range(self.workers)]
        dist.all_gather(parts, sent)
        return torch.cat(parts).to(own.device)


ALONE = Shares()
"""One process, whose work is not divided."""
