"""What can be imported: the fields of logs and tables that nobody has described, with rates, ranges and units."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from dataclasses import field as data_field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64, Int64
from mcap.records import Channel

from addressed_dynamics.importing.arrays import names_beside
from addressed_dynamics.importing.clock import usual_period
from addressed_dynamics.importing.decoding import ZSTANDARD, Decode, decoder_for, unpacked
from addressed_dynamics.importing.paths import FieldPath, Label, Step, is_array, member, member_names
from addressed_dynamics.importing.stamps import STAMPS, own_time
from addressed_dynamics.importing.topics import message_runs
from addressed_dynamics.logs.container import MESSAGE_HEADER, MessageRun

LONGEST_ARRAY = 64
"""Arrays with more elements, such as images, are no numbers of a state."""
DEEPEST = 6
"""Fields further inside are left out."""
MOST_VALUES = 4_000
"""So many messages of a topic are decoded, about evenly spread: twice as many at most."""
SILENCE_S, SILENCE = 1.0, 10.0
"""A silence of more seconds, and of more periods, ends an episode."""
MOST_TEXTS = 12
"""So many different texts of a field are kept, and one more, which says that there are more."""

_UNIT = re.compile(r".*[\[(]([^\[\]()]*[^\d\[\]()][^\[\]()]*)[\])]\s*")


@dataclass
class Field:
    """One number or text that a log has, message after message."""

    field: str
    """How `source` names it."""
    values: array[float] = data_field(default_factory=lambda: array("d"))
    """Its values, as many as were looked at; NaN where it had none."""
    texts: dict[str, int] = data_field(default_factory=dict)
    """How often each text was seen, if it holds texts."""
    unit: str = ""
    """Its unit, as far as its name says it."""
    rate_hz: float | None = None
    """Values a second; None if nothing says when they were recorded."""
    late_s: float = 0.0
    """The 99th percentile of the times between them, in seconds, pauses left out."""
    silent_s: float = 0.0
    """The same with the pauses."""
    topic: str = ""
    """Its topic; empty in a table."""
    total: int = 0
    """Values that there are, looked at or not."""
    extent: tuple[float, float] | None = None
    """The lowest and the highest of all values, where all were looked at for it."""

    @property
    def is_number(self) -> bool:
        """Whether it holds numbers, and no texts."""
        return not self.texts and len(self.finite) > 0

    @property
    def range(self) -> tuple[float, float] | None:
        """The lowest and the highest value, of those that were looked at if not of all; None without numbers."""
        found = self.finite if self.extent is None else np.array(self.extent)
        return (float(found.min()), float(found.max())) if len(found) and self.is_number else None

    @property
    def finite(self) -> Float64[np.ndarray, " value"]:
        """The values that are numbers."""
        values: Float64[np.ndarray, " value"] = np.array(self.values, dtype=np.float64)
        return np.extract(np.isfinite(values), values)

    @property
    def constant(self) -> bool:
        """Whether it has one value throughout."""
        return len(self.texts) == 1 if self.texts else len(np.unique(self.finite)) <= 1


@dataclass(frozen=True)
class Stamps:
    """How the times that messages say of themselves differ from those at which they were logged."""

    topic: str
    median_s: float
    """Logged after the own time, at the median; seconds."""
    spread_s: float
    """Between the 5th and the 95th percentile of that."""


@dataclass(frozen=True)
class Look:
    """What there is in some files of one kind."""

    kind: Literal["mcap", "csv", "parquet", "minari", "lerobot"]
    """The kind of source that reads them."""
    files: tuple[Path, ...]
    """All files, of tables also those that were not looked at."""
    fields: tuple[Field, ...]
    """In the order in which they were found."""
    stamps: tuple[Stamps, ...] = ()
    """For the topics whose messages say their time."""
    unread: dict[str, str] = data_field(default_factory=dict)
    """Topics that cannot be read, and why."""
    clock: dict[str, Any] | None = None
    """The key `clock` of a table that has a column with the time, or one that counts its rows."""
    looked_at: int | None = None
    """Files that were looked at, if not all."""
    options: dict[str, Any] = data_field(default_factory=dict)
    """Keys that say how a CSV file is written, and what types there are beside a log."""


def look_at_logs(files: Sequence[Path], types: tuple[str, ...] = ()) -> Look:
    """Look at all topics of MCAP logs and databases of ROS 2.

    Args:
        files: the logs.
        types: folders or files with definitions of messages, for databases that do not carry them.

    Raises:
        LogError: a file is damaged, or definitions are missing.
    """
    topics = dict[str, _Topic]()
    for path in files:
        channels: dict[int, Channel] = {}
        decoders: dict[int, Decode] = {}
        for channel, schema, run in message_runs(path, channels, types=types):
            topic = topics.setdefault(channel.topic, _Topic(channel.topic))
            if topic.problem:
                continue
            try:
                if channel.id not in decoders:
                    decoders[channel.id] = decoder_for(str(path), channel, schema)
                topic.add(run, decoders[channel.id])
            except Exception as error:  # what cannot be decoded is told, and does not keep the other topics away
                topic.problem = str(error).split("\n", maxsplit=1)[0] or type(error).__name__
    return Look(
        kind="mcap",
        files=tuple(files),
        fields=tuple(each for topic in topics.values() for each in topic.finished()),
        stamps=tuple(found for topic in topics.values() if (found := topic.stamps()) is not None),
        unread={topic.name: topic.problem for topic in topics.values() if topic.problem},
        options={"types": list(types)} if types else {},
    )


def unit_in(name: str) -> str:
    """Return the unit in the name of a column, such as `m/s` in `speed [m/s]`; empty if there is none."""
    match = _UNIT.fullmatch(name)
    return match[1].strip() if match else ""


class _Topic:
    """Decodes some messages of a topic, about evenly spread, however many there are."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.problem = ""
        self._fields = dict[tuple[Step, ...], Field]()
        self._times, self._looked, self._own, self._own_logged = array("q"), array("q"), array("q"), array("q")
        self._every = 1
        self._names = dict[tuple[Step, ...], list[str] | None]()
        # The names beside an array in the first message that had it; None if a message has none.

    def add(self, run: MessageRun, decode: Decode) -> None:
        """Take up messages."""
        data, size, header = run.messages.tobytes(), run.messages.shape[1], MESSAGE_HEADER.itemsize
        times = run.messages[:, :header].copy().view(MESSAGE_HEADER)[:, 0]["log_time"].astype(np.int64)
        for number, time_ns in enumerate(times.tolist(), start=len(self._times)):
            if number % self._every:
                continue
            start = (number - len(self._times)) * size
            payload = data[start + header : start + size]
            self._look(decode(unpacked(payload) if payload[:4] == ZSTANDARD else payload), time_ns)
        self._times.frombytes(times.tobytes())

    def finished(self) -> Iterator[Field]:
        """Yield the fields that were found."""
        rate, late_s, silent_s = _periods(np.array(self._times))
        for steps, each in self._fields.items():
            names = self._names.get(steps[:-1])
            if names is not None and isinstance(steps[-1], int) and steps[-1] < len(names):
                each.field = str(FieldPath(self.name, (*steps[:-1], Label(names[steps[-1]]))))
            each.rate_hz, each.late_s, each.silent_s = rate, late_s, silent_s
            each.total, each.topic = len(self._times), self.name
            yield each

    def stamps(self) -> Stamps | None:
        """Return how the messages' own times differ from those of the log; None if they have none."""
        late = (np.array(self._own_logged) - np.array(self._own)) / 1e9
        if not len(late) or not any(self._own):
            return None
        low, middle, high = np.quantile(late, [0.05, 0.5, 0.95])
        return Stamps(self.name, float(middle), float(high - low))

    def _look(self, message: Any, time_ns: int) -> None:
        seen = len(self._looked)
        for steps, value in self._leaves(message, (), [message]):
            found = self._fields.get(steps)
            if found is None:
                found = self._fields[steps] = Field(str(FieldPath(self.name, steps)))
                found.values.extend([np.nan] * seen)
            _take(found, value, seen)
        self._looked.append(time_ns)
        try:
            self._own.append(own_time(message))
            self._own_logged.append(time_ns)
        except ValueError:
            pass
        if len(self._looked) >= 2 * MOST_VALUES:
            self._thin()

    def _leaves(
        self, value: Any, steps: tuple[Step, ...], containers: list[Any]
    ) -> Iterator[tuple[tuple[Step, ...], Any]]:
        """Yield the numbers and texts of a decoded message; arrays of numbers by element, long ones not at all."""
        names = member_names(value)
        if len(steps) > DEEPEST:
            return
        if names:
            for name in names:
                if (*steps, name) not in _TIMES:
                    inner = member(value, name)
                    yield from self._leaves(inner, (*steps, name), [*containers, inner])
        elif is_array(value):
            if 0 < len(value) <= LONGEST_ARRAY and not isinstance(value[0], str):
                for place, element in enumerate(value):
                    own = (*steps, self._place(steps, containers, place, len(value)))
                    yield from self._leaves(element, own, [*containers, element])
        elif steps and (value is None or isinstance(value, bool | int | float | str | np.number | np.bool_)):
            yield steps, value

    def _place(self, steps: tuple[Step, ...], containers: list[Any], place: int, length: int) -> int:
        """Return where the element stood that has this name in the first message that had it."""
        names = names_beside(containers[:-1], length)
        first = self._names.setdefault(steps, names)
        if first is None or names is None:
            self._names[steps] = None
            return place
        if names[place] not in first:
            # Another program that writes to the same topic, with names of its own.
            first.append(names[place])
        return first.index(names[place])

    def _thin(self) -> None:
        """Forget every other message, and from now on look at half as many."""
        self._every *= 2
        self._looked = self._looked[::2]
        for each in self._fields.values():
            each.values = each.values[::2]


def _take(found: Field, value: Any, seen: int) -> None:
    found.values.extend([np.nan] * (seen - len(found.values)))
    if isinstance(value, str):
        if value in found.texts or len(found.texts) <= MOST_TEXTS:
            found.texts[value] = found.texts.get(value, 0) + 1
        found.values.append(np.nan)
    else:
        found.values.append(np.nan if value is None else float(value))


_TIMES = frozenset(STAMPS)
# A message's own time is looked at as a time.


def _periods(times: Int64[np.ndarray, " message"]) -> tuple[float | None, float, float]:
    """Return the rate, in Hz, and the 99th percentile of the times between messages, without pauses and with them."""
    periods = np.diff(times)[np.diff(times) > 0] / 1e9
    if not len(periods):
        return None, 0.0, 0.0
    usual = usual_period(periods)
    inside = periods[periods <= longest_silence(1 / usual)]
    return 1 / usual, float(np.quantile(inside, 0.99)), float(np.quantile(periods, 0.99))


def longest_silence(rate_hz: float) -> float:
    """Return the longest silence inside an episode, in seconds, if nobody says another one."""
    return max(SILENCE_S, SILENCE / rate_hz)
