"""How the outputs of the addressing network choose the members, or mix them."""

from typing import Literal

Mode = Literal["argmax", "sample", "mixture", "blend"]
MODES: tuple[Mode, ...] = ("argmax", "sample", "mixture", "blend")
"""`argmax` is the paper's; the others are its future work."""
