"""Runs in MLflow: the only file that imports mlflow.

Tracking must never kill training. Whatever fails while a run is open (no server, a broken store, a full disk) becomes
one warning, and from then on the run keeps nothing; the same figures are in `data/figures` in any case.
"""

from __future__ import annotations

import getpass
import importlib
import json
import logging
import os
import socket
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, final
from urllib.parse import urlsplit, urlunsplit

import numpy as np
from filelock import FileLock
from jaxtyping import Float32

from addressed_dynamics.base.errors import TrackingError
from addressed_dynamics.base.versions import code_changed, data_digest, git_commit, output_digests, project_root
from addressed_dynamics.base.versions import code_version as code_version  # for stages that look for it here

if TYPE_CHECKING:
    import torch

UI_PORT = 5000
"""Port on which `serve_ui` listens unless told otherwise, and which links in reports name."""

OUTPUT_TAG = "output"
"""Tag of a finished run: the digests of what it made, with spaces between them, see `output_digests`."""

OVERVIEW_COLUMNS = (
    "tags.`stage`",
    "params.`seed`",
    "params.`variant`",
    "params.`baseline`",
    "metrics.`loss/train`",
    "metrics.`loss/validation`",
    "metrics.`loss/selected`",
    "metrics.`agreement`",
    "metrics.`regret/mean`",
)
"""Columns of the runs table in the saved view `overview`; MLflow itself shows no metric at first."""

_VIEW = "overview"
_WORKFLOW = "?workflowType=machine_learning"  # or the UI shows its pages for language models
_FLUSH_COUNT = 500  # a request to MLflow takes at most 1,000 metrics
_FLUSH_SECONDS = 5.0  # so that the curves of a long training grow while one watches
_LOCK_SECONDS = 60.0

# Read by mlflow when it is imported or at its first request. Without the short retries a server that is down blocks a
# stage for 246 s; what the user has set stays.
_ENVIRONMENT = {
    "DO_NOT_TRACK": "true",
    "GIT_PYTHON_REFRESH": "quiet",
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR": "false",
    "MLFLOW_HTTP_REQUEST_BACKOFF_FACTOR": "1",
    "MLFLOW_HTTP_REQUEST_MAX_RETRIES": "1",
    "MLFLOW_HTTP_REQUEST_TIMEOUT": "10",
    "MLFLOW_LOGGING_LEVEL": "WARNING",
}

_log = logging.getLogger(__name__)
_log.setLevel(logging.WARNING)  # its own, because some of what mlflow imports silences the root logger


@final
@dataclass(frozen=True)
class RunReference:
    """Where a run is found again."""

    run_id: str
    """MLflow's identifier of the run."""
    experiment_id: str
    """MLflow's identifier of the run's experiment."""
    name: str
    """The run's name as the runs table shows it."""


@final
class Run:
    """A run while it is open; after the first failure it takes everything and keeps nothing."""

    def __init__(self, client: Any, reference: RunReference | None) -> None:
        self._client = client
        self._reference = reference
        self._works = reference is not None
        self._buffer: list[Any] = []
        self._digests: dict[str, None] = {}  # a set that keeps the order
        self._flushed = time.monotonic()

    @property
    def id(self) -> str | None:
        """MLflow's identifier of the run; None if it could not be opened."""
        return self._reference.run_id if self._reference else None

    @property
    def url(self) -> str | None:
        """The run's page in the UI; None if it could not be opened."""
        return run_link(self._reference) if self._reference else None

    def log(self, metrics: Mapping[str, float], step: int) -> None:
        """Log `metrics` at `step` (an epoch); they are sent in batches.

        A prefix before a slash, as in `loss/train`, becomes a section of charts.
        """
        if not self._works:
            return
        from mlflow.entities import Metric

        now = int(time.time() * 1000)
        self._buffer += [Metric(key, float(value), now, step) for key, value in metrics.items()]
        if len(self._buffer) >= _FLUSH_COUNT or time.monotonic() - self._flushed > _FLUSH_SECONDS:
            self.flush()

    def flush(self) -> None:
        """Send the metrics that are still in memory."""
        while self._buffer and self._works:
            batch, self._buffer = self._buffer[:_FLUSH_COUNT], self._buffer[_FLUSH_COUNT:]
            self._attempt("metrics", partial(self._client.log_batch, metrics=batch))
        self._flushed = time.monotonic()

    def log_artifact(self, path: Path, folder: str | None = None) -> None:
        """Keep a copy of the file or folder at `path` with the run, in `folder` among its artifacts."""
        send = "log_artifacts" if path.is_dir() else "log_artifact"
        self._attempt(str(path), lambda run_id: getattr(self._client, send)(run_id, str(path), folder))

    def log_dataset(self, name: str, path: Path, digest: str | None = None) -> None:
        """Say which data the run used; `digest` is by default what DVC has for `path`, see `data_digest`."""
        digest = digest or data_digest(path)
        self._attempt(f"the dataset {name}", lambda run_id: self._log_dataset(run_id, name, path, digest))

    def log_model(self, module: torch.nn.Module, input_example: Float32[np.ndarray, "sample input"], name: str) -> None:
        """Keep `module` with the run as an MLflow model that loads without this package and without pickle.

        Args:
            module: maps one batch of inputs to one batch of outputs, and can be traced by `torch.export`.
            input_example: at least two samples; with one, the traced batch size would be fixed at one.
            name: name of the model among the run's models.
        """
        # A model that cannot be traced says nothing about the store: what comes after it is still worth a try.
        log = partial(self._log_model, module=module, input_example=input_example, name=name)
        self._attempt(f"the model {name}", log, give_up=False)

    def log_output(self, folder: Path) -> None:
        """Take the digests of what the run wrote into `folder`: its tag if it ends well, by which `find_runs` finds it.

        Nothing is written there: an output that named its run would differ each time that it is made.
        """
        self._attempt(f"the digest of {folder}", lambda _: self._take_digests(folder), give_up=False)

    def _take_digests(self, folder: Path) -> None:
        digests = output_digests(folder).values()
        if not digests:
            message = "there are no files in it"
            raise TrackingError(message)
        self._digests |= dict.fromkeys(digests)

    def _log_dataset(self, run_id: str, name: str, path: Path, digest: str | None) -> None:
        from mlflow.entities import Dataset, DatasetInput, InputTag

        dataset = Dataset(name, digest or "unknown", source_type="local", source=json.dumps({"uri": path.as_posix()}))
        tags = [InputTag("mlflow.data.context", "training")]
        self._client.log_inputs(run_id, datasets=[DatasetInput(dataset, tags)])
        if digest is not None:
            self._client.set_tag(run_id, "data_md5", digest)

    def _log_model(
        self, run_id: str, module: torch.nn.Module, input_example: Float32[np.ndarray, "sample input"], name: str
    ) -> None:
        import mlflow.pytorch
        import torch
        from mlflow.models import Model, infer_signature

        with torch.no_grad():
            output = module(torch.from_numpy(input_example)).numpy()
        # Created here and logged with Model.log, because mlflow.pytorch.log_model knows no run and no experiment but
        # the active ones, and ends the run.
        experiment_id = self._client.get_run(run_id).info.experiment_id
        model = self._client.create_logged_model(experiment_id, name=name, source_run_id=run_id)
        with _current_store(self._client.tracking_uri):
            Model.log(
                artifact_path=None,
                flavor=mlflow.pytorch,
                model_id=model.model_id,
                run_id=run_id,
                pytorch_model=module,
                signature=infer_signature(input_example, output),
                input_example=input_example,
                serialization_format="pt2",
                # Given, because finding them out takes MLflow 5 to 11 s.
                pip_requirements=[f"torch=={torch.__version__.partition('+')[0]}", f"numpy=={np.__version__}"],
            )

    def _attempt(self, what: str, action: Callable[[str], object], *, give_up: bool = True) -> None:
        if not self._works or self._reference is None:
            return
        try:
            with _no_foreign_warnings():
                action(self._reference.run_id)
        except Exception as error:  # MLflow, its database driver and its HTTP client each raise their own kinds
            self._works = not give_up
            _warn(f"could not keep {what}", error)

    def _close(self, status: str) -> None:
        self.flush()
        if self._reference is None:
            return
        if self._digests and status == "FINISHED":
            tag = " ".join(self._digests)
            self._attempt("the digests", lambda run_id: self._client.set_tag(run_id, OUTPUT_TAG, tag))
        try:
            with _no_foreign_warnings():
                self._client.set_terminated(self._reference.run_id, status)
        except Exception as error:  # see _attempt
            if self._works:
                _warn("could not close the run", error)


@contextmanager
def run(
    *,
    stage: str,
    experiment: str,
    name: str,
    params: Mapping[str, Any],
    params_file: Path | None = None,
    tags: Mapping[str, str] | None = None,
) -> Iterator[Run]:
    """Open a run, and close it as finished, failed (an exception) or killed (Ctrl-C and what is no `Exception`).

    What ends the block goes on after the run is closed.

    Args:
        stage: the pipeline's stage, for instance `train_ensemble`.
        experiment: name of the experiment, one per environment.
        name: what tells this run from others at a glance, for instance `mountaincar ensemble n=2 lr=1e-4 seed=0`.
        params: what the run depends on; nested mappings are flattened to dotted keys.
        params_file: the params file they come from.
        tags: further tags.
    """
    all_tags = {"stage": stage, "experiment": experiment, **_provenance(stage), **(tags or {})}
    if params_file is not None:
        all_tags["params_file"] = params_file.as_posix()
    with _no_foreign_warnings():
        opened = _open(experiment, name, params, all_tags)
    try:
        yield opened
    except Exception:
        opened._close("FAILED")
        raise
    except BaseException:
        opened._close("KILLED")
        raise
    opened._close("FINISHED")


def find_runs(experiment: str, digests: Iterable[str]) -> dict[str, RunReference]:
    """Return the last run of `experiment` that made each of the outputs with these digests.

    Only finished runs count: one that failed, was killed or was never closed made nothing that is still there.

    Args:
        experiment: name of the experiment.
        digests: as in `output_digests`; one that no run made is left out.

    Returns:
        The runs by digest; nothing, and a warning, if the store cannot be read.
    """
    store = _store()
    if store.folder is not None and not (store.folder / "mlflow.db").exists():
        return {}
    try:
        with _no_foreign_warnings():
            _prepare_mlflow()
            return _finished_runs(store.uri, experiment, digests)
    except Exception as error:  # see Run._attempt
        _warn(f"could not look for the runs of {experiment}", error)
        return {}


def run_link(reference: RunReference) -> str:
    """Return the address of a run's page: on the server of MLFLOW_TRACKING_URI, else where `serve_ui` shows it."""
    return f"{_ui_base()}/#/experiments/{reference.experiment_id}/runs/{reference.run_id}{_WORKFLOW}"


def experiment_link(experiment_id: str) -> str:
    """Return the address of an experiment's runs table with the columns of the saved view."""
    return f"{_ui_base()}/#/experiments/{experiment_id}/runs{_WORKFLOW}&viewStateShareKey={_VIEW}"


def serve_ui(port: int = UI_PORT) -> NoReturn:
    """Become the MLflow UI on 127.0.0.1, on the store that the stages write to; Ctrl-C ends it.

    Raises:
        TrackingError: there is no store yet, it lies on a server that has its own UI, or the port is taken.
    """
    store = _store()
    if urlsplit(store.uri).scheme in {"http", "https"}:
        message = f"the runs are on the server of MLFLOW_TRACKING_URI: open {_ui_base()} in a browser"
        raise TrackingError(message)
    if store.folder is not None and not (store.folder / "mlflow.db").exists():
        message = f"{store.folder}: there are no runs yet; 'make run' or 'dvc repro' makes them"
        raise TrackingError(message)
    _check_port(port)
    command = [sys.executable, "-m", "mlflow", "server", "--host", "127.0.0.1", "--port", str(port), "--workers", "1"]
    if store.folder is not None:
        command += ["--default-artifact-root", (store.folder / "artifacts").as_uri()]
    # Without the job runner the UI starts in a third of the time and takes a quarter of the memory.
    environment = {**_ENVIRONMENT, **os.environ, "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
    environment["MLFLOW_BACKEND_STORE_URI"] = store.uri  # not an option: a list of processes shows those
    # In place of this process, so that Ctrl-C and a signal from outside reach the server itself and leave no orphan.
    os.execve(sys.executable, command, environment)


@dataclass(frozen=True)
class _Store:
    uri: str
    folder: Path | None
    """Where the store lies if it is this project's own; None if MLFLOW_TRACKING_URI names another."""


def _store() -> _Store:
    if uri := os.environ.get("MLFLOW_TRACKING_URI"):
        return _Store(uri, None)
    folder = project_root() / ".mlflow"
    return _Store(f"sqlite:///{folder / 'mlflow.db'}", folder)


def _ui_base() -> str:
    address = urlsplit(_store().uri)
    if address.scheme not in {"http", "https"}:
        return f"http://127.0.0.1:{UI_PORT}"
    # A password in MLFLOW_TRACKING_URI must not end up in a report.
    host = address.netloc.rpartition("@")[2]
    return urlunsplit((address.scheme, host, address.path.rstrip("/"), "", ""))


def _open(experiment: str, name: str, params: Mapping[str, Any], tags: Mapping[str, str]) -> Run:
    try:
        _prepare_mlflow()
        store = _store()
        if store.folder is None:
            client, experiment_id = _connect(store, experiment)
        else:
            store.folder.mkdir(parents=True, exist_ok=True)
            # Three first users at once would each create the tables, and two of them fail.
            with FileLock(store.folder / "store.lock", timeout=_LOCK_SECONDS):
                client, experiment_id = _connect(store, experiment)
        reference = _create_run(client, experiment_id, name, params, tags)
    except Exception as error:  # see Run._attempt
        _warn("could not open a run", error)
        return Run(None, None)
    return Run(client, reference)


def _prepare_mlflow() -> None:
    for key, value in _ENVIRONMENT.items():
        os.environ.setdefault(key, value)
    importlib.import_module("mlflow")
    # The first use of a store reports every table it creates.
    logging.getLogger("alembic").setLevel(logging.WARNING)


def _connect(store: _Store, experiment: str) -> tuple[Any, str]:
    from mlflow import MlflowClient

    client = MlflowClient(store.uri)
    found = client.get_experiment_by_name(experiment)
    if found is not None:
        return client, found.experiment_id
    artifacts = None if store.folder is None else (store.folder / "artifacts" / experiment).as_uri()
    experiment_id = client.create_experiment(experiment, artifact_location=artifacts)
    for key, value in _experiment_tags(experiment_id).items():
        client.set_experiment_tag(experiment_id, key, value)
    return client, experiment_id


def _experiment_tags(experiment_id: str) -> dict[str, str]:
    """Return the tags that make the runs table useful (format read from the UI of MLflow 3.17).

    A saved view is a name, two times and a state, itself JSON in a string; it is shown at an address that ends in
    `viewStateShareKey=overview`, to which the experiment's description links.
    """
    now = int(time.time() * 1000)
    state = {
        "selectedColumns": list(OVERVIEW_COLUMNS),
        "columnOrder": ["attributes.`Run Name`", "runDateAndNestInfo"],
        "columnWidths": {"attributes.`Run Name`": 330, "runDateAndNestInfo": 130},
        "orderByKey": "attributes.start_time",
        "orderByAsc": False,
    }
    view = {"name": "Overview", "createdAt": now, "updatedAt": now, "state": json.dumps(state)}
    return {
        "mlflow.experimentKind": "custom_model_development",
        f"mlflow.sharedViewState.{_VIEW}": json.dumps(view),
        "mlflow.note.content": f"[Runs with losses and parameters]({experiment_link(experiment_id)})",
    }


def _finished_runs(uri: str, experiment: str, digests: Iterable[str]) -> dict[str, RunReference]:
    from mlflow import MlflowClient

    client = MlflowClient(uri)
    kept = client.get_experiment_by_name(experiment)
    if kept is None:
        return {}
    found = dict[str, RunReference]()
    for digest in digests:
        wanted = f"attributes.status = 'FINISHED' and tags.{OUTPUT_TAG} LIKE '%{digest}%'"
        for run in client.search_runs([kept.experiment_id], wanted, max_results=1, order_by=["start_time DESC"]):
            found[digest] = RunReference(run.info.run_id, kept.experiment_id, run.info.run_name)
    return found


def _create_run(
    client: Any, experiment_id: str, name: str, params: Mapping[str, Any], tags: Mapping[str, str]
) -> RunReference:
    from mlflow.entities import Param

    created = client.create_run(experiment_id, tags=dict(tags), run_name=name)
    client.log_batch(created.info.run_id, params=[Param(key, value) for key, value in _flatten(params)])
    return RunReference(created.info.run_id, experiment_id, name)


def _flatten(params: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in params.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value if isinstance(value, str) else json.dumps(value)


def _provenance(stage: str) -> dict[str, str]:
    tags = {
        "mlflow.source.name": f"pipeline/{stage}.py",
        "mlflow.source.type": "LOCAL",
    }
    with suppress(OSError, KeyError):  # a container's user may have no name
        tags["mlflow.user"] = getpass.getuser()
    if name := os.environ.get("DVC_EXP_NAME"):
        tags["dvc_experiment"] = name
    if commit := git_commit():
        tags |= {"git_commit": commit, "mlflow.source.git.commit": commit}
        tags["git_dirty"] = "true" if code_changed() else "false"
    return tags


def _check_port(port: int) -> None:
    with socket.socket() as probe:
        # As the server itself does: a port whose last connections are still closing is free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as error:
            message = f"port {port} of 127.0.0.1 cannot be used ({error}); choose another one"
            raise TrackingError(message) from error


@contextmanager
def _current_store(uri: str) -> Iterator[None]:
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
def _no_foreign_warnings() -> Iterator[None]:
    """Ignore warnings: what MLflow uses that other libraries deprecate is no concern of a stage, nor of its tests."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _warn(what: str, error: Exception) -> None:
    reason = (str(error).strip() or type(error).__name__).splitlines()[0]
    _log.warning("MLflow: %s (%s); going on without tracking, the figures are still in data/figures", what, reason)
