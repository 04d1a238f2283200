"""The same work on many items at once, in worker processes that a Ctrl-C leaves no trace of.

Worker processes are forked from one that has imported what this process had of the package when it started its first,
and has done nothing else: to import PyTorch takes longer than many a piece of work.
"""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.context import ForkServerContext
from multiprocessing.process import BaseProcess
from typing import Protocol, TypeVar

from addressed_dynamics.base.cluster import cluster_map, engine
from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.base.failures import Failure

_UNKNOWN = 255
"""Exit code that Python gives a worker when the server that forked it is gone, which alone knew it."""
Item = TypeVar("Item")
Result = TypeVar("Result")


class OrderedMap(Protocol):
    """Computes a function of each item and yields the results in the order of the items."""

    def __call__(self, function: Callable[[Item], Result], items: Sequence[Item], /) -> Iterator[Result]:
        """Yield `function(item)` of each item."""


def death(exit_code: int | None) -> str:
    """Say how a worker process ended that left without a word, and what to do, from its exit code."""
    match exit_code:
        case None:
            return "died; run the stage again"
        case _ if exit_code == _UNKNOWN:
            return "ended with the server that had forked it, or without a word; run the stage again"
        case _ if exit_code == -signal.SIGKILL:
            return "was killed (SIGKILL), perhaps for lack of memory; run the stage again"
        case _ if exit_code < 0:
            return f"was killed ({_signal_name(-exit_code)}); run the stage again"
        case _:
            return f"ended by itself with exit status {exit_code}, which is a bug: what it wrote above says where"


def worker_context() -> ForkServerContext:
    """Return how worker processes are started."""
    context = multiprocessing.get_context("forkserver")
    package = __name__.partition(".")[0]
    # Of no effect once the server runs.
    context.set_forkserver_preload([name for name in list(sys.modules) if name.partition(".")[0] == package])
    return context


@contextmanager
def starting_workers() -> Iterator[None]:
    """Start processes within this block: none of them hears Ctrl-C, which a terminal sends to every process.

    This process alone decides then; each of the others would show a traceback. They begin with the signal blocked; for
    this one it is only held back.

    Raises:
        AddressedDynamicsError: the server that forks them was killed meanwhile.
    """
    # The server of the workers needs the tracker, which unblocks the signal when it starts; so it has to run before.
    resource_tracker.ensure_running()
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    except (EOFError, ConnectionError) as error:
        message = "the server that forks worker processes ended while it was asked for one; run the stage again"
        raise AddressedDynamicsError(message) from error
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)


@contextmanager
def worker_processes(count: int) -> Iterator[OrderedMap]:
    """Yield a `map` that `count` worker processes carry out; with one, this process does it itself.

    If the environment asks for Ray, its tasks do, as many at once as the cluster has cores.

    An exception in a worker is raised here, as it is there. When the block is left early, by an exception in a worker
    or by Ctrl-C, items that have not begun are dropped and the others are waited for.

    Raises:
        AddressedDynamicsError: a worker process died without an exception; the message says by which signal. Or Ray
            cannot be used: see `cluster_map`.
    """
    if (cluster := engine()) is not None:
        with cluster_map(cluster) as ordered_map:
            yield ordered_map
        return
    if count == 1:
        yield map
        return
    pool = ProcessPoolExecutor(max_workers=count, mp_context=worker_context())
    others, workers = set(multiprocessing.active_children()), set[BaseProcess]()

    def map_in_pool(function: Callable[[Item], Result], items: Sequence[Item], /) -> Iterator[Result]:
        futures = _submit(pool, partial(_call, function), items)
        workers.update(set(multiprocessing.active_children()) - others)
        for future in futures:
            result: Result | Failure = pickle.loads(future.result())
            if isinstance(result, Failure):
                raise result.exception()
            yield result

    try:
        yield map_in_pool
    except BrokenProcessPool as error:
        pool.shutdown(wait=True, cancel_futures=True)
        message = f"one of {count} worker processes {death(_first_exit_code(workers))}"
        raise AddressedDynamicsError(message) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _call(function: Callable[[Item], Result], item: Item) -> bytes:
    """Return the pickled result or `Failure`: the pool would die of one that it cannot unpickle."""
    try:
        return pickle.dumps(function(item))
    except Exception as error:
        return pickle.dumps(Failure.of(error))


def _first_exit_code(workers: Iterable[BaseProcess]) -> int | None:
    """Return the exit code of the worker that broke the pool: the pool then terminates the others with SIGTERM."""
    codes = [worker.exitcode for worker in workers if worker.exitcode]
    return next((code for code in codes if code != -signal.SIGTERM), codes[0] if codes else None)


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _submit(
    pool: ProcessPoolExecutor, function: Callable[[Item], Result], items: Sequence[Item]
) -> list[Future[Result]]:
    with starting_workers():
        return [pool.submit(function, item) for item in items]
