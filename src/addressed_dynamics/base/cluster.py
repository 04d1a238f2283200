"""Ray as launcher: what worker processes do, on the machines of a cluster instead. The only module that imports Ray.

Where work is done is no param, for nothing depends on it: the environment variable `ADDRESSED_DYNAMICS_ENGINE` says it.
All machines see the project's folder under the same path, have the same Python and the same version of this package.
"""

from __future__ import annotations

import ipaddress
import os
import pickle
import platform
import shutil
import socket
import sys
import tempfile
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar

from addressed_dynamics.base.errors import ClusterError, ParamsError
from addressed_dynamics.base.failures import Failure
from addressed_dynamics.base.versions import hash_sources

Item = TypeVar("Item")
Result = TypeVar("Result")

ENGINE = "ADDRESSED_DYNAMICS_ENGINE"
"""Environment variable: `local`, as without it; `ray`, for Ray that is started for the one command; `ray:HOST:PORT`,
for a cluster that runs."""
RETRIES = 3
"""So often an item is begun anew whose worker or machine was lost."""
PEERS_ANSWER = timedelta(minutes=10)
"""After so long without a word of the others, a task that works together with them gives up."""
ANSWER_SECONDS = 5.0
"""After so long without an answer, there is no Ray at an address."""


@dataclass(frozen=True)
class Ray:
    """Where Ray runs."""

    address: str | None
    """Host and port of a cluster's head; None for Ray on this machine that ends with the command."""


def engine() -> Ray | None:
    """Return which Ray the environment asks for; None for processes of this machine.

    Raises:
        ParamsError: it asks for an engine that there is not, or for an address that is none.
    """
    asked = os.environ.get(ENGINE, "local")
    if asked == "local":
        return None
    name, colon, address = asked.partition(":")
    host, _, port = address.rpartition(":")
    if name != "ray" or (colon and not (host and port.isdecimal())):
        message = f"{ENGINE} should be 'local', 'ray' or 'ray:HOST:PORT', but is '{asked}'"
        raise ParamsError(message)
    return Ray(address or None)


@contextmanager
def cluster_map(where: Ray) -> Iterator[Callable[[Callable[[Item], Result], Sequence[Item]], Iterator[Result]]]:
    """Yield a `map` of which every item is a task of Ray's; results come in the order of the items.

    Raises:
        ClusterError: Ray does not answer or is another, a worker has another version or does not see the folder, or an
            item was lost more often than `RETRIES`.
    """
    with _connected(where) as ray:

        def ordered_map(function: Callable[[Item], Result], items: Sequence[Item], /) -> Iterator[Result]:
            task = ray.remote(num_cpus=1, max_retries=RETRIES)(_at_home)
            left = [task.remote(_Home.here(), pickle.dumps(partial(function, item))) for item in items]
            try:
                while left:
                    with _said(ray):
                        answer = ray.get(left[0])
                    left.pop(0)
                    yield _opened(answer)
            finally:
                for reference in left:
                    ray.cancel(reference, force=True)

        yield ordered_map


@contextmanager
def cluster_streams(
    where: Ray, jobs: Mapping[str, Callable[[], Iterator[Result]]], workers: int = 1
) -> Iterator[Iterator[tuple[str, Result]]]:
    """Yield what the jobs yield, each with the name of its job, as it comes; every job is a task of Ray's.

    A job whose worker is lost begins anew: what it yielded before is not yielded twice, so it has to yield the same.

    With several workers each job is run by so many tasks at the same time, which `torch.distributed` has made a group
    of; what the first of them yields counts. If one is lost, all begin anew.

    Raises:
        ClusterError: as in `cluster_map`; or the cluster has fewer cores than `workers`.
    """
    with _connected(where) as ray:
        cores = int(ray.cluster_resources().get("CPU", 0))
        if workers > cores:
            message = (
                f"{workers} workers are asked for, but the cluster has {cores} cores; ask for fewer, or add machines"
            )
            raise ClusterError(message)
        teams = {name: _Team(ray, job, workers) for name, job in jobs.items()}
        try:
            yield _streamed(ray, teams, at_once=max(cores // workers, 1))
        finally:
            for team in teams.values():
                team.end()


def _streamed(ray: Any, waiting: Mapping[str, _Team], at_once: int) -> Iterator[tuple[str, Any]]:
    left, running = dict(waiting), dict[Any, tuple[str, _Team]]()
    while left or running:
        while left and len(running) < at_once:
            name = next(iter(left))
            team = left.pop(name)
            running[team.begin()] = (name, team)
        watched = {each: stream for stream, (_, team) in running.items() for each in team.others}
        (first, *_), _ = ray.wait([*running, *watched], num_returns=1)
        stream = watched.get(first, first)
        name, team = running.pop(stream)
        if first is stream:
            ended, results = team.read()
            for result in results:
                yield name, result
        else:
            ended = False
            team.look_at(first)
        if not ended:
            running[team.stream] = (name, team)


class _Team:
    """The tasks that run one job together: the first yields its results, the others do their part of the work."""

    def __init__(self, ray: Any, job: Callable[[], Iterator[Any]], workers: int) -> None:
        self._ray, self._job, self._workers = ray, pickle.dumps(job), workers
        self._home = _Home.here()
        self.others: list[Any] = []
        """Tasks beside the first that still run, as far as anybody has looked."""
        self._meeting: Path | None = None
        self._lost = self._yielded = self._skipped = 0
        self.stream: Any = None
        """What Ray says by that the first task has yielded something or has ended."""

    def begin(self) -> Any:
        """Start all tasks; return the stream."""
        ray = self._ray
        self._meeting = Path.cwd() / f".{uuid.uuid4().hex}.meeting"
        options = {"num_cpus": 1, "max_retries": 0}
        roles = [_Role(rank, self._workers, self._meeting) for rank in range(self._workers)]
        follow = ray.remote(**options)(_follow_at_home)
        self.others = [follow.remote(self._home, self._job, role) for role in roles[1:]]
        lead = ray.remote(**options, num_returns="streaming")(_stream_at_home)
        self.stream = lead.remote(self._home, self._job, roles[0])
        self._skipped = 0
        return self.stream

    def read(self) -> tuple[bool, list[Any]]:
        """Return whether the job has ended, and its next result if there is one that was not returned before."""
        try:
            reference = next(self.stream, None)
            if reference is None:
                self._ray.get(self.others)
                return True, []
            result = pickle.loads(self._ray.get(reference))
            if isinstance(result, Failure):
                self._raise_loss_of_others()
                raise result.exception()
        except self._ray.exceptions.RayError as error:
            self._begin_anew(error)
            return False, []
        self._skipped += 1
        if self._skipped <= self._yielded:
            return False, []
        self._yielded += 1
        return False, [result]

    def end(self) -> None:
        """Stop whatever still runs, and clear away what the tasks met by."""
        for task in [*self.others, *([] if self.stream is None else [self.stream])]:
            self._ray.cancel(task, force=True)
        if self._meeting is not None:
            self._meeting.unlink(missing_ok=True)

    def look_at(self, other: Any) -> None:
        """Begin anew if a task beside the first is lost, or has given up while the first one still waits for it."""
        self.others.remove(other)
        try:
            gave_up = self._ray.get(other)
        except self._ray.exceptions.RayError as error:
            self._begin_anew(error)
            return
        if gave_up and not self._ray.wait([self.stream], timeout=ANSWER_SECONDS)[0]:
            self._begin_anew(ClusterError(gave_up))

    def _raise_loss_of_others(self) -> None:
        """Raise what became of another task that is lost: what the first one then says is only that it is alone."""
        if self.others:
            ended, _ = self._ray.wait(self.others, num_returns=len(self.others), timeout=ANSWER_SECONDS)
            self._ray.get(ended)

    def _begin_anew(self, error: Exception) -> None:
        self._lost += 1
        if self._lost > RETRIES:
            raise ClusterError(_lost(error)) from error
        old = [*self.others, self.stream]
        self.end()
        # A worker that is still to be killed must not be given one of the new tasks.
        self._ray.wait(old, num_returns=len(old), timeout=ANSWER_SECONDS)
        self.begin()


@dataclass(frozen=True)
class _Home:
    """What a worker has to have in common with the process that asked for the work."""

    folder: str
    code: str

    @staticmethod
    def here() -> _Home:
        return _Home(str(Path.cwd()), _package_digest())

    def enter(self) -> None:
        """Go to the folder.

        Raises:
            ClusterError: there is none, or the code here is another.
        """
        node = f"the worker on {socket.gethostname()}"
        if self.code != _package_digest():
            message = (
                f"{node} has another version of addressed-dynamics ({Path(__file__).parent.parent}): install the same "
                "on all machines, and start the cluster's workers anew"
            )
            raise ClusterError(message)
        try:
            os.chdir(self.folder)
        except OSError as error:
            message = (
                f"{node} does not see the folder {self.folder} ({error.strerror}): the project has to lie on a file "
                "system that all machines share, under the same path"
            )
            raise ClusterError(message) from error


@dataclass(frozen=True)
class _Role:
    """Which of the tasks of a job this is."""

    rank: int
    workers: int
    meeting: Path
    """The file by which the tasks find each other, in the folder of who asked."""

    @contextmanager
    def played(self) -> Iterator[None]:
        """Be in a group of `torch.distributed` meanwhile, if there are several."""
        if self.workers == 1:
            yield
            return
        from torch import distributed

        try:
            distributed.init_process_group(
                "gloo", init_method=self.meeting.as_uri(), rank=self.rank, world_size=self.workers, timeout=PEERS_ANSWER
            )
            yield
        finally:
            if distributed.is_initialized():
                distributed.destroy_process_group()


@cache
def _package_digest() -> str:
    return hash_sources([Path(__file__).parent.parent])


def _at_home(home: _Home, payload: bytes) -> bytes:
    """Return the pickled result of what was pickled, or its `Failure`, as computed in the folder of who asked."""
    try:
        home.enter()
        return pickle.dumps(pickle.loads(payload)())
    except Exception as error:
        return pickle.dumps(Failure.of(error))


def _stream_at_home(home: _Home, payload: bytes, role: _Role) -> Iterator[bytes]:
    """Yield the same of what a job yields."""
    try:
        home.enter()
        with role.played():
            for result in pickle.loads(payload)():
                yield pickle.dumps(result)
    except Exception as error:
        yield pickle.dumps(Failure.of(error))


def _follow_at_home(home: _Home, payload: bytes, role: _Role) -> str:
    """Do a part of the work of a job; return why it was given up, or nothing. The first of its tasks says it, too."""
    try:
        home.enter()
        with role.played():
            for _ in pickle.loads(payload)():
                pass
    except Exception as error:
        return Failure.of(error).summary
    return ""


def _opened(answer: bytes) -> Any:
    result = pickle.loads(answer)
    if isinstance(result, Failure):
        raise result.exception()
    return result


@contextmanager
def _connected(where: Ray) -> Iterator[Any]:
    """Yield the module `ray`, connected; it says nothing of its own and asks nobody outside."""
    for name, value in _QUIET.items():
        os.environ.setdefault(name, value)
    if where.address is None or _is_loopback(where.address):
        # The one way to have all of its servers on this machine alone: by default they listen to everybody, and
        # _node_ip_address="127.0.0.1" is replaced by the machine's address (ray 2.60.0).
        os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
        os.environ.setdefault("GLOO_SOCKET_IFNAME", "lo")
    try:
        import ray
    except ImportError as error:
        message = f"{ENGINE} asks for Ray, which is not installed: pip install 'addressed-dynamics[ray]'"
        raise ClusterError(message) from error
    folder = tempfile.mkdtemp(prefix="ray-") if where.address is None else None
    try:
        if where.address is not None:
            _check_answers(where.address)
        try:
            ray.init(
                address=where.address or "local",
                log_to_driver=False,
                logging_level="ERROR",
                **({"include_dashboard": False, "_temp_dir": folder} if folder else {}),
            )
        except (RuntimeError, ConnectionError, OSError, ValueError) as error:
            raise ClusterError(_why_not(where, error)) from error
        try:
            yield ray
        finally:
            ray.shutdown()
    finally:
        if folder:
            shutil.rmtree(folder, ignore_errors=True)


_QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_DEDUP_LOGS": "0",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}
"""Ray sends figures on its use to its makers unless it is told not to, and warns of what it will do one day."""


def _is_loopback(address: str) -> bool:
    host = address.rpartition(":")[0].strip("[]")
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _check_answers(address: str) -> None:
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=ANSWER_SECONDS).close()
    except (OSError, OverflowError, UnicodeError) as error:  # of a name that is none: encoding it fails
        message = (
            f"no Ray answers at {address} ({error}): start one there with 'ray start --head --port {port}', or correct "
            f"{ENGINE}"
        )
        raise ClusterError(message) from error


def _why_not(where: Ray, error: Exception) -> str:
    text = " ".join(str(error).split())
    if "ersion mismatch" in text:
        text = (
            f"it is of another version than ours (ray {_ray_version()}, Python {platform.python_version()}); install "
            f"the same on all machines: {text}"
        )
    place = f"at {where.address}" if where.address else "on this machine"
    return f"Ray {place} cannot be used: {text}"


def _ray_version() -> str:
    return getattr(sys.modules.get("ray"), "__version__", "?")


@contextmanager
def _said(ray: Any) -> Iterator[None]:
    """Say in one line what became of work that Ray lost."""
    try:
        yield
    except ray.exceptions.RayError as error:
        raise ClusterError(_lost(error)) from error


def _lost(error: Exception) -> str:
    text = " ".join(str(error).split())
    return (
        f"Ray lost a task more often than {RETRIES} times ({type(error).__name__}: {text[:300]}); run the stage again, "
        "and see the machines' memory and Ray's logs"
    )
