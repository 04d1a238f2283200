"""A Python that has imported the packages already: each command is a fork of it.

The tests run the pipeline as its users do: DVC, and in it a process for each stage. Most of the time of a tiny stage
is spent importing torch and MLflow; here they are imported once, and each command gets a process of its own with its
own arguments, folder, environment and streams. What belongs to this project is imported after the fork, from where the
command's `PYTHONPATH` says.

The first argument is a folder. On the socket there a client sends the command as JSON together with its three standard
streams, and gets the exit status; whoever has commands to run holds the named pipe `users` open for writing.
"""

import gc
import importlib
import json
import os
import runpy
import select
import shutil
import signal
import socket
import sys
import warnings
from pathlib import Path

PACKAGES = (
    "torch", "torch._dynamo", "mlflow", "mlflow.pyfunc", "mlflow.tracking", "mlflow.store.tracking.sqlalchemy_store",
    "mlflow.store.tracking.sqlalchemy_workspace_store", "mlflow.store.model_registry.sqlalchemy_workspace_store",
    "mlflow.system_metrics.system_metrics_monitor", "sqlalchemy", "sqlalchemy.dialects.sqlite", "alembic",
    "gymnasium", "gymnasium.envs.classic_control", "stable_baselines3", "matplotlib.pyplot", "matplotlib.animation",
    "matplotlib.backends.backend_agg", "PIL.Image", "PIL.GifImagePlugin", "PIL.ImageDraw", "PIL.ImageFont",
    "polars", "pyarrow.parquet", "pyarrow.dataset", "pyarrow.pandas_compat", "scipy.stats", "pydantic",
    "pydantic.dataclasses", "jinja2", "jaxtyping", "safetensors.torch", "safetensors.numpy", "mcap.reader",
    "mcap.writer", "ruamel.yaml", "yaml", "filelock", "tqdm", "zstandard", "lz4", "wcwidth", "tabulate",
    "concurrent.futures.process", "multiprocessing.forkserver", "dvc.cli", "dvc.cli.parser", "dvc.repo",
    "dvc.repo.experiments", "dvc.repo.index", "dvc.repo.plots", "dvc.commands.repro", "dvc.stage.cache",
    "dvc_data.hashfile.db.local", "dulwich.worktree",
)  # fmt: skip
"""What takes long to import and starts nothing by being imported."""

SHIM = """#!{python} -ISs
import json, os, socket, sys
server = socket.socket(socket.AF_UNIX)
server.connect({path!r})
command = {{"argv": sys.argv[1:], "cwd": os.getcwd(), "env": dict(os.environ)}}
with server.makefile("rb") as answer:
    socket.send_fds(server, [b"."], [0, 1, 2])
    server.sendall(json.dumps(command).encode())
    server.shutdown(socket.SHUT_WR)
    status = int(answer.read() or 70)
sys.exit(status if status >= 0 else 128 - status)
"""
"""A program to put first on PATH as `python`: it hands its command to the warm one."""

READY = "ready\n"
"""What is said once commands are answered."""


def serve(folder: Path) -> None:
    """Run commands until the last user is gone, killed or not, and remove the folder; return in a command's fork."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(folder / "socket"))
        listener.listen()
        # The forks share what was imported; the collector would copy it by looking at it.
        gc.collect()
        gc.freeze()
        sys.stdout.write(READY)
        sys.stdout.flush()
        users = os.open(folder / "users", os.O_RDONLY)  # waits for the first
        while True:
            ready, _, _ = select.select([listener, users], [], [])
            if users in ready:
                shutil.rmtree(folder, ignore_errors=True)
                sys.exit()
            client, _ = listener.accept()
            with client:
                if os.fork() == 0:
                    listener.close()
                    os.close(users)
                    _answer(client)
                    return


def _answer(client: socket.socket) -> None:
    """Send the exit status of a command to its client; return in the process of the command."""
    _, streams, _, _ = socket.recv_fds(client, 1, 3)
    with client.makefile("rb") as asked:
        command = json.loads(asked.read())
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    if child := os.fork():
        for stream in (0, 1, 2, *streams):
            os.close(stream)
        _, status = os.waitpid(child, 0)
        client.sendall(str(os.waitstatus_to_exitcode(status)).encode())
        os._exit(0)
    client.close()
    for stream, number in zip(streams, (0, 1, 2), strict=True):
        os.dup2(stream, number)
        os.close(stream)
    os.chdir(command["cwd"])
    os.environ.clear()
    os.environ.update(command["env"])
    sys.argv = command["argv"]


def become(argv: list[str]) -> None:
    """Run `-m module …`, `-c program …` or `script …`, after `-W action` or not, as the interpreter would."""
    if argv[0] == "-W":
        _, action, *argv = argv
        sys.warnoptions.append(action)  # what processes of its own get from it
        warnings.simplefilter(action)
    option, *arguments = argv
    first = str(Path(option).parent) if not option.startswith("-") else str(Path.cwd())
    sys.path[:0] = [first, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    importlib.invalidate_caches()
    if option == "-m":
        sys.argv = arguments
        runpy.run_module(arguments[0], run_name="__main__", alter_sys=True)
    elif option == "-c":
        sys.argv = [option, *arguments[1:]]
        exec(compile(arguments[0], "<string>", "exec"), {"__name__": "__main__"})
    else:
        runpy.run_path(option, run_name="__main__")


def main() -> None:
    # Each zombie would be kept until this process ends.
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    with warnings.catch_warnings():
        # The threads that are left after these imports wait for work, which the forks do not give them.
        warnings.simplefilter("ignore")
        for package in PACKAGES:
            importlib.import_module(package)
        sys.modules["sqlalchemy.orm"].configure_mappers()  # of MLflow's tables, at the first question otherwise
    mine = [name for name in sys.modules if name.partition(".")[0] in {"addressed_dynamics", "pipeline"}]
    assert not mine, mine
    sys.path.pop(0)
    warnings.filterwarnings("ignore", message=".*multi-threaded, use of fork", category=DeprecationWarning)
    serve(Path(sys.argv[1]))
    become(sys.argv)


if __name__ == "__main__":
    main()
