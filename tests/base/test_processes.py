"""Work in several processes: results in order, errors as themselves, no traces."""

import os
import re
import signal
import threading
from multiprocessing import forkserver
from typing import Any

import pytest

from addressed_dynamics.base.errors import AddressedDynamicsError, LogError
from addressed_dynamics.base.processes import death, worker_processes


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


class TwoPartError(Exception):
    """An exception that cannot be unpickled, because it is made of other arguments than it keeps."""

    def __init__(self, part: str, whole: str) -> None:
        super().__init__(f"{part} of {whole}")


def raise_two_parts(number: int) -> int:
    raise TwoPartError(str(number), "nine")


def divide(number: int) -> float:
    return 1 / number


def refuse_to_unpickle() -> None:
    message = "this result was never meant to travel"
    raise ValueError(message)


class Unpicklable:
    """A result that another process cannot read."""

    def __reduce__(self) -> tuple[Any, ...]:
        return refuse_to_unpickle, ()


def make_unpicklable(_: int) -> Unpicklable:
    return Unpicklable()


def leave(_: int) -> int:
    os._exit(3)


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
def test_a_bug_in_a_worker_is_that_exception_with_its_place_and_not_lack_of_memory() -> None:
    with worker_processes(2) as ordered_map, pytest.raises(ZeroDivisionError, match="division by zero") as caught:
        list(ordered_map(divide, [1, 0]))
    assert "test_processes.py" in str(caught.value.__cause__)
    assert "in divide" in str(caught.value.__cause__)
    with worker_processes(2) as ordered_map, pytest.raises(RuntimeError) as found:
        list(ordered_map(raise_two_parts, [7]))
    assert re.fullmatch(
        r"TwoPartError: 7 of nine \(.*test_processes\.py, line \d+, in raise_two_parts\)", str(found.value)
    )
    with worker_processes(2) as ordered_map, pytest.raises(ValueError, match="never meant to travel"):
        list(ordered_map(make_unpicklable, [0]))


@pytest.mark.slow
def test_only_a_worker_that_was_killed_suggests_lack_of_memory() -> None:
    killed = r"one of 2 worker processes was killed \(SIGKILL\), perhaps for lack of memory; run the stage again"
    with pytest.raises(AddressedDynamicsError, match=killed), worker_processes(2) as ordered_map:
        list(ordered_map(die, [0, 1]))
    left = "one of 2 worker processes ended by itself with exit status 3, which is a bug"
    with pytest.raises(AddressedDynamicsError, match=left), worker_processes(2) as ordered_map:
        list(ordered_map(leave, [0, 1]))


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (-15, r"was killed \(SIGTERM\)"),
        (-200, r"killed \(signal 200\)"),
        (None, "died; run"),
        (255, "ended with the server that had forked it"),
    ],
)
def test_the_end_of_a_worker_is_told_by_its_exit_code(code: int | None, words: str) -> None:
    assert re.search(words, death(code))
    assert "memory" not in death(code)


def test_a_server_that_is_killed_while_it_is_asked_for_a_worker_is_one_project_error() -> None:
    with worker_processes(2) as ordered_map:
        assert list(ordered_map(square, [1, 2])) == [1, 4]
    server = forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined] # nothing else tells it
    os.kill(server, signal.SIGSTOP)
    threading.Timer(0.2, os.kill, (server, signal.SIGKILL)).start()

    with pytest.raises(AddressedDynamicsError, match="the server that forks"), worker_processes(2) as ordered_map:
        list(ordered_map(square, [1, 2]))

    with worker_processes(2) as ordered_map:
        assert list(ordered_map(square, [3])) == [9]
