"""Several trainings at the same time, each in a process of its own, their epochs as one stream."""

import multiprocessing
import os
import pickle
import threading
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerProcess

from addressed_dynamics.base.cluster import cluster_streams, engine
from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.failures import Failure
from addressed_dynamics.base.processes import death, starting_workers, worker_context
from addressed_dynamics.base.torch_runtime import prepare_torch
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.training.epochs import Epoch

Job = Callable[[], Iterator[Epoch]]
"""A training to run: picklable, for instance a `functools.partial` of a training loop."""


def run_jobs(jobs: Mapping[str, Job], *, processes: int, workers: int = 1) -> Iterator[tuple[str, Epoch]]:
    """Run the jobs, at most `processes` at a time and each on one thread; yield (name, epoch) as epochs end.

    A job gives the same result whatever runs beside it. The network of an epoch is whole only in a job's last epoch if
    there is more than one process. Leaving the loop ends all jobs.

    If the environment asks for Ray, every job is one of its tasks, as many at once as the cluster has cores. A job
    whose worker or machine is lost begins anew there, from its checkpoint if it has one. Every job is then run by
    `workers` tasks together, which divide its batches (`training.shares`); here, by one.

    Raises:
        AddressedDynamicsError: what a job raised; any other exception of a job comes through too, as it is.
        TrainingError: the process of a job died without an exception; the message says by which signal.
        ClusterError: Ray cannot be used, or lost a job too often.
    """
    if (cluster := engine()) is not None:
        with cluster_streams(cluster, {name: partial(_alone, job) for name, job in jobs.items()}, workers) as epochs:
            yield from epochs
        return
    if processes == 1 or len(jobs) == 1:
        for name, job in jobs.items():
            for epoch in job():
                yield name, epoch
        return
    waiting, running = list(jobs.items()), dict[Connection, tuple[str, ForkServerProcess]]()
    try:
        while waiting or running:
            while waiting and len(running) < processes:
                name, job = waiting.pop(0)
                receiver, process = _start(job)
                running[receiver] = (name, process)
            ready = wait(list(running))
            for receiver in [connection for connection in running if connection in ready]:
                name, process = running[receiver]
                try:
                    message = pickle.loads(receiver.recv_bytes())
                except EOFError:
                    process.join()
                    text = f"the process that trained '{name}' {death(process.exitcode)}"
                    raise TrainingError(text) from None
                if isinstance(message, Failure):
                    raise message.exception()
                if message is None:
                    process.join()
                    del running[receiver]
                else:
                    yield name, message
    finally:
        for _, process in running.values():
            process.terminate()
            process.join()


def _start(job: Job) -> tuple[Connection, ForkServerProcess]:
    context = worker_context()
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(job, sender), daemon=True)
    with starting_workers():
        process.start()
    sender.close()
    return receiver, process


def _work(job: Job, sender: Connection) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        for epoch in _alone(job):
            _send(sender, epoch)
        _send(sender, None)
    except BrokenPipeError:
        return  # the parent is gone; the checkpoint holds the last finished epoch
    except Exception as error:
        _send(sender, Failure.of(error))


def _alone(job: Job) -> Iterator[Epoch]:
    """Yield what a job yields in a process of its own: on one thread, with the networks of its last epoch alone."""
    prepare_torch(threads=1)
    for epoch in job():
        yield epoch if epoch.last else _without_weights(epoch)


def _end_with_parent() -> None:
    """End this process when the parent is gone, even by kill -9: nobody would read what it finds."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)


def _send(sender: Connection, message: Epoch | Failure | None) -> None:
    # Connection.send would put tensors into shared memory, which is gone when this process ends before they are read.
    sender.send_bytes(pickle.dumps(message))


def _without_weights(epoch: Epoch) -> Epoch:
    return Epoch(epoch.index, epoch.last, epoch.updates, epoch.metrics, StackedMLP(1, (1, 1), "relu"), epoch.samples)
