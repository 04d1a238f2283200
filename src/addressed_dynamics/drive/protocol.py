"""What a page may say, as checked messages: JSON objects with a `type`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from addressed_dynamics.base.errors import DriveError

Share = Annotated[float, Field(ge=0.0, le=1.0)]
Signed = Annotated[float, Field(ge=-1.0, le=1.0)]


class Message(BaseModel):
    """What all messages have in common: no other keys, no numbers that are none, no guessing of types."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Act(Message):
    """Take an action from now on."""

    type: Literal["act"]
    action: int | list[float]
    """Its number if actions are discrete, else its components in their own units."""


class Exogenous(Message):
    """Let something act on the world from now on."""

    type: Literal["exogenous"]
    values: list[float] | None
    """In their own units; None to replay what was recorded."""


class Command(Message):
    """What a person asks of a character."""

    type: Literal["command"]
    right: Signed = 0.0
    """Where the stick points, seen along the facing."""
    ahead: Signed = 0.0
    turn: Signed = 0.0
    """How fast to turn the facing; to the left is positive."""
    run: Share = 0.0
    """0 walks."""
    strafe: Share = 0.0
    """How much to keep looking along the facing."""
    crouch: Share = 0.0


class Speed(Message):
    """How many steps to make in a second."""

    type: Literal["speed"]
    rate: Annotated[float, Field(gt=0.0)]


class Plain(Message):
    """What needs no more words: start anew, stop, go on, make one step, take the true state, record, stop recording."""

    type: Literal["reset", "pause", "resume", "step", "sync", "record", "stop"]


AnyMessage = Act | Exogenous | Command | Speed | Plain
_ADAPTER: TypeAdapter[AnyMessage] = TypeAdapter(Annotated[AnyMessage, Field(discriminator="type")])


def read_message(text: str) -> AnyMessage:
    """Read what a page said.

    Raises:
        DriveError: it is no message.
    """
    try:
        return _ADAPTER.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(each) for each in first["loc"] if each != "function-after")
        message = f"this is no message that a drive takes ({f'{where}: ' if where else ''}{first['msg']})"
        raise DriveError(message) from error
