"""The section `source`: logs and tables that somebody else recorded, and which of their fields make a transition."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from addressed_dynamics.base.params.sections import Positive, Section

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
"""Name of a dimension, as a log can hold it."""
Text = Annotated[str, Field(min_length=1)]


def _one_or_more(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


Files = Annotated[tuple[Text, ...], BeforeValidator(_one_or_more), Field(min_length=1)]


class FieldParams(Section):
    """One dimension, or several if the field is a slice: `joint` of `position[0:6]` becomes `joint_0` … `joint_5`."""

    field: Text
    """`/topic.field.sub[0]` in an MCAP log, the name of a column in a table; `[0:6]` takes six elements of an array."""
    unit: str = ""
    """Unit of its values, for people."""
    offset: float = 0.0
    """Taken off every value, and off low and high, before the value becomes a float32, which has only seven digits."""
    low: float | None = None
    """Lowest possible value; null if unbounded."""
    high: float | None = None
    """Highest possible value; null if unbounded."""


class DiscreteParams(Section):
    """Actions that are numbers, from 0, or names; numbers are names where a name is the text of a number."""

    field: Text
    """Where the number or the name is, as in a dimension."""
    names: Annotated[tuple[Text, ...], Field(min_length=1)]
    """One name for each action, in the order of their numbers."""


class ActionParams(Section):
    """The action: either a vector or one of finitely many."""

    continuous: Annotated[dict[Name, FieldParams], Field(min_length=1)] | None = None
    """The components of a vector, in order."""
    discrete: DiscreteParams | None = None

    @model_validator(mode="after")
    def _is_of_one_kind(self) -> ActionParams:
        if (self.continuous is None) == (self.discrete is None):
            message = "an action is either continuous or discrete; give one of the two keys"
            raise ValueError(message)
        return self


class EpisodePerFile(Section):
    """A file is an episode."""

    by: Literal["file"]


class EpisodeByGap(Section):
    """An episode ends where an observed topic is silent for long."""

    by: Literal["gap"]
    seconds: Positive
    """A silence that is longer ends the episode."""


class EpisodeByTopic(Section):
    """An episode ends where a field changes its value."""

    by: Literal["topic"]
    field: Text
    """A number or a text; however old, its newest value holds."""


class EpisodeByColumn(Section):
    """An episode is what has the same value in a column; its rows stand together."""

    by: Literal["column"]
    column: Text
    """Numbers or texts."""


class EpisodeByEnd(Section):
    """An episode ends where `terminated` or `truncated` says so, and goes on in the next file if the clock does."""

    by: Literal["end"]


class ClockParams(Section):
    """The column that says when a row was recorded: a step that is not one period begins another episode."""

    column: Text | None = None
    """Column of the time: numbers, or dates in a Parquet table."""
    unit: Literal["s", "ms", "us", "ns"] = "s"
    """Unit of the time, if it is a number."""
    tolerance: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.5
    """Share of a period by which a step may be longer or shorter."""
    frame: Text | None = None
    """Column that counts the rows, in place of a time: a step that is not one begins another episode."""

    @model_validator(mode="after")
    def _is_time_or_frame(self) -> ClockParams:
        if (self.column is None) == (self.frame is None):
            message = "a clock is a time or counts rows; give one of the two keys column and frame"
            raise ValueError(message)
        return self


class _Fields(Section):
    observation: Annotated[dict[Name, FieldParams], Field(min_length=1)]
    """The dimensions of an observation, in order."""
    action: ActionParams
    exogenous: dict[Name, FieldParams] = Field(default_factory=dict)
    """Exogenous inputs, in order: what acts on the world and is known, not predicted, such as a wind or a setpoint. As
    of the action, the value at the beginning of a step counts for it."""
    reward: str | None
    """Field of the reward; null if there is none, which makes it 0."""
    min_length: Annotated[int, Field(ge=2)]
    """Episodes with fewer samples are dropped; K samples make K - 1 transitions."""
    terminated: Text | None = None
    """Field that is true, or not 0, in the last sample of an episode that ends for a reason inside the task."""
    truncated: Text | None = None
    """Field that is true, or not 0, in the last sample of an episode that ends for another reason."""


class _Source(_Fields):
    rate_hz: Positive
    """Steps in a second."""

    @model_validator(mode="after")
    def _has_ends(self) -> _Source:
        ends = isinstance(getattr(self, "episode", None), EpisodeByEnd)
        if ends and self.terminated is None and self.truncated is None:
            message = "episode: {by: end} needs a field that says where an episode ends; give terminated or truncated"
            raise ValueError(message)
        return self


class EpisodeByReset(Section):
    """An episode ends where time goes back by more than the tolerance, as where a simulation starts again."""

    by: Literal["reset"]


Clock = Literal["log", "publish", "header"]


class TopicParams(Section):
    """What holds for one topic and not for the others."""

    time: Clock | None = None
    """Which time of its messages counts; null: that of the source."""
    tolerance_s: Positive | None = None
    """How old its newest value may be, in seconds; null: as the source says."""
    hold: bool = False
    """Its newest value holds however old it is: for what is sent once, such as a goal."""

    @model_validator(mode="after")
    def _has_one_age(self) -> TopicParams:
        if self.hold and self.tolerance_s is not None:
            message = "a value that is held may be of any age; leave out 'tolerance_s' or 'hold'"
            raise ValueError(message)
        return self


class McapSource(_Source):
    """Topics of MCAP logs or of bags of ROS 2, brought to one clock.

    Unless a file is an episode, files that follow each other are one recording: recorders split what they write.
    """

    kind: Literal["mcap"]
    files: Files
    """Patterns of `.mcap` and `.db3` files, relative to the folder that the stage runs in, and of bags: folders with a
    `metadata.yaml`, each of which is one recording. One pattern, or a list."""
    types: Annotated[tuple[Text, ...], BeforeValidator(_one_or_more)] = ()
    """Folders with `.msg` files, or such files, that define the messages of bags that do not carry the definitions. A
    change of them makes the import run again if they lie in the folder that is imported."""
    tolerance_s: Positive
    """At a tick of the clock the newest value of a topic holds if it is not older than this, in seconds."""
    time: Clock = "log"
    """Which time of a message counts: when it was logged, when it was published, or what it says of itself, in
    `header.stamp`, `stamp` or `timestamp`."""
    topics: dict[Text, TopicParams] = Field(default_factory=dict)
    """What holds for some topics alone, by their names."""
    episode: Annotated[
        EpisodePerFile | EpisodeByGap | EpisodeByTopic | EpisodeByReset | EpisodeByEnd, Field(discriminator="by")
    ]

    def clock(self, topic: str) -> Clock:
        """Return which time of a topic's messages counts."""
        return self.topics.get(topic, TopicParams()).time or self.time

    def longest_age_ns(self, topic: str) -> int | None:
        """Return how old the newest value of a topic may be, in nanoseconds; None if however old."""
        own = self.topics.get(topic, TopicParams())
        return None if own.hold else round((own.tolerance_s or self.tolerance_s) * 1e9)


class TableSource(_Source):
    """Tables with a row per step."""

    files: Files
    """Patterns of file names, relative to the folder that the stage runs in; one, or a list."""
    episode: Annotated[EpisodePerFile | EpisodeByColumn | EpisodeByEnd, Field(discriminator="by")]
    clock: ClockParams | None = None
    """When each row was recorded; null if nothing says it, and all steps are taken for one period."""


class CsvSource(TableSource):
    """Tables as text with a row per line; the first line has the names of the columns."""

    kind: Literal["csv"]
    separator: Annotated[str, Field(pattern=r"^[ -~\t]$")] = ","
    """The character between two cells; blanks beside it do not count."""
    decimal: Literal[".", ","] = "."
    """The sign between the whole and the rest of a number."""
    comment: Text | None = None
    """Lines that begin with this are not read."""
    missing: tuple[str, ...] = ("nan", "NaN", "NAN", "null", "NULL", "NA", "N/A", "n/a", "<NA>", "#N/A", "None")
    """What stands in a cell without a value, beside nothing at all."""

    @model_validator(mode="after")
    def _can_tell_numbers_apart(self) -> CsvSource:
        if self.separator == self.decimal:
            message = f"separator and decimal are both '{self.separator}', but they should differ"
            raise ValueError(message)
        return self


class ParquetSource(TableSource):
    """Parquet tables with a row per step."""

    kind: Literal["parquet"]


class LerobotSource(_Fields):
    """A LeRobot dataset of version 2 or 3, which knows its episodes, its rate and the names in its vectors."""

    kind: Literal["lerobot"]
    folder: Text
    """The folder with `data` and `meta` in it."""
    rate_hz: Positive | None = None
    """Steps in a second, which have to be those that the dataset names; null takes them from there."""


class MinariSource(_Source):
    """A Minari dataset, whose columns are `observations`, `actions` and `rewards`; it knows its episodes."""

    kind: Literal["minari"]
    dataset: Text
    """Identifier of a dataset on this machine, or its folder."""

    @model_validator(mode="after")
    def _has_no_ends(self) -> MinariSource:
        if self.terminated is not None or self.truncated is not None:
            message = "a Minari dataset knows where its episodes end; leave out terminated and truncated"
            raise ValueError(message)
        return self


EXAMPLES = {
    "mcap": "files: logs/*.mcap, observation: {q: {field: '/joints.position[0]', unit: rad}}, action: {continuous: "
    "{u: {field: /command.data}}}, reward: null, rate_hz: 20.0, tolerance_s: 0.1, episode: {by: gap, seconds: 1.0}, "
    "min_length: 20",
    "csv": "files: runs/*.csv, observation: {q: {field: angle}}, action: {continuous: {u: {field: torque}}}, "
    "reward: null, rate_hz: 20.0, clock: {column: t}, episode: {by: file}, min_length: 20",
    "parquet": "files: runs/*.parquet, observation: {q: {field: 'state[0:2]'}}, action: {continuous: {u: {field: "
    "'action[0]'}}}, reward: null, rate_hz: 20.0, episode: {by: column, column: episode}, min_length: 20",
    "lerobot": "folder: data/so101, observation: {q: {field: 'observation.state[0:6]'}}, action: {continuous: "
    "{u: {field: 'action[0:6]'}}}, reward: null, min_length: 20",
    "minari": "dataset: D4RL/pen/human-v2, observation: {q: {field: 'observations[0:45]'}}, action: {continuous: {u: "
    "{field: 'actions[0:24]'}}}, reward: rewards, rate_hz: 20.0, min_length: 20",
}
"""What a section of each kind may look like, for errors."""

SourceParams = Annotated[
    McapSource | CsvSource | ParquetSource | LerobotSource | MinariSource, Field(discriminator="kind")
]
