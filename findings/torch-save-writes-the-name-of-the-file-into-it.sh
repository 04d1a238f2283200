#!/usr/bin/env bash
# torch 2.13.0: the bytes of what torch.save writes depend on the name of the file, so that writing a file safely makes it never the same.
#
# torch.save writes a ZIP archive whose entries lie in a folder that is called like the file, without its suffix. The same tensors saved
# as best.pt and as last.pt have two digests. Whoever writes to a temporary name first and renames then, so that nobody finds half a file,
# writes the temporary name into it: with a drawn name (tempfile, a process number) the same weights get other bytes, even another length,
# every time, and whatever compares files by content (DVC, a registry, a test of determinism) sees a change. Saved to a buffer in memory,
# whose bytes are then written under any name, or always under one temporary name in a folder of its own, it is the same each time.
#
# Seen (torch 2.13.0, Python 3.11): as below. This script exits with 0 as long as that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check torch==2.13.0 numpy==2.4.6

cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import hashlib
import io
import os
import sys
import tempfile
import zipfile
from pathlib import Path

import torch

STATE = {"weight": torch.ones(2, 3)}


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12]


def saved(name: str) -> Path:
    """Save under a name."""
    torch.save(STATE, name)
    return Path(name)


def saved_safely(name: str) -> str:
    """Save under a temporary name, rename, and return a digest."""
    handle, temporary = tempfile.mkstemp(dir=".")
    os.close(handle)
    torch.save(STATE, temporary)
    os.replace(temporary, name)
    return digest(Path(name))


def saved_by_buffer(name: str) -> str:
    """Save to memory, write that, and return a digest."""
    buffer = io.BytesIO()
    torch.save(STATE, buffer)
    Path(name).write_bytes(buffer.getvalue())
    return digest(Path(name))


twice = {digest(saved("best.pt")) for _ in range(2)}
named = {digest(saved(name)) for name in ("best.pt", "last.pt")}
safely = {saved_safely("best.pt") for _ in range(3)}
buffered = {saved_by_buffer(name) for name in ("best.pt", "last.pt")}
entries = zipfile.ZipFile(saved("best.pt")).namelist()
print("digests: the same name twice", len(twice), "; two names", len(named), "; three times by a temporary file", len(safely))
print("digests: two names by a buffer", len(buffered), "; entries", entries[:2])
as_described = (len(twice), len(named), len(safely), len(buffered)) == (1, 2, 3, 1)
sys.exit(0 if as_described and all(each.startswith("best/") for each in entries) else 1)
PYTHON
