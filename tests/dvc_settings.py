"""What `dvc exp run -S` writes into a params file, by DVC's own hand."""

import subprocess
import sys
from pathlib import Path


def apply_overrides(file: Path, settings: list[str]) -> None:
    """Change a params file as DVC does; in a process of its own, for DVC warns of what it imports."""
    program = "import sys; from dvc.utils.hydra import apply_overrides as apply; apply(sys.argv[1], sys.argv[2:])"
    done = subprocess.run(
        [sys.executable, "-c", program, str(file), *settings], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
