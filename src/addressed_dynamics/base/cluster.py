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
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
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
    name, _, address = asked.partition(":")
    host, _, port = address.rpartition(":")
    if name != "ray" or (address and not (host and port.isdecimal())):
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
    where: Ray, jobs: Mapping[str, Callable[[], Iterator[Result]]]
) -> Iterator[Iterator[tuple[str, Result]]]:
    """Yield what the jobs yield, each with the name of its job, as it comes; every job is a task of Ray's.

    A job whose worker is lost begins anew: what it yielded before is not yielded twice, so it has to yield the same.

    Raises:
        ClusterError: as in `cluster_map`.
    """
    with _connected(where) as ray:
        task = ray.remote(num_cpus=1, max_retries=RETRIES, num_returns="streaming")(_stream_at_home)
        left = {task.remote(_Home.here(), pickle.dumps(job)): name for name, job in jobs.items()}

        def stream() -> Iterator[tuple[str, Result]]:
            while left:
                with _said(ray):
                    ready, _ = ray.wait(list(left), num_returns=1)
                for generator in ready:
                    name = left[generator]
                    with _said(ray):
                        reference = next(generator, None)
                        answer = None if reference is None else ray.get(reference)
                    if answer is None:
                        del left[generator]
                    else:
                        yield name, _opened(answer)

        try:
            yield stream()
        finally:
            for generator in left:
                ray.cancel(generator, force=True)


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


def _stream_at_home(home: _Home, payload: bytes) -> Iterator[bytes]:
    """Yield the same of what a job yields."""
    try:
        home.enter()
        for result in pickle.loads(payload)():
            yield pickle.dumps(result)
    except Exception as error:
        yield pickle.dumps(Failure.of(error))


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
    except (OSError, OverflowError) as error:
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
        text = " ".join(str(error).split())
        message = (
            f"Ray lost a task more often than {RETRIES} times ({type(error).__name__}: {text[:300]}); run the stage "
            "again, and see the machines' memory and Ray's logs"
        )
        raise ClusterError(message) from error
