#!/usr/bin/env bash
# torch 2.13.0: torch.device("cuda:256") is cuda:0, "cuda:300" is cuda:44, and "cuda:255" is cuda, whichever that is.
#
# A device keeps its number in 8 bits with a sign. What does not fit is not refused but wraps around, without a word, in a text and as a
# second argument alike: 255 becomes -1, which stands for "none", so that the current device is meant, 128 becomes -128, 256 becomes 0. A
# number of something else that is taken for a device's (a global rank where the rank within a node was meant) so names a device that exists:
# where rank 40 ends with an error, rank 256 works on the first card.
#
# Seen (torch 2.13.0, also in the build without CUDA, Python 3.11): as above. This script exits with 0 as long as that is so, and with
# 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check torch==2.13.0 numpy==2.4.6

"$folder/venv/bin/python" - <<'PYTHON'
import sys

import torch

found = {number: torch.device(f"cuda:{number}").index for number in (127, 128, 255, 256, 300)}
for number, index in found.items():
    print(f"cuda:{number} has the number {index}")
as_described = (
    found == {127: 127, 128: -128, 255: None, 256: 0, 300: 44}
    and torch.device("cuda", 256) == torch.device("cuda:0")
    and torch.device("cuda:255") == torch.device("cuda")
)
sys.exit(0 if as_described else 1)
PYTHON
