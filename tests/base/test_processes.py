"""Work in several processes: results in order, errors as themselves, no traces."""

import os
import signal

import pytest

from addressed_dynamics.base.errors import AddressedDynamicsError, LogError
from addressed_dynamics.base.processes import worker_processes


def square(number: int) -> int:
    return number * number


def name_of_process(_: int) -> int:
    return os.getpid()


def refuse(number: int) -> int:
    message = f"log {number} is damaged"
    raise LogError(message)


def die(_: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


def is_interrupted(_: int) -> bool:
    """Send this process the signal of Ctrl-C."""
    os.kill(os.getpid(), signal.SIGINT)
    return signal.SIGINT not in signal.sigpending()


def test_one_process_means_this_one() -> None:
    with worker_processes(1) as ordered_map:
        assert list(ordered_map(name_of_process, [0, 1])) == [os.getpid()] * 2
        with pytest.raises(LogError, match="log 3 is damaged"):
            list(ordered_map(refuse, [3]))


@pytest.mark.slow
def test_workers_keep_the_order_raise_their_errors_here_and_do_not_hear_ctrl_c() -> None:
    with worker_processes(2) as ordered_map:
        assert list(ordered_map(square, range(20))) == [number**2 for number in range(20)]
        assert os.getpid() not in set(ordered_map(name_of_process, range(4)))
        assert list(ordered_map(is_interrupted, [0])) == [False]
        with pytest.raises(LogError, match="log 3 is damaged"):
            list(ordered_map(refuse, [3]))


@pytest.mark.slow
def test_a_worker_that_is_killed_is_one_clear_error() -> None:
    with pytest.raises(AddressedDynamicsError, match="worker processes died"), worker_processes(2) as ordered_map:
        list(ordered_map(die, [0, 1]))
