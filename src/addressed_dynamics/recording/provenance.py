"""Where a recording comes from, for the people who find it later."""

import importlib.metadata
import shutil
import subprocess
from datetime import UTC, datetime

from addressed_dynamics.base.params.recording import SegmentParams
from addressed_dynamics.logs import RunInfo

LIBRARIES = ("addressed-dynamics", "gymnasium", "numpy", "stable-baselines3", "torch")
"""Libraries whose versions can change what is recorded."""


def run_info(segment: SegmentParams) -> RunInfo:
    """Describe a recording of `segment` that begins now."""
    return RunInfo(
        environment=segment.environment.id,
        kwargs=segment.environment.kwargs,
        segment=segment.name,
        behaviour=segment.behaviour.kind,
        seed=segment.seed,
        versions={name: importlib.metadata.version(name) for name in LIBRARIES},
        git_commit=_git_commit(),
        started=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _git_commit() -> str:
    git = shutil.which("git")
    if git is None:
        return ""
    answer = subprocess.run([git, "rev-parse", "HEAD"], capture_output=True, text=True, check=False)
    return answer.stdout.strip() if answer.returncode == 0 else ""
