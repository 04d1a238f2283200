"""Python that has the big libraries imported already: what a clone's stages are run by.

A server imports them once and forks for each command (`python -m ...`), which then imports the first-party package of
its own clone. So a test runs DVC and its stages as processes of their own, as a user does, without the five seconds
that torch and MLflow take to be imported in each.
"""

import array
import json
import logging
import os
import runpy
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

LIBRARIES = (
    "torch", "mlflow", "mlflow.pytorch", "mlflow.store.tracking.sqlalchemy_store", "matplotlib.figure",
    "matplotlib.backends.backend_agg", "matplotlib.backends.backend_svg", "pandas", "pyarrow.parquet", "pydantic",
    "gymnasium", "safetensors.torch", "mcap.reader", "ruamel.yaml", "tqdm", "PIL.Image", "jinja2",
    "dvc.cli", "dvc.commands.repro", "dvc.commands.metrics", "dvc.repo", "dvc.stage", "dvc_data.index",
)  # fmt: skip
"""What stages and DVC import; nothing of ours, for each clone has its own."""

SHIM = """#!{python} -IS
import array, json, os, socket, sys
server = socket.socket(socket.AF_UNIX)
server.connect({address!r})
request = json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ)]).encode()
streams = socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [0, 1, 2])
server.sendmsg([len(request).to_bytes(8, "little")], [streams])
server.sendall(request)
answer = server.recv(1)
os._exit(answer[0] if answer else 70)
"""


def serve(address: str) -> NoReturn:
    """Import the libraries, then answer commands until the process that started this one is gone."""
    parent = os.getppid()
    for name in LIBRARIES:
        with suppress(ImportError):
            __import__(name)
    assert threading.active_count() == 1, "what forks must have one thread"
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(address + ".partial")
    listener.listen()
    Path(address + ".partial").rename(address)
    listener.settimeout(1.0)
    while os.getppid() == parent:
        with suppress(TimeoutError):
            connection, _ = listener.accept()
            if os.fork() == 0:
                listener.close()
                _answer(connection)
            connection.close()
    sys.exit(0)


def _answer(connection: socket.socket) -> NoReturn:
    """Run one command as `python` would, and say its status."""
    connection.settimeout(None)
    streams = array.array("i")
    size, ancillary, _, _ = connection.recvmsg(8, socket.CMSG_SPACE(3 * streams.itemsize))
    streams.frombytes(ancillary[0][2])
    request = b""
    while len(request) < int.from_bytes(size, "little"):
        request += connection.recv(1 << 20)
    arguments, folder, environment = json.loads(request)
    for target, stream in enumerate(streams):
        os.dup2(stream, target)
        os.close(stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    status = 1
    try:
        status = _run(arguments)
    finally:
        with suppress(OSError, ValueError):
            sys.stdout.flush()
        with suppress(OSError, ValueError):
            sys.stderr.flush()
        connection.sendall(bytes([status & 255]))
        os._exit(status & 255)


def _run(arguments: list[str]) -> int:
    assert arguments[0] == "-m", "nothing else is asked for"
    logging.getLogger().handlers.clear()  # of libraries that a command may not import itself
    logging.getLogger().setLevel(logging.WARNING)
    sys.argv = arguments[1:]
    sys.path[0:0] = [str(Path.cwd()), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    try:
        runpy.run_module(arguments[1], run_name="__main__", alter_sys=True)
    except SystemExit as end:
        if isinstance(end.code, str):
            sys.stderr.write(f"{end.code}\n")
            return 1
        return end.code or 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
        return 1
    return 0


def start(folder: Path) -> subprocess.Popen[bytes]:
    """Start a server that ends with this process, and make a folder `bin` for PATH with a `python` that asks it."""
    address, programs = str(folder / "socket"), folder / "bin"
    programs.mkdir(parents=True)
    environment = os.environ | {"OMP_NUM_THREADS": "1", "DO_NOT_TRACK": "true", "MLFLOW_DISABLE_TELEMETRY": "true"}
    server = subprocess.Popen([sys.executable, __file__, address], env=environment, stdin=subprocess.DEVNULL)
    (programs / "python").write_text(SHIM.format(python=sys.executable, address=address))
    (programs / "python").chmod(0o755)
    while not Path(address).exists():
        assert server.poll() is None, "the server did not start"
        time.sleep(0.05)
    return server


if __name__ == "__main__":
    serve(sys.argv[1])
