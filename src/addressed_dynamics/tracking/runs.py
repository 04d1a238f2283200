"""Runs while they are open, and how they are found again.

Tracking must never kill training. Whatever fails while a run is open (no server, a broken store, a full disk) becomes
one warning, and from then on the run keeps nothing; the same figures are in `data/figures` in any case. That a store is
lost is said once, not again by each run that tries it.
"""

from __future__ import annotations

import getpass
import json
import logging
import math
import os
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, final
from urllib.parse import urlsplit

import numpy as np

from addressed_dynamics.base.criteria import Criterion
from addressed_dynamics.base.errors import TrackingError
from addressed_dynamics.base.files import save_arrays
from addressed_dynamics.base.versions import code_changed, data_digest, git_commit, output_digests
from addressed_dynamics.tracking.parents import (
    DATA_TAG,
    PARENT_TAG,
    PROCESS_TAG,
    Parents,
    Pipeline,
    log_params,
    pipeline_of,
    this_process,
)
from addressed_dynamics.tracking.registry import Offer, Registered, register
from addressed_dynamics.tracking.store import (
    Store,
    connect,
    find_store,
    locked,
    no_foreign_warnings,
    open_client,
    ui_base,
    without_password,
)
from addressed_dynamics.tracking.views import run_path, verdict_tags

if TYPE_CHECKING:
    from addressed_dynamics.simulators.serving import Served

OUTPUT_TAG = "output"
"""Tag of a finished run: the digests of what it made, with spaces between them, see `output_digests`."""

METRICS = "metrics"
"""What a run keeps all the time, and so what is lost first with its store."""

_FLUSH_COUNT = 500  # a request to MLflow takes at most 1,000 metrics
_FLUSH_SECONDS = 5.0  # so that the curves of a long training grow while one watches

_log = logging.getLogger("addressed_dynamics.tracking")
_log.setLevel(logging.WARNING)  # its own, because some of what mlflow imports silences the root logger
_parents = Parents()
_lost = dict[str, float]()
"""Stores of which was said that they are lost, and which nobody has reached since; when to try again."""
_PATIENCE = 10
"""A store that was waited for in vain is left alone so many times as long: a lock or a dead server costs a minute."""


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

    def __init__(self, client: Any, reference: RunReference | None, parent: str | None = None) -> None:
        self._client = client
        self._reference = reference
        self._parent = parent
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
        """The run's page in the UI, see `run_link`; None if it could not be opened."""
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
            self._attempt(METRICS, partial(self._client.log_batch, metrics=batch))
        self._flushed = time.monotonic()

    def log_artifact(self, path: Path, folder: str | None = None) -> None:
        """Keep a copy of the file or folder at `path` with the run, in `folder` among its artifacts."""
        send = "log_artifacts" if path.is_dir() else "log_artifact"
        self._attempt(str(path), lambda run_id: getattr(self._client, send)(run_id, str(path), folder))

    def log_arrays(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep named arrays with the run, in a file `<name>.npz` among its artifacts; nothing if there are none."""
        if arrays:
            self._attempt(name, lambda run_id: self._log_arrays(run_id, name, arrays))

    def _log_arrays(self, run_id: str, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"{name}.npz"
            save_arrays(file, dict(arrays))
            self._client.log_artifact(run_id, str(file))

    def log_dataset(self, name: str, path: Path, context: Literal["training", "evaluation"] = "training") -> None:
        """Say which data the run used, and for what; their digest is what DVC has for `path`, see `data_digest`."""
        self._attempt(f"the dataset {name}", lambda run_id: self._log_dataset(run_id, name, path, context))

    def log_output(self, folder: Path) -> None:
        """Take the digests of what the run wrote into `folder`: its tag if it ends well, by which `find_runs` finds it.

        Nothing is written there: an output that named its run would differ each time that it is made.
        """
        self._attempt(f"the digest of {folder}", lambda _: self._take_digests(folder), give_up=False)

    def conclude(self, verdict: str, figures: Mapping[str, float], outputs: Iterable[str] = ()) -> None:
        """Describe the pipeline's run, or this one without it, and the experiment by what was found.

        Args:
            verdict: in a sentence or two.
            figures: those that a table of runs should show.
            outputs: digests of what it rests on; those of runs below another run of the pipeline are linked to.
        """
        self._attempt("the verdict", lambda run_id: self._conclude(run_id, verdict, figures, outputs), give_up=False)

    def register(
        self,
        name: str,
        pack: Callable[[Path], Served],
        *,
        criteria: Sequence[Criterion],
        figures: Mapping[str, float],
        evaluation: Mapping[str, Any],
        data: Path,
    ) -> Registered | None:
        """Register the model that was delivered, once, and let the alias `champion` move to it if it is better.

        Args:
            name: name of the registered model, that of the experiment.
            pack: writes its files into a new folder, and returns the model, loaded from there.
            criteria: what it reaches on validation data, what counts most first.
            figures: what it reaches on test data; logged with the model.
            evaluation: params of the evaluation.
            data: the tables that it was evaluated on.

        Returns:
            What became of it; None, and a warning, if that failed.
        """
        found: list[Registered] = []

        def act(run_id: str) -> None:
            with tempfile.TemporaryDirectory() as temporary:
                folder = Path(temporary) / "model"
                offer = Offer(name, folder, pack(folder), criteria, figures, evaluation, data_digest(data))
                with _locked_store():
                    found.append(register(self._client, run_id, offer))

        self._attempt(f"the delivered model of {name}", act, give_up=False)
        return found[0] if found else None

    def _conclude(self, run_id: str, verdict: str, figures: Mapping[str, float], outputs: Iterable[str]) -> None:
        from mlflow.entities import Metric

        experiment = self._client.get_experiment(self._client.get_run(run_id).info.experiment_id)
        above, now = self._parent or run_id, int(time.time() * 1000)
        self._client.log_batch(above, metrics=[Metric(key, float(value), now, 0) for key, value in figures.items()])
        made = _finished_runs(find_store(), experiment.name, outputs).values()
        # A training of several outputs is found by each of them.
        elsewhere = {
            run.info.run_id: run.info.run_name for run in made if run.data.tags.get(PARENT_TAG) != self._parent
        }
        links = [f"- [{name}]({run_path(experiment.experiment_id, key)})" for key, name in elsewhere.items()]
        before = ["", "Trained in an earlier run of the pipeline:", "", *links] if links else []
        note = "\n".join([verdict, *before])
        self._client.set_tag(above, "mlflow.note.content", note)
        for key, value in verdict_tags(experiment.experiment_id, experiment.tags, verdict).items():
            self._client.set_experiment_tag(experiment.experiment_id, key, value)

    def _take_digests(self, folder: Path) -> None:
        digests = output_digests(folder).values()
        if not digests:
            message = "there are no files in it"
            raise TrackingError(message)
        self._digests |= dict.fromkeys(digests)

    def _log_dataset(self, run_id: str, name: str, path: Path, context: str) -> None:
        from mlflow.entities import Dataset, DatasetInput, InputTag

        digest = data_digest(path)
        dataset = Dataset(name, digest or "unknown", source_type="local", source=json.dumps({"uri": path.as_posix()}))
        tags = [InputTag("mlflow.data.context", context)]
        self._client.log_inputs(run_id, datasets=[DatasetInput(dataset, tags)])
        if digest is not None:
            self._client.set_tag(run_id, DATA_TAG, digest)

    def _attempt(self, what: str, action: Callable[[str], object], *, give_up: bool = True) -> None:
        if not self._works or self._reference is None:
            return
        if _is_left_alone(self._client.tracking_uri):
            self._works = False
            return
        begin = time.monotonic()
        try:
            with no_foreign_warnings():
                action(self._reference.run_id)
        except Exception as error:  # MLflow, its database driver and its HTTP client each raise their own kinds
            self._works = not give_up
            if what != METRICS or _newly_lost(self._client.tracking_uri, begin):
                _warn(f"could not keep {what}", error)

    def _close(self, status: str) -> None:
        self.flush()
        if self._reference is None:
            return
        if self._digests and status == "FINISHED":
            tag = " ".join(self._digests)
            self._attempt("the digests", lambda run_id: self._client.set_tag(run_id, OUTPUT_TAG, tag))
        if _is_left_alone(self._client.tracking_uri):
            return
        begin = time.monotonic()
        try:
            with no_foreign_warnings():
                _end(self._client, self._reference.experiment_id, self._reference.run_id, self._parent, status)
        except Exception as error:  # see _attempt
            if _newly_lost(self._client.tracking_uri, begin) and self._works:
                _warn("could not close the run", error)


@contextmanager
def run(
    *,
    stage: str,
    experiment: str,
    name: str,
    params: Mapping[str, Any],
    params_file: Path | None = None,
    data: Path | None = None,
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
        data: the tables that the pipeline's run is on; with them and the params file, the run is nested below that of
            the pipeline, see `parents`.
        tags: further tags.
    """
    all_tags = {"stage": stage, "experiment": experiment, **_provenance(stage), **(tags or {})}
    if params_file is not None:
        all_tags["params_file"] = params_file.as_posix()
    with no_foreign_warnings():
        pipeline = None if params_file is None or data is None else pipeline_of(experiment, params_file, data)
        opened = _open(experiment, _labelled(name), params, all_tags, pipeline)
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
    store = find_store()
    if not store.is_there:
        return {}
    try:
        with no_foreign_warnings():
            return {digest: _reference(run) for digest, run in _finished_runs(store, experiment, digests).items()}
    except Exception as error:  # see Run._attempt
        _warn(f"could not look for the runs of {experiment}", error)
        return {}


def stage_seconds(experiment: str, digests: Iterable[str]) -> dict[str, float]:
    """Return how long each stage took for the outputs with these digests, in seconds.

    That is from the begin of the first of its runs (when a training had its first epoch) to the end of the last, and
    after an interruption from where it went on.

    Args:
        experiment: name of the experiment.
        digests: as in `output_digests`; those that no run made do not count.

    Returns:
        The seconds by stage, in the order of the stages; nothing, and a warning, if the store cannot be read.
    """
    store = find_store()
    if not store.is_there:
        return {}
    try:
        with no_foreign_warnings():
            found = _finished_runs(store, experiment, digests).values()
    except Exception as error:  # see Run._attempt
        _warn(f"could not look for the runs of {experiment}", error)
        return {}
    begins, ends = dict[tuple[str, str], int](), dict[tuple[str, str], int]()
    for each in found:
        part = each.data.tags.get("stage", ""), each.data.tags.get(PARENT_TAG, "")
        begins[part] = min(begins.get(part, each.info.start_time), each.info.start_time)
        ends[part] = max(ends.get(part, each.info.end_time), each.info.end_time)
    seconds = dict[str, float]()
    for part in sorted(begins, key=lambda each: begins[each]):
        seconds[part[0]] = seconds.get(part[0], 0.0) + (ends[part] - begins[part]) / 1000
    return seconds


def run_link(reference: RunReference) -> str:
    """Return where a run's page is: an address on a server, else what follows the host and port of `serve_ui`."""
    path, store = run_path(reference.experiment_id, reference.run_id), find_store()
    return f"{ui_base(store)}/{path}" if urlsplit(store.uri).scheme in {"http", "https"} else path


def _open(
    experiment: str, name: str, params: Mapping[str, Any], tags: Mapping[str, str], pipeline: Pipeline | None
) -> Run:
    store, begin = find_store(), time.monotonic()
    if _is_left_alone(store.uri):
        return Run(None, None)
    try:
        client, experiment_id = connect(store, experiment)
        parent = None if pipeline is None else _open_parent(store, client, experiment_id, pipeline, tags)
        run_id = None
        try:
            run_id = _create(client, experiment_id, name, tags, pipeline, parent)
            log_params(client, run_id, params)
        except BaseException:
            with suppress(Exception):  # what is wrong is said already
                _end(client, experiment_id, run_id, parent, "FAILED")
            raise
    except Exception as error:  # see Run._attempt
        if _newly_lost(store.uri, begin):
            _warn("could not open a run", error)
        return Run(None, None)
    _lost.pop(store.uri, None)
    return Run(client, RunReference(run_id, experiment_id, name), parent)


def _create(
    client: Any, experiment_id: str, name: str, tags: Mapping[str, str], pipeline: Pipeline | None, parent: str | None
) -> str:
    own = {**tags, PROCESS_TAG: this_process()}
    if parent is not None:
        own[PARENT_TAG] = parent
    if pipeline is not None and pipeline.data is not None:
        own[DATA_TAG] = pipeline.data
    return str(client.create_run(experiment_id, tags=own, run_name=name).info.run_id)


def _end(client: Any, experiment_id: str, run_id: str | None, parent: str | None, status: str) -> None:
    """End a run, if there is one, and that of the pipeline if no other is open below it."""
    with nullcontext() if parent is None else _locked_store():  # of two at once, neither would see that it is the last
        if run_id is not None:
            client.set_terminated(run_id, status)
        if parent is not None:
            _parents.close(client, experiment_id, parent, status)


def _open_parent(store: Store, client: Any, experiment_id: str, pipeline: Pipeline, tags: Mapping[str, str]) -> str:
    with _locked_store(store):  # two stages at once would each make one
        return _parents.open(client, experiment_id, pipeline, tags)


def _locked_store(store: Store | None = None) -> AbstractContextManager[object]:
    """Return the lock of a store, by default that of all runs; a server takes care of itself."""
    folder = (store or find_store()).folder
    return nullcontext() if folder is None else locked(folder)


def _reference(run: Any) -> RunReference:
    return RunReference(run.info.run_id, run.info.experiment_id, run.info.run_name)


def _finished_runs(store: Store, experiment: str, digests: Iterable[str]) -> dict[str, Any]:
    client = open_client(store)
    kept = client.get_experiment_by_name(experiment)
    if kept is None:
        return {}
    found = dict[str, Any]()
    for digest in digests:
        wanted = f"attributes.status = 'FINISHED' and tags.{OUTPUT_TAG} LIKE '%{digest}%'"
        for run in client.search_runs([kept.experiment_id], wanted, max_results=1, order_by=["start_time DESC"]):
            found[digest] = run
    return found


def _labelled(name: str) -> str:
    """Return a run's name with that of the DVC experiment, which tells it from the same run of another one."""
    label = os.environ.get("DVC_EXP_NAME")
    return f"{name} ({label})" if label else name


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


def _newly_lost(uri: str, begin: float) -> bool:
    """Take a store that was waited for since `begin` for lost; return whether that is new."""
    new, now = uri not in _lost, time.monotonic()
    _lost[uri] = now + _PATIENCE * (now - begin)
    return new


def _is_left_alone(uri: str) -> bool:
    return time.monotonic() < _lost.get(uri, -math.inf)


def _warn(what: str, error: Exception) -> None:
    lines = (str(error).strip() or type(error).__name__).splitlines()
    # SQLAlchemy begins with how it came to write before it says what the database said.
    reason = next((line for line in lines if not line.startswith("(raised as a result of")), lines[0])
    said = without_password(reason)
    _log.warning("MLflow: %s (%s); going on without tracking, the figures are still in data/figures", what, said)
