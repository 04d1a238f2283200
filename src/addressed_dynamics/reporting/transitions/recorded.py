"""What data.json says of recorded transitions."""

from __future__ import annotations

from pydantic import Field

from addressed_dynamics.evaluation.common.records import Record


class SegmentResult(Record):
    """What was recorded in one segment."""

    behaviour: str
    count: int
    transitions: int
    terminated_share_last_100: float | None


class SplitResult(Record):
    """Size of a split."""

    episodes: int
    transitions: int


class Lengths(Record):
    """Lengths in steps."""

    median: float
    min: float
    max: float


class BlocksResult(Record):
    """What became of long episodes that were cut in blocks in time."""

    episodes: int
    blocks: int
    steps: Lengths | None
    """Of the blocks; None if there are none."""
    gap_steps: int
    gaps: int
    dropped: int


class Coverage(Record):
    """How much of the state space the data has seen."""

    cells_per_dimension: int
    per_dimension: dict[str, float]
    plane: float | None


class Duplicates(Record):
    """Rows that repeat an earlier one."""

    rows: int
    share: float


class PlaceResult(Record):
    """Where something was found."""

    log: str
    episode: int | None
    step: int | None
    value: float | None


class FindingResult(Record):
    """One thing that is wrong with the data."""

    meaning: str
    dimension: str
    count: int
    of: int | None
    first: PlaceResult | None
    blocking: bool


class TopicDetails(Record):
    """What the import found of a topic."""

    measured_hz: float | None = None
    """Its messages a second; None if it has too few."""


class FileDetails(Record):
    """What the import found in a file."""

    topics: dict[str, TopicDetails] = Field(default_factory=dict)
    """The topics of a log; none in a table."""
    measured_hz: float | None = None
    """Rows of a table a second; None if nothing says when they were recorded."""
    warnings: tuple[str, ...] = ()


class ImportResult(Record):
    """What the import of foreign logs counted."""

    files: dict[str, dict[str, int]]
    totals: dict[str, int]
    kind: str = ""
    """The kind of the source, for instance `mcap`."""
    rate_hz: float | None = None
    """Steps in a second, as the source says."""
    offsets: dict[str, float] = Field(default_factory=dict)
    """What was taken off the values of a dimension, by its name with its role."""
    details: dict[str, FileDetails] = Field(default_factory=dict)
    """What else is known, by file."""


class RangeResult(Record):
    """Where the values of a dimension lie, in its unit."""

    min: float
    max: float
    low: float | None
    """Lower bound; None, like the next, for none."""
    high: float | None
    unit: str


class DataResult(Record):
    """data.json."""

    transitions: int
    splits: dict[str, SplitResult]
    segments: dict[str, SegmentResult]
    coverage: Coverage
    duplicates: Duplicates
    quality: tuple[FindingResult, ...]
    ranges: dict[str, RangeResult] = Field(default_factory=dict)
    """The dimensions of the state by name; empty in results of earlier versions."""
    exogenous: dict[str, RangeResult] = Field(default_factory=dict)
    """The exogenous inputs by name; none in most worlds."""
    blocks: BlocksResult | None = None
    """None if episodes are split whole."""
    imported: ImportResult | None = Field(default=None, alias="import")
    """None if the data was recorded by this project."""
