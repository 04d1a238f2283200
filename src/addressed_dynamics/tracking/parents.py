"""The run of a pipeline, with those of its stages nested below.

The stages are processes of their own, which know nothing of each other, and DVC leaves out those whose outputs it has.
So what they belong to is not named by whoever starts them, but follows from what they see: the same data, the same
params, the same commit and the same DVC experiment make one run of the pipeline.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from addressed_dynamics.base.dotted import dotted
from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.base.params.experiments import load_experiment, load_kind
from addressed_dynamics.base.versions import code_version, data_digest, git_commit

PARENT_TAG = "mlflow.parentRunId"
"""By which MLflow nests runs."""
DATA_TAG = "data_md5"
"""Tag of a run on data that DVC knows: its digest of them."""
PIPELINE_TAG = "pipeline"
"""Tag of the run of a pipeline: what it follows from."""
STAGE = "pipeline"
"""What the column of stages says of it."""

_log = logging.getLogger("addressed_dynamics.tracking")
_DIGITS = 16
_MOST_PARAMS = 100  # that a request to MLflow may have
_COMMIT = 7


@dataclass(frozen=True)
class Pipeline:
    """What the stages of a run of the pipeline have in common."""

    key: str
    """Digest of all that it follows from."""
    name: str
    """Its name in the runs table."""
    params: Mapping[str, Any]
    """All params of the experiment, the defaults included."""
    data: str | None
    """What DVC has for its data; None if that is not known."""


def pipeline_of(experiment: str, params_file: Path, data: Path) -> Pipeline | None:
    """Return to which run of the pipeline a stage belongs that runs now; None if its params cannot be read.

    Args:
        experiment: name of the experiment.
        params_file: where its params come from.
        data: its tables.
    """
    try:
        kind = load_kind(params_file, experiment)
        if kind is None:
            return None
        params = load_experiment(params_file, experiment, kind).model_dump(mode="json")
    except AddressedDynamicsError:
        return None
    digest, label = data_digest(data), os.environ.get("DVC_EXP_NAME", "")
    seen = json.dumps([experiment, params, digest, git_commit(), label], sort_keys=True)
    commit, *changes = code_version().split(", ", 1)
    named = label or ", ".join([commit[:_COMMIT], *changes])
    key = hashlib.sha256(seen.encode()).hexdigest()[:_DIGITS]
    return Pipeline(key, f"{experiment} {named}".strip(), params, digest)


class Parents:
    """The runs of pipelines that runs of this process are nested below."""

    def __init__(self) -> None:
        self._children: Counter[str] = Counter()
        self._monitors: dict[str, Any] = {}

    def open(self, client: Any, experiment_id: str, pipeline: Pipeline, tags: Mapping[str, str]) -> str:
        """Return the run of `pipeline`, which runs again or for the first time; call it while the store is locked."""
        wanted = f"tags.{PIPELINE_TAG} = '{pipeline.key}'"
        found = client.search_runs([experiment_id], wanted, max_results=1)
        run_id = found[0].info.run_id if found else _create(client, experiment_id, pipeline, tags)
        if not self._children[run_id]:
            client.update_run(run_id, status="RUNNING")
            self._monitors[run_id] = _watch_machine(client.tracking_uri, run_id)
        self._children[run_id] += 1
        return str(run_id)

    def close(self, client: Any, run_id: str, status: str) -> None:
        """Say that a child ended; with the last one the run of the pipeline ends, until the next stage begins."""
        self._children[run_id] -= 1
        if self._children[run_id]:
            return
        if (monitor := self._monitors.pop(run_id, None)) is not None:
            monitor.finish()
        client.set_terminated(run_id, status)


def log_params(client: Any, run_id: str, params: Mapping[str, Any]) -> None:
    """Send params by dotted keys, as texts, in as many requests as it takes; a section without any is left out."""
    from mlflow.entities import Param

    found = [
        Param(key, value if isinstance(value, str) else json.dumps(value))
        for key, value in dotted(params)
        if not isinstance(value, Mapping)
    ]
    for begin in range(0, len(found), _MOST_PARAMS):
        client.log_batch(run_id, params=found[begin : begin + _MOST_PARAMS])


def _create(client: Any, experiment_id: str, pipeline: Pipeline, tags: Mapping[str, str]) -> str:
    own = {**tags, "stage": STAGE, PIPELINE_TAG: pipeline.key, "mlflow.source.name": "dvc.yaml"}
    if pipeline.data is not None:
        own[DATA_TAG] = pipeline.data
    created = client.create_run(experiment_id, tags=own, run_name=pipeline.name)
    log_params(client, created.info.run_id, pipeline.params)
    return str(created.info.run_id)


def _watch_machine(uri: str, run_id: str) -> Any:
    """Return a started monitor of processors, memory, disk and network; None if the user wants none, or it fails."""
    if os.environ.get("MLFLOW_ENABLE_SYSTEM_METRICS_LOGGING", "true").lower() in {"false", "0"}:
        return None
    try:
        from mlflow.system_metrics.system_metrics_monitor import SystemMetricsMonitor

        monitor = SystemMetricsMonitor(run_id, resume_logging=True, tracking_uri=uri)
        monitor.start()
    except Exception as error:  # psutil may be missing, and what it asks the machine for may be, too
        _log.warning("MLflow: could not watch the machine (%s); going on without system metrics", error)
        return None
    return monitor
