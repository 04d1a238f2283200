"""The command that runs the example, as the Makefile and the example's README have it."""

import re
from pathlib import Path


def overrides(file: Path, experiment: str = "pendulum") -> list[str]:
    """Return the settings that the command `dvc exp run` in a file gives an example."""
    command = file.read_text(encoding="utf-8").partition(f"dvc exp run report@{experiment}")[2].replace("\\\n", " ")
    return [quoted or plain for quoted, plain in re.findall(r"-S (?:'([^']+)'|(\S+))", command.partition("\n")[0])]
