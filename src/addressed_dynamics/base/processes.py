"""The same work on many items at once, in worker processes that a Ctrl-C leaves no trace of."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Protocol, TypeVar

from addressed_dynamics.base.errors import AddressedDynamicsError

Item = TypeVar("Item")
Result = TypeVar("Result")


class OrderedMap(Protocol):
    """Computes a function of each item and yields the results in the order of the items."""

    def __call__(self, function: Callable[[Item], Result], items: Sequence[Item], /) -> Iterator[Result]:
        """Yield `function(item)` of each item."""


@contextmanager
def worker_processes(count: int) -> Iterator[OrderedMap]:
    """Yield a `map` that `count` worker processes carry out; with one, this process does it itself.

    When the block is left early, by an exception in a worker or by Ctrl-C, items that have not begun are dropped and
    the others are waited for.

    Raises:
        AddressedDynamicsError: a worker process died, for instance for lack of memory.
    """
    if count == 1:
        yield map
        return
    pool = ProcessPoolExecutor(max_workers=count, mp_context=multiprocessing.get_context("spawn"))

    def map_in_pool(function: Callable[[Item], Result], items: Sequence[Item], /) -> Iterator[Result]:
        for future in _submit(pool, function, items):
            yield future.result()

    try:
        yield map_in_pool
    except BrokenProcessPool as error:
        message = f"one of {count} worker processes died (killed, perhaps for lack of memory); run the stage again"
        raise AddressedDynamicsError(message) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _submit(
    pool: ProcessPoolExecutor, function: Callable[[Item], Result], items: Sequence[Item]
) -> list[Future[Result]]:
    # A terminal sends Ctrl-C to every process. Workers begin with it blocked and so leave it to this process; each of
    # them would show a traceback otherwise.
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return [pool.submit(function, item) for item in items]
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)
