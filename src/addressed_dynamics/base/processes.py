"""The same work on many items at once, in worker processes that a Ctrl-C leaves no trace of."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing.process import BaseProcess
from typing import Protocol, TypeVar

from addressed_dynamics.base.errors import AddressedDynamicsError

Item = TypeVar("Item")
Result = TypeVar("Result")


class OrderedMap(Protocol):
    """Computes a function of each item and yields the results in the order of the items."""

    def __call__(self, function: Callable[[Item], Result], items: Sequence[Item], /) -> Iterator[Result]:
        """Yield `function(item)` of each item."""


class WorkerTraceback(Exception):
    """The traceback of an exception in a worker process, as text: the cause that the parent shows for it."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


@dataclass(frozen=True)
class Failure:
    """An exception on its way from a worker process to its parent. Always picklable, whatever the exception is."""

    summary: str
    """Its type and message, and the line that raised it."""
    traceback: str
    """The traceback in the worker process."""
    pickled: bytes | None
    """The exception itself; None if it does not survive pickling."""

    @staticmethod
    def of(error: Exception) -> Failure:
        """Describe `error`, which has been caught."""
        frames = traceback.extract_tb(error.__traceback__)
        where = f" ({frames[-1].filename}, line {frames[-1].lineno}, in {frames[-1].name})" if frames else ""
        text = "".join(traceback.format_exception(error))
        return Failure(f"{type(error).__qualname__}: {error}{where}", text, _pickled(error))

    def exception(self) -> Exception:
        """Return the exception to raise in the parent, with the worker's traceback as its cause.

        One that does not survive pickling becomes a RuntimeError with its type, its message and where it was raised.
        """
        error: Exception = RuntimeError(self.summary) if self.pickled is None else pickle.loads(self.pickled)
        error.__cause__ = WorkerTraceback(self.traceback)
        return error


def death(exit_code: int | None) -> str:
    """Say how a worker process ended that left without a word, and what to do, from its exit code."""
    match exit_code:
        case None:
            return "died; run the stage again"
        case _ if exit_code == -signal.SIGKILL:
            return "was killed (SIGKILL), perhaps for lack of memory; run the stage again"
        case _ if exit_code < 0:
            return f"was killed ({_signal_name(-exit_code)}); run the stage again"
        case _:
            return f"ended by itself with exit status {exit_code}, which is a bug: what it wrote above says where"


@contextmanager
def worker_processes(count: int) -> Iterator[OrderedMap]:
    """Yield a `map` that `count` worker processes carry out; with one, this process does it itself.

    An exception in a worker is raised here, as it is there. When the block is left early, by an exception in a worker
    or by Ctrl-C, items that have not begun are dropped and the others are waited for.

    Raises:
        AddressedDynamicsError: a worker process died without an exception; the message says by which signal.
    """
    if count == 1:
        yield map
        return
    pool = ProcessPoolExecutor(max_workers=count, mp_context=multiprocessing.get_context("spawn"))
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


def _pickled(error: Exception) -> bytes | None:
    try:
        pickled = pickle.dumps(error)
        again = pickle.loads(pickled)
    except Exception:
        return None
    return pickled if type(again) is type(error) and str(again) == str(error) else None


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
    # A terminal sends Ctrl-C to every process. Workers begin with it blocked and so leave it to this process; each of
    # them would show a traceback otherwise.
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return [pool.submit(function, item) for item in items]
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)
