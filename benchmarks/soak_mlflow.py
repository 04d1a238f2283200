"""Ways in which MLflow can be taken away from a stage that is running."""

import os
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

WAYS = ("removed", "locked", "damaged", "replaced", "server killed", "removed", "locked", "damaged", "server stopped")
"""In which order they are gone through."""
SERVER = ("server killed", "server stopped")
"""Those that need one."""
WAIT = 120.0
"""Seconds that a server may take to answer."""


class Server:
    """MLflow's tracking server, on the loopback; started when it is needed first, and again when it was killed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process: subprocess.Popen[bytes] | None = None
        self._port = 0

    def start(self) -> str:
        """Return the address of a server that answers."""
        if self._process is not None and self._process.poll() is None:
            return self._address
        self._folder.mkdir(exist_ok=True)
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = int(probe.getsockname()[1])
        command = [
            sys.executable, "-m", "mlflow", "server", "--host", "127.0.0.1", "--port", str(self._port),
            "--workers", "1",
            "--backend-store-uri", f"sqlite:///{self._folder / 'runs.db'}",
            "--artifacts-destination", str(self._folder / "artifacts"),
        ]  # fmt: skip
        settings = {"MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false", "MLFLOW_DISABLE_TELEMETRY": "true"}
        with (self._folder / "log").open("ab") as log:
            self._process = subprocess.Popen(
                command,
                cwd=self._folder,
                env={**os.environ, **settings},
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        end = time.monotonic() + WAIT
        while not self._answers():
            if time.monotonic() > end or self._process.poll() is not None:
                message = f"no MLflow server could be started; {self._folder / 'log'} says why"
                raise RuntimeError(message)
            time.sleep(0.2)
        return self._address

    @property
    def _address(self) -> str:
        return f"http://127.0.0.1:{self._port}"

    def _answers(self) -> bool:
        try:
            with urllib.request.urlopen(f"{self._address}/health", timeout=5):
                return True
        except (urllib.error.URLError, OSError):
            return False

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to all of its processes."""
        if self._process is not None:
            os.killpg(self._process.pid, number)

    def close(self) -> None:
        """End it."""
        if self._process is not None and self._process.poll() is None:
            self.signal(signal.SIGKILL)
            self._process.wait()


@contextmanager
def taken_away(way: str, clone: Path, server: Server) -> Iterator[None]:
    """Take MLflow away; give back what can be given back."""
    store = clone / ".mlflow"
    database = store / "mlflow.db"
    match way:
        case "removed":
            database.unlink(missing_ok=True)
            yield
        case "replaced":
            shutil.rmtree(store, ignore_errors=True)
            store.write_text("no folder\n", encoding="utf-8")
            yield
        case "damaged":
            store.mkdir(exist_ok=True)
            database.write_bytes(b"no database\n" * 1000)
            yield
        case "locked":
            store.mkdir(exist_ok=True)
            with closing(sqlite3.connect(database, timeout=0.01, isolation_level=None)) as connection:
                _lock(connection)
                yield
        case "server killed":
            server.close()
            yield
        case "server stopped":
            server.signal(signal.SIGSTOP)
            yield
            server.signal(signal.SIGCONT)


def _lock(connection: sqlite3.Connection) -> None:
    """Hold a database for nobody else to read or write, as soon as whoever writes now has done so."""
    for _ in range(2000):
        try:
            connection.execute("BEGIN EXCLUSIVE")
        except sqlite3.OperationalError:
            time.sleep(0.005)
        else:
            return
