"""How much memory there is, and how much of it samples may take."""

import os
import re
from decimal import Decimal
from pathlib import Path

from addressed_dynamics.base.errors import ParamsError

MEMORY = "ADDRESSED_DYNAMICS_MEMORY"
"""Environment variable: so much memory the samples of a split may take, such as `8GiB`; larger ones lie in files."""
SHARE = 0.5
"""Share of the memory that is free that they may take otherwise, beside what trainings keep of each sample."""
_CGROUP = Path("/sys/fs/cgroup")
_GROUPS = (
    (_CGROUP / "memory.max", _CGROUP / "memory.current"),
    (_CGROUP / "memory" / "memory.limit_in_bytes", _CGROUP / "memory" / "memory.usage_in_bytes"),
)
"""Files with the limit of the process's group and what it has taken, in both versions; "max" is no limit."""
_UNITS = {"": 1, "MB": 10**6, "GB": 10**9, "TB": 10**12, "MIB": 2**20, "GIB": 2**30, "TIB": 2**40}
_SIZE = re.compile(r"(\d+(?:\.\d+)?) ?(\w*)")


def memory_for_samples() -> int:
    """Return how many bytes of memory the samples of a split may take; see `MEMORY`.

    Raises:
        ParamsError: the variable is no size.
    """
    asked = os.environ.get(MEMORY)
    if asked is None:
        return int(SHARE * free_memory())
    found = _SIZE.fullmatch(asked.strip())
    if found is None or found[2].upper() not in _UNITS:
        message = (
            f"{MEMORY} should be a size such as 8GiB, 500MB or 0, but is '{asked}'; unset it for half of what is free"
        )
        raise ParamsError(message)
    return int(Decimal(found[1]) * _UNITS[found[2].upper()])


def free_memory() -> int:
    """Return how many bytes of memory this process may still take: of the machine's, and of its group's limit."""
    try:
        lines = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines())
        free = int(lines["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        free = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for limit, used in _GROUPS:
        try:
            left = int(limit.read_text(encoding="ascii")) - int(used.read_text(encoding="ascii"))
        except (OSError, ValueError):
            continue
        free = min(free, max(left, 0))
    return free
