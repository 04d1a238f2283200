"""Which code and which data: the commit that Git has for the one, the digests that DVC and we have for the other."""

from __future__ import annotations

import hashlib
import os
import subprocess
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path

import yaml  # type: ignore[import-untyped]  # its stubs are a package of their own, for three names

_DIGITS = 16  # of a digest that people copy; enough to tell billions of outputs apart


def project_root() -> Path:
    """Return the folder that holds `.dvc`: here or above, or where DVC says it is; the working directory without."""
    if root := os.environ.get("DVC_ROOT"):
        return Path(root).resolve()
    here = Path.cwd()
    return next((folder for folder in (here, *here.parents) if (folder / ".dvc").is_dir()), here)


def code_version() -> str:
    """Return the Git commit of the code, with a remark if the working tree differs from it; empty without Git."""
    commit = git_commit()
    return f"{commit}{', with changes' if code_changed() else ''}" if commit else ""


def git_commit() -> str:
    """Return the Git commit that is checked out; empty without Git."""
    return _git("rev-parse", "HEAD")


def code_changed() -> bool:
    """Return whether the working tree differs from the commit, but for what the pipeline itself rewrites."""
    return bool(_git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!dvc.lock", ":!data"))


def data_digest(path: Path) -> str | None:
    """Return the MD5 that `dvc.lock` has for the output at `path` (of its listing, for a folder); None without one."""
    root = project_root()
    lock = root / "dvc.lock"
    try:
        return _locked_digests(lock, lock.stat().st_mtime_ns).get(path.resolve().relative_to(root).as_posix())
    except (OSError, ValueError):
        return None


def output_digests(folder: Path) -> dict[str, str]:
    """Return a digest of each innermost folder of `folder`, by its path in there (`.` for `folder` itself).

    A digest is a function of the names and bytes of the files in that one folder, so that it is the same on every
    machine and after `dvc checkout`.

    Raises:
        OSError: a file cannot be read.
    """
    files: dict[Path, list[Path]] = {}
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        files.setdefault(file.parent, []).append(file)
    outer = {parent for inner in files for parent in inner.parents}
    return {
        inner.relative_to(folder).as_posix(): _digest(inner, inside)
        for inner, inside in files.items()
        if inner not in outer
    }


def hash_sources(paths: Iterable[Path]) -> str:
    """Return a hash of the names and contents of Python files.

    Args:
        paths: the files, or folders of them; where these lie does not matter.
    """
    digest = hashlib.blake2b(digest_size=16)
    for path in paths:
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
        for file in files:
            content = file.read_bytes()
            digest.update(f"{file.relative_to(path.parent).as_posix()} {len(content)}\n".encode())
            digest.update(content)
    return digest.hexdigest()


def tree_digest(folder: Path) -> str:
    """Return a digest of all files in `folder` and below, a function of their paths in there and of their bytes.

    Raises:
        OSError: a file cannot be read.
    """
    return _digest(folder, sorted(path for path in folder.rglob("*") if path.is_file()))


def _digest(folder: Path, files: list[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            content = hashlib.file_digest(stream, "sha256").hexdigest()
        digest.update(f"{content} {file.relative_to(folder).as_posix()}\0".encode())
    return digest.hexdigest()[:_DIGITS]


@lru_cache(maxsize=1)
def _locked_digests(lock: Path, _modified: int) -> Mapping[str, str]:
    # A stage with twenty runs asks twenty times. The loader is the one in C, ten times as fast as ruamel.yaml on
    # thousands of lines, and takes every scalar for text: nothing else is read here, and 12e4 is no number in an MD5.
    try:
        stages = yaml.load(lock.read_text(encoding="utf-8"), yaml.CBaseLoader)["stages"].values()
        outputs = [out for stage in stages for out in stage.get("outs", [])]
        return {out["path"]: out["md5"].removesuffix(".dir") for out in outputs if "md5" in out}
    except (LookupError, TypeError, AttributeError, yaml.YAMLError):
        return {}


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(project_root()), *arguments]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=20).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
