"""Commands of a clone that can be cut off with all that they started, and what they said."""

import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "tests"))
from pipeline_clones import dvc_command, environment

PATIENCE = 240.0
"""Seconds after which a command that does not end is taken for one that hangs."""
SCANS, PAUSE = 3, 0.02
"""So often in a row, and so many seconds apart, no process must be found before all are taken for ended."""
SETTLED = 1.0
"""So many seconds after its begin a command works in its folder; before, what was forked for it may yet come there."""

_BAR = re.compile(r"[\w ]+: [^\[\n]*\[\d\d:\d\d[^\]]*\]")
_TRACKER = re.compile(
    r'Traceback \(most recent call last\):\n  File "[^"\n]*/multiprocessing/resource_tracker\.py"[^\n]*\n'
    r"(?:    [^\n]*\n)+KeyError: [^\n]*"
)
_EXPECTED = re.compile(
    r"Running stage|> python -m|Generating lock file|Updating lock file|To track the changes|\tgit add|"
    r"To enable auto staging|\tdvc config|Use `dvc push`|\w+: \d+ trainings?, |.* INFO mlflow|\s*$"
)
"""What a command that goes well says line by line, beside the last line of its stage. MLflow tells its beginnings to
the warm interpreter alone, which has imported it before this project could ask it to be quiet."""


def processes_in(folder: Path) -> dict[int, str]:
    """Return the processes that work in a folder, each with its command line."""
    found = {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdecimal():
            continue
        try:
            where = str((entry / "cwd").readlink()).removesuffix(" (deleted)")
            if Path(where).is_relative_to(folder):
                found[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue  # it has ended
    return found


def commands_in(folder: Path, mark: str) -> list[int]:
    """Return the processes in a folder with a mark in their command line."""
    return sorted(process for process, line in processes_in(folder).items() if mark in line)


def workers_in(folder: Path) -> list[int]:
    """Return the worker processes in a folder: those that their server has forked, and so are called like it."""
    servers = commands_in(folder, "multiprocessing.forkserver")
    return [process for process in servers if _parent(process) in servers]


def fork_servers_in(folder: Path) -> list[int]:
    """Return the servers in a folder that fork workers."""
    servers = commands_in(folder, "multiprocessing.forkserver")
    return [process for process in servers if _parent(process) not in servers]


def _parent(process: int) -> int:
    with suppress(OSError):
        return int(Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[1])
    return 0


def kill_all(folder: Path) -> int:
    """Kill every process that works in a folder with SIGKILL, until there are none; return how many there were."""
    killed, quiet = 0, 0
    while quiet < SCANS:
        found = processes_in(folder)
        for process in found:
            try:
                os.kill(process, signal.SIGKILL)
                killed += 1
            except ProcessLookupError:
                continue
        quiet = 0 if found else quiet + 1
        time.sleep(PAUSE if not found else 0.001)
    return killed


@contextmanager
def stopped(folder: Path) -> Iterator[None]:
    """Hold every process that works in a folder still: its files are then as if all had been killed at that instant."""
    held = set[int]()
    while found := processes_in(folder).keys() - held:
        for process in found:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGSTOP)
        held |= found
    try:
        yield
    finally:
        for process in held:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGCONT)


class Command:
    """A DVC command that runs in a clone."""

    def __init__(self, clone: Path, *arguments: str, log: Path, settings: Mapping[str, str], warm: bool = True) -> None:
        """Start it; what it and its stages say goes to the file `log`."""
        self.clone = clone
        if warm:
            command, own = dvc_command(clone, *arguments)
        else:
            command, own = [sys.executable, "-m", "dvc", *arguments], environment(clone)
        self._log = log
        with log.open("wb") as file:
            self._process = subprocess.Popen(
                command, cwd=clone, env={**own, **settings}, stdin=subprocess.DEVNULL, stdout=file, stderr=file,
                start_new_session=True,
            )  # fmt: skip
        self._begin = time.monotonic()
        self.hung: list[str] = []
        """What still ran when it was taken for one that hangs."""

    @property
    def seconds(self) -> float:
        """How long ago it began."""
        return time.monotonic() - self._begin

    @property
    def log(self) -> str:
        """All that was said so far."""
        return self._log.read_text(encoding="utf-8", errors="replace")

    def has_ended(self, by: float, watch: Callable[[], object] = lambda: None) -> bool:
        """Wait until it ends, `watch` says so, or so many seconds after it began; return whether it has ended."""
        while self._process.poll() is None:
            if self.seconds > by or watch():
                return False
            time.sleep(0.005)
        return True

    def wait(self) -> int | None:
        """Wait until it ends; return its exit status, None if it hangs and is killed."""
        ended = self.has_ended(self.seconds + PATIENCE)
        if not ended:
            self.hung = sorted(processes_in(self.clone).values())
            kill_all(self.clone)
        self._process.wait()
        return self._process.returncode if ended else None

    def status(self) -> int | None:
        """The same, for one that runs alone; what it leaves running ends, too."""
        status = self.wait()
        kill_all(self.clone)
        return status

    def kill(self) -> None:
        """Kill it with all that it started, as if the machine lost its power."""
        while kill_all(self.clone) or self.seconds < SETTLED:
            time.sleep(PAUSE)
        self._process.wait()


def has_begun(log: str) -> bool:
    """Say whether DVC has begun to run a stage: before, it may be removing what it made last time."""
    return "> python -m pipeline." in log


def shows_traceback(log: str) -> bool:
    """Say whether there is a traceback in what was said, but for those that Python's own resource tracker shows.

    One that is started in place of a killed one does not know of the semaphores that it is asked to forget.
    """
    return "Traceback" in _TRACKER.sub("", log)


def remarks(log: str, experiment: str) -> Counter[str]:
    """Return the lines that a command that goes well would not have said, their numbers taken out."""
    lines = [_BAR.sub("", part) for line in log.splitlines() for part in line.split("\r")]
    unexpected = [line for line in lines if not _EXPECTED.match(line) and not line.startswith(f"{experiment}: ")]
    return Counter(without_numbers(line) for line in unexpected)


def without_numbers(line: str) -> str:
    """Return a line with a sign in place of what differs from run to run."""
    line = re.sub(r"0x[0-9a-f]+|\b[0-9a-f]{12,}\b", "#", line)
    line = re.sub(r"/[\w./-]*?/project/", "", line)
    line = re.sub(r"(/[\w.#-]+)+/(?=lib/python|site-packages)", "…/", line)
    return re.sub(r"\d+", "#", line).strip()[:300]
