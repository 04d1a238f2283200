"""Runs that are kept, read back."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, final

from addressed_dynamics.base.errors import TrackingError
from addressed_dynamics.tracking.parents import PARENT_TAG
from addressed_dynamics.tracking.store import find_store, no_foreign_warnings, open_client, without_password

_SHOWN = 5
"""So many runs of the same name are listed."""
_IDENTIFIER = re.compile(r"[0-9a-f]{32}")


@final
@dataclass(frozen=True)
class KeptRun:
    """A run as MLflow has it."""

    client: Any
    """MLflow's client of the store."""
    run_id: str
    """MLflow's identifier."""
    name: str
    """Its name in the runs table."""
    experiment: str
    """Name of its experiment."""
    stage: str
    """The pipeline's stage; `pipeline` of a run of the whole."""
    status: str
    """MLflow's word for how it ended."""
    started: str
    """When, in UTC."""
    params: Mapping[str, str]
    """What it depended on."""
    metrics: Mapping[str, float]
    """The last value of each metric, but for those of the machine."""
    tags: Mapping[str, str]
    """All tags."""
    children: tuple[KeptRun, ...] = ()
    """Runs below it, the last first."""

    def file(self, name: str) -> bytes | None:
        """Return a file that is kept with the run; None if there is none."""
        if name not in {each.path for each in self.client.list_artifacts(self.run_id)}:
            return None
        with tempfile.TemporaryDirectory() as folder:
            return Path(self.client.download_artifacts(self.run_id, name, folder)).read_bytes()


def find_run(name: str) -> KeptRun | None:
    """Return the run with this identifier or name; None if there is none.

    Raises:
        TrackingError: the store cannot be read, or several runs have that name.
    """
    store = find_store()
    if not store.is_there:
        return None
    try:
        with no_foreign_warnings():
            return _find(open_client(store), name)
    except TrackingError:
        raise
    except ModuleNotFoundError as error:
        message = (
            f"{name}: no revision is called so, and to look among the runs in MLflow needs '{error.name}': "
            "pip install 'addressed-dynamics[pipeline]'"
        )
        raise TrackingError(message) from error
    except Exception as error:  # MLflow, its database driver and its HTTP client each raise their own kinds
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        message = f"the runs in MLflow cannot be read ({without_password(reason)})"
        raise TrackingError(message) from error


def _find(client: Any, name: str) -> KeptRun | None:
    experiments = {each.experiment_id: each.name for each in client.search_experiments()}
    wanted = f"attributes.run_id = '{name}'" if _IDENTIFIER.fullmatch(name) else _of_name(name)
    found = client.search_runs([*experiments], wanted, order_by=["start_time DESC"])
    found = [each for each in found if name in (each.info.run_id, each.info.run_name)][: _SHOWN + 1]
    if len(found) > 1:
        shown = ", ".join(f"{each.info.run_id} of {_date(each)}" for each in found[:_SHOWN])
        more = " and more" if len(found) > _SHOWN else ""
        message = f"{name}: several runs in MLflow have that name; give the identifier: {shown}{more}"
        raise TrackingError(message)
    if not found:
        return None
    experiment_id, run_id = found[0].info.experiment_id, found[0].info.run_id
    nested = f"tags.`{PARENT_TAG}` = '{run_id}'"
    below = client.search_runs([experiment_id], nested, order_by=["start_time DESC"])
    children = tuple(_kept(client, each, experiments[experiment_id]) for each in below)
    return _kept(client, found[0], experiments[experiment_id], children)


def _of_name(name: str) -> str:
    """Return the filter for runs of a name; it may let others through, for MLflow knows no way to escape a quote."""
    if '"' not in name:
        return f'attributes.run_name = "{name}"'
    if "'" not in name:
        return f"attributes.run_name = '{name}'"
    pattern = name.replace("'", "_")  # any character
    return f"attributes.run_name LIKE '{pattern}'"


def _kept(client: Any, run: Any, experiment: str, children: tuple[KeptRun, ...] = ()) -> KeptRun:
    metrics = {name: value for name, value in run.data.metrics.items() if not name.startswith("system/")}
    return KeptRun(
        client, run.info.run_id, run.info.run_name, experiment, run.data.tags.get("stage", ""), run.info.status,
        _date(run), dict(run.data.params), metrics, dict(run.data.tags), children,
    )  # fmt: skip


def _date(run: Any) -> str:
    return datetime.fromtimestamp(run.info.start_time / 1000, tz=UTC).strftime("%Y-%m-%d %H:%M")
