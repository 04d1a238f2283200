"""What makes the documents: their figures from runs, their pages from the code. No user of the package needs it."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
"""Root of the repository."""
