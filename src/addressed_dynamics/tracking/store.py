"""Where the runs are kept: the server of MLFLOW_TRACKING_URI, else a folder of the project that may move with it."""

from __future__ import annotations

import importlib
import logging
import os
import re
import sqlite3
import warnings
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit, urlunsplit

from filelock import FileLock

from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.base.versions import project_root
from addressed_dynamics.tracking.views import experiment_tags

UI_PORT = 5000
"""Port on which the user interface listens unless told otherwise."""

ARTIFACTS = "artifacts"
"""Folder of the store with the files of the runs."""

# Read by mlflow when it is imported or at its first request. Without the short retries a server that is down blocks a
# stage for 246 s; what the user has set stays.
ENVIRONMENT = {
    "DO_NOT_TRACK": "true",
    "GIT_PYTHON_REFRESH": "quiet",
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "1",
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "10",
    "MLFLOW_LOGGING_LEVEL": "WARNING",
}

_LOCK_SECONDS = 60.0
_PLACES = (
    ("experiments", "artifact_location"),
    ("runs", "artifact_uri"),
    ("logged_models", "artifact_location"),
    ("model_versions", "storage_location"),
)
"""Columns of MLflow's tables that hold where files are, as absolute addresses."""


@dataclass(frozen=True)
class Store:
    """Where runs are kept."""

    uri: str
    """MLflow's address of it."""
    folder: Path | None
    """Where it lies if it is this project's own; None if MLFLOW_TRACKING_URI names another."""

    @property
    def is_there(self) -> bool:
        """Whether there may be runs: always, if it is not this project's own."""
        return self.folder is None or (self.folder / "mlflow.db").exists()


def find_store() -> Store:
    """Return the store that MLFLOW_TRACKING_URI names, else this project's own."""
    if uri := os.environ.get("MLFLOW_TRACKING_URI"):
        return Store(uri, None)
    folder = project_root() / ".mlflow"
    return Store(f"sqlite:///{folder / 'mlflow.db'}", folder)


def ui_base(store: Store) -> str:
    """Return the address of the user interface of a store, without the password that the store's own may hold."""
    address = urlsplit(store.uri)
    if address.scheme not in {"http", "https"}:
        return f"http://127.0.0.1:{UI_PORT}"
    host = address.netloc.rpartition("@")[2]
    return urlunsplit((address.scheme, host, address.path.rstrip("/"), "", ""))


def without_password(said: str) -> str:
    """Return what an error says without who asks, which stands in the addresses of some servers."""
    return re.sub(r"//[^/\s]*@", "//", said)


def open_client(store: Store) -> Any:
    """Return MLflow's client of a store that is there; the first use of a store that was moved tells it so."""
    prepare_mlflow()
    from mlflow import MlflowClient

    if store.folder is not None and store.is_there:
        with locked(store.folder):
            move_artifacts(store.folder)
    return MlflowClient(store.uri)


def connect(store: Store, experiment: str) -> tuple[Any, str]:
    """Return MLflow's client and the identifier of an experiment, which is made if there is none."""
    prepare_mlflow()
    from mlflow import MlflowClient

    if store.folder is None:
        client = MlflowClient(store.uri)
        return client, _experiment(client, None, experiment)
    store.folder.mkdir(parents=True, exist_ok=True)
    # Three first users at once would each create the tables, and two of them fail.
    with locked(store.folder):
        if store.is_there:
            move_artifacts(store.folder)
        else:
            _make_tables(store.folder)
        client = MlflowClient(store.uri)
        return client, _experiment(client, store.folder, experiment)


def _make_tables(folder: Path) -> None:
    """Make the database of a store, whole or not at all.

    MLflow takes seconds for it, in tens of steps, and can neither use nor mend one that was cut off between two.
    """
    from mlflow import MlflowClient

    with atomic_path(folder / "mlflow.db") as temporary:
        MlflowClient(f"sqlite:///{temporary}").search_experiments(max_results=1)


def locked(folder: Path) -> FileLock:
    """Return the lock that whoever changes more than its own run holds."""
    return FileLock(folder / "store.lock", timeout=_LOCK_SECONDS)


def move_artifacts(folder: Path) -> None:
    """Let a store that was moved or copied keep its files where it is now.

    MLflow writes absolute addresses into the database and has no command that changes them: the runs of a copied
    project would write into the first one's store.
    """
    here = (folder / ARTIFACTS).as_uri()
    with closing(sqlite3.connect(folder / "mlflow.db", timeout=_LOCK_SECONDS)) as database, database:
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        for table, column in _PLACES:
            if table not in tables:
                continue
            for (place,) in database.execute(f"SELECT DISTINCT {column} FROM {table}").fetchall():
                moved = _moved(place, here)
                if moved != place:
                    database.execute(f"UPDATE {table} SET {column} = ? WHERE {column} = ?", (moved, place))


def _moved(place: str | None, here: str) -> str | None:
    if place is None or place.startswith(f"{here}/"):
        return place
    inside = f"/.mlflow/{ARTIFACTS}/"
    if place.startswith("file://") and inside in place:
        return f"{here}/{place.rpartition(inside)[2]}"
    # The experiment that MLflow itself makes in every store.
    return f"{here}/Default" if place.endswith("/mlruns/0") else place


def _experiment(client: Any, folder: Path | None, name: str) -> str:
    found = client.get_experiment_by_name(name)
    if found is not None:
        experiment_id, known = str(found.experiment_id), dict(found.tags)
    else:
        place = None if folder is None else (folder / ARTIFACTS / name).as_uri()
        experiment_id, known = str(client.create_experiment(name, artifact_location=place)), {}
    for key, value in experiment_tags(experiment_id, known).items():
        client.set_experiment_tag(experiment_id, key, value)
    return experiment_id


def prepare_mlflow() -> None:
    """Import MLflow, after telling it to be quiet and to send nothing."""
    for key, value in ENVIRONMENT.items():
        os.environ.setdefault(key, value)
    importlib.import_module("mlflow")
    # The first use of a store reports every table it creates.
    logging.getLogger("alembic").setLevel(logging.WARNING)
    # Shows a traceback of sixty lines for what it raises as well, and what a run then says in one.
    logging.getLogger("mlflow.store.db.utils").setLevel(logging.CRITICAL)
    # Has eight lines of what the database says where it cannot keep the machine's metrics.
    logging.getLogger("mlflow.system_metrics.system_metrics_monitor").addFilter(_first_line)


def _first_line(record: logging.LogRecord) -> bool:
    record.msg = str(record.msg).partition("\n")[0]
    return True


@contextmanager
def current_store(uri: str) -> Iterator[None]:
    """Make `uri` the store of MLflow's global functions, without its side effect on the environment."""
    import mlflow

    before = os.environ.get("MLFLOW_TRACKING_URI")
    mlflow.set_tracking_uri(uri)
    try:
        yield
    finally:
        os.environ.pop("MLFLOW_TRACKING_URI", None)
        if before is not None:
            os.environ["MLFLOW_TRACKING_URI"] = before


@contextmanager
def no_foreign_warnings() -> Iterator[None]:
    """Ignore warnings: what MLflow uses that other libraries deprecate is no concern of a stage, nor of its tests."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
