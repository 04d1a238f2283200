"""How the outputs of the addressing network choose the members, or mix them."""

from collections.abc import Sequence
from typing import Literal

from addressed_dynamics.base.errors import ModelError

Mode = Literal["argmax", "sample", "mixture", "blend"]
MODES: tuple[Mode, ...] = ("argmax", "sample", "mixture", "blend")
"""`argmax` is the paper's; the others are its future work."""


def no_mode(mode: object, modes: Sequence[str]) -> ModelError:
    """Return the error that says that `mode` is none of the modes of a kind of model."""
    return ModelError(f"there is no addressing mode '{mode}' (modes: {', '.join(modes)})")


def check_choice(mode: str, members: int) -> None:
    """Check that a model has members among which a mode can choose.

    Raises:
        ModelError: it is a single network.
    """
    if members == 1:
        message = f"mode '{mode}' was asked for, but this is a single network, which has no modes; leave 'mode' out"
        raise ModelError(message)
