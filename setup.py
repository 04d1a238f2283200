"""Building a wheel: beside the package it holds what `addressed-dynamics init` writes, taken from this repository."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).parent
PROJECT = "addressed_dynamics/cli/templates/repository"
"""Where the package looks for it; in a checkout, which has no such folder, it looks into the repository itself."""
FILES = (
    "dvc.yaml", ".dvcignore", ".dvc/config", ".dvc/.gitignore", "pipeline/*.py", "released/README.md",
    "released/.gitignore",
)  # fmt: skip
"""What a project has in common with this one."""


class BuildWithProject(build_py):
    """Copies the stages into the package that is built."""

    def run(self) -> None:
        """Build as usual, then copy; an editable installation finds the files where they are."""
        super().run()
        if self.editable_mode:
            return
        for pattern in FILES:
            found = sorted(ROOT.glob(pattern))
            if not found:
                raise FileNotFoundError(ROOT / pattern)
            for file in found:
                target = Path(self.build_lib, PROJECT, file.relative_to(ROOT))
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(file, target)


setup(cmdclass={"build_py": BuildWithProject})
