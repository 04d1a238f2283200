"""Arrays in messages: as long as in the messages before, and in the order of the names beside them, if any."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from google.protobuf.message import Message

from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.paths import Label, MissingField, Step, is_array, member, shown

NAMES = ("name", "names", "joint_names")
"""Fields whose texts name the elements of the arrays beside them, as in ROS's `JointState` and `JointTrajectory`."""


@dataclass
class Form:
    """What an array was like in the first message that had one."""

    origin: str
    """That message."""
    length: int
    names: list[str] | None
    """The names beside it; None if there were none."""
    places: dict[str, int] = field(default_factory=dict)
    """The place of each name."""

    def adopt(self, names: list[str]) -> None:
        """Take up the names that a later message has, if there were none before."""
        self.names, self.places = names, {name: place for place, name in enumerate(names)}


class Arrays:
    """Finds elements in the arrays of one topic's messages.

    A place stands for the name that was there in the first message, and is followed where later ones have another
    order; an array that is empty, or that lacks the name, has no value. In a recording without names all arrays have to
    be as long as the first.

    Args:
        topic: the topic.
        agreement: what the files before this one looked like.
    """

    def __init__(self, topic: str, agreement: Agreement) -> None:
        self._topic, self._agreement = topic, agreement
        self._forms = dict[Sequence[Step], Form]()
        self._named = set[Sequence[Step]]()
        self._message, self._last_reordered = "", ""
        self.seen = dict[str, None]()
        """Names that stood beside an array in a message, in the order in which they came."""
        self.reordered = 0
        """Messages whose names stood in another order than in the first one."""

    @property
    def names(self) -> dict[str, list[str]]:
        """The names that were followed, by the path of their array."""
        forms = {steps: form for steps, form in self._forms.items() if steps in self._named}
        return {f"{self._topic}{shown(steps)}": form.names or [] for steps, form in forms.items()}

    def begin(self, message: str) -> None:
        """Say which message comes next, for errors."""
        self._message = message

    def place(self, steps: Sequence[Step], containers: Sequence[Any], array: Any, step: int | Label) -> int | None:
        """Return where in `array` the element is that `step` means; None if it has no value. As `look_up` asks for it.

        Raises:
            MissingField: there is no such place, or a name is asked for where there are none.
            ValueError: the array is not as long as the first one, and there are no names.
        """
        if not len(array):
            return None
        names = names_beside(containers, len(array))
        form = self._forms.get(steps) or self._new_form(steps, len(array), names)
        if names is not None:
            if steps not in self._named:
                self.seen |= dict.fromkeys(names)
            self._named.add(steps)
            if form.names is None:
                form.adopt(names)
        if form.names is None or steps not in self._named:
            return self._by_place(form, len(array), step)
        if names is None:
            return None
        if isinstance(step, int) and step >= len(form.names):
            raise MissingField
        name = form.names[step] if isinstance(step, int) else step.name
        if names == form.names:
            return form.places.get(name)
        self.seen |= dict.fromkeys(names)
        if self._last_reordered != self._message:
            self._last_reordered = self._message
            self.reordered += 1
        return names.index(name) if name in names else None

    def _new_form(self, steps: Sequence[Step], length: int, names: list[str] | None) -> Form:
        new = Form(self._message, length, None)
        if names is not None:
            new.adopt(names)
        form = self._forms[steps] = self._agreement.first(f"{self._topic}{shown(steps)}", new)
        return form

    def _by_place(self, form: Form, length: int, step: int | Label) -> int:
        if length != form.length:
            message = (
                f"is an array of {length}, but one of {form.length} in {form.origin}; if two programs write to this "
                "topic, record them on topics of their own"
            )
            raise ValueError(message)
        if isinstance(step, Label):
            raise MissingField
        return step


def names_beside(containers: Sequence[Any], length: int) -> list[str] | None:
    """Return the names of the elements of an array of this length, from what it is in; the nearest counts."""
    for container in reversed(containers):
        for field_name in _name_fields(type(container)):
            if isinstance(container, Mapping) and field_name not in container:
                continue
            names = member(container, field_name)
            if is_array(names) and len(names) == length and isinstance(names[0], str):
                texts = [str(name) for name in names]
                if all(texts) and len(set(texts)) == length:
                    return texts
    return None


def _find_name_fields(kind: type) -> tuple[str, ...]:
    """Return which of `NAMES` are fields of a decoded message of this type; all of them if its fields may be any."""
    if issubclass(kind, Mapping):
        return NAMES
    if issubclass(kind, Message):
        return tuple(name for name in NAMES if name in kind.DESCRIPTOR.fields_by_name)
    return tuple(name for name in NAMES if name in getattr(kind, "__dataclass_fields__", ()))


_name_fields: Callable[[type], tuple[str, ...]] = lru_cache(maxsize=1024)(_find_name_fields)
