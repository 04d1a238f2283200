"""Where the licensed motion-capture files lie, if they are there: never in the repository."""

import os
from pathlib import Path

import pytest

PFNN_DATA = Path(os.environ.get("PFNN_DATA", Path(__file__).parents[2] / "shared" / "data" / "pfnn"))
"""The folder of real clips, of the database made from them, and of the released network."""

needs_pfnn_data = pytest.mark.skipif(
    not PFNN_DATA.is_dir(), reason="the licensed PFNN data are not on this machine (PFNN_DATA names their folder)"
)
