import multiprocessing
import os
import signal
from collections.abc import Iterator
from functools import partial

import pytest
from learning import ENSEMBLE, car_samples

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.training.ensemble import train_ensemble
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.jobs import run_jobs

NOTHING = StackedMLP(1, (1, 1), "relu")


def ensemble_job(seed: int) -> Iterator[Epoch]:
    _, train, validation = car_samples()
    return train_ensemble(train, validation, ENSEMBLE, seed=seed, loss_unit=1.0)


def endless_job(seed: int) -> Iterator[Epoch]:
    os.kill(os.getpid(), signal.SIGINT)  # as a terminal does, which sends Ctrl-C to every process
    index = 0
    while True:
        index += 1
        yield Epoch(index, False, index, {"process": os.getpid(), "seed": seed}, NOTHING)


def failing_job() -> Iterator[Epoch]:
    yield Epoch(1, False, 1, {}, NOTHING)
    message = "the training loss is not finite any more"
    raise TrainingError(message)


def buggy_job() -> Iterator[Epoch]:
    yield Epoch(1, False, 1, {}, NOTHING)
    {}["loss"]


def leaving_job() -> Iterator[Epoch]:
    yield Epoch(1, False, 1, {}, NOTHING)
    os._exit(3)


def killed_job() -> Iterator[Epoch]:
    yield Epoch(1, False, 1, {}, NOTHING)
    os.kill(os.getpid(), signal.SIGKILL)


def weights(epoch: Epoch) -> bytes:
    return b"".join(parameter.detach().numpy().tobytes() for parameter in epoch.network.parameters())


@pytest.mark.slow
def test_jobs_side_by_side_give_what_they_give_one_after_the_other() -> None:
    jobs = {f"seed-{seed}": partial(ensemble_job, seed) for seed in (0, 1)}
    serial = list(run_jobs(jobs, processes=1))
    parallel = list(run_jobs(jobs, processes=2))
    for name in jobs:
        epochs = [[epoch for found, epoch in run if found == name] for run in (serial, parallel)]
        shown = [[(epoch.index, epoch.last, epoch.updates, epoch.metrics) for epoch in run] for run in epochs]
        assert shown[0] == shown[1]
        assert weights(epochs[0][-1]) == weights(epochs[1][-1])
    assert multiprocessing.active_children() == []


@pytest.mark.slow
def test_the_error_of_a_job_comes_through_and_ends_the_others() -> None:
    jobs = {"endless": partial(endless_job, 0), "failing": failing_job}
    with pytest.raises(TrainingError, match="not finite any more"):
        for _ in run_jobs(jobs, processes=2):
            pass
    assert multiprocessing.active_children() == []


@pytest.mark.slow
def test_a_worker_that_is_killed_is_one_clear_error_and_ends_the_others() -> None:
    jobs = {"endless": partial(endless_job, 0), "killed": killed_job}
    with pytest.raises(TrainingError, match=r"that trained 'killed' was killed \(SIGKILL\), perhaps for lack of"):
        for _ in run_jobs(jobs, processes=2):
            pass
    assert multiprocessing.active_children() == []


@pytest.mark.slow
def test_a_bug_in_a_job_is_that_exception_with_its_place_and_not_lack_of_memory() -> None:
    with pytest.raises(KeyError, match="loss") as caught:
        list(run_jobs({"endless": partial(endless_job, 0), "buggy": buggy_job}, processes=2))
    assert "in buggy_job" in str(caught.value.__cause__)
    with pytest.raises(
        TrainingError, match="that trained 'leaving' ended by itself with exit status 3, which is a bug"
    ):
        list(run_jobs({"endless": partial(endless_job, 0), "leaving": leaving_job}, processes=2))
    assert multiprocessing.active_children() == []


@pytest.mark.slow
def test_workers_do_not_hear_ctrl_c_but_end_with_the_loop_and_waiting_jobs_never_begin() -> None:
    jobs = {f"seed-{seed}": partial(endless_job, seed) for seed in range(3)}
    stream, seen = run_jobs(jobs, processes=2), dict[str, float]()
    for name, epoch in stream:
        seen[name] = epoch.metrics["process"]
        if len(seen) == 2:
            break
    stream.close()  # type: ignore[attr-defined] # a generator
    assert set(seen) == {"seed-0", "seed-1"}
    assert multiprocessing.active_children() == []


def test_the_error_of_a_job_comes_through_without_processes_too() -> None:
    with pytest.raises(TrainingError, match="not finite any more"):
        list(run_jobs({"failing": failing_job}, processes=4))
