"""What the import of foreign logs counted: read, dropped, resampled, late, by file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from addressed_dynamics.base.errors import TableError


class ImportRecord(BaseModel):
    """The file import.json that the import leaves beside the logs it writes; what else is in it is for people."""

    model_config = ConfigDict(frozen=True, extra="allow")

    files: dict[str, dict[str, int]]
    """Counts by file that was imported, each with a name such as `dropped`."""
    totals: dict[str, int]
    """The same over all files."""

    @property
    def origins(self) -> dict[str, str]:
        """The file that was imported, by the name of the log it became; a log without a record is not in it."""
        return {each["log"]: origin for origin, each in self._details.items() if isinstance(each.get("log"), str)}

    @property
    def warnings(self) -> list[str]:
        """What the import warned of, each with the file that was imported."""
        return [f"{origin}: {line}" for origin, each in self._details.items() for line in each.get("warnings") or ()]

    @property
    def _details(self) -> dict[str, dict[str, Any]]:
        """What else the record says of each file."""
        details = (self.model_extra or {}).get("details")
        pairs = details.items() if isinstance(details, dict) else ()
        return {origin: each for origin, each in pairs if isinstance(each, dict)}

    def to_json(self) -> dict[str, Any]:
        """Return the record as JSON-compatible values, with the number of warnings if there are any."""
        return self.model_dump() | ({"warnings": len(self.warnings)} if self.warnings else {})

    @property
    def other_rates(self) -> dict[str, float]:
        """The measured rate of each file that has another one than the import was given, in Hz."""
        details = (self.model_extra or {}).get("details")
        details = details if isinstance(details, dict) else {}
        rates = {
            origin: details[origin].get("measured_hz")
            for origin, counts in self.files.items()
            if counts.get("off_rate") and isinstance(details.get(origin), dict)
        }
        return {origin: float(rate) for origin, rate in rates.items() if isinstance(rate, int | float)}


def read_import_record(path: Path) -> ImportRecord | None:
    """Read the record at `path`; None if there is none, because the logs were recorded and not imported.

    Raises:
        TableError: the file cannot be read or has another form.
    """
    if not path.exists():
        return None
    try:
        return ImportRecord.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        reason = str(error) if isinstance(error, OSError) else error.errors(include_url=False)[0]["msg"]
        message = f"{path}: expected the counts of an import by file, found something else ({reason}); import again"
        raise TableError(message) from error
