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
import platform
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
PROCESS_TAG = "process"
"""Tag of a run: host and number of the process that it is open in."""
ENDED_TAG = "ended"
"""Tag of the run of a pipeline of which a stage did not end well while others ran: how."""
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
    """The runs of pipelines that runs of this process are nested below; others may be open in other processes."""

    def __init__(self) -> None:
        self._children: Counter[str] = Counter()
        self._monitors: dict[str, Any] = {}

    def open(self, client: Any, experiment_id: str, pipeline: Pipeline, tags: Mapping[str, str]) -> str:
        """Return the run of `pipeline`, which runs again or for the first time; call it while the store is locked.

        How stages ended before is forgotten, unless some still run.
        """
        wanted = f"tags.{PIPELINE_TAG} = '{pipeline.key}'"
        found = client.search_runs([experiment_id], wanted, max_results=1)
        run_id = found[0].info.run_id if found else _create(client, experiment_id, pipeline, tags)
        if found and ENDED_TAG in found[0].data.tags and not _others(client, experiment_id, run_id):
            client.delete_tag(run_id, ENDED_TAG)
        if not self._children[run_id]:
            client.update_run(run_id, status="RUNNING")
            self._monitors[run_id] = _watch_machine(client.tracking_uri, run_id)
        self._children[run_id] += 1
        return str(run_id)

    def close(self, client: Any, experiment_id: str, run_id: str, status: str) -> None:
        """Say that a child ended; call it while the store is locked, after that was said of the child itself.

        With the last one the run of the pipeline ends, until the next stage begins: badly if one of those did that ran
        beside it.
        """
        self._children[run_id] -= 1
        if not self._children[run_id] and (monitor := self._monitors.pop(run_id, None)) is not None:
            monitor.finish()
        parent = client.get_run(run_id)
        if _others(client, experiment_id, run_id):
            if status != "FINISHED":
                client.set_tag(run_id, ENDED_TAG, status)
        elif parent.info.status == "RUNNING":
            before = parent.data.tags.get(ENDED_TAG)
            client.set_terminated(run_id, before if before and status == "FINISHED" else status)


def this_process() -> str:
    """Return what tells this process from others, for `PROCESS_TAG`."""
    return f"{platform.node()} {os.getpid()}"


def _others(client: Any, experiment_id: str, run_id: str) -> bool:
    """Return whether a run below this one is open, in whatever process; one whose process was killed is not."""
    wanted = f"tags.`{PARENT_TAG}` = '{run_id}' and attributes.status = 'RUNNING'"
    return any(_lives(each.data.tags.get(PROCESS_TAG, "")) for each in client.search_runs([experiment_id], wanted))


def _lives(process: str) -> bool:
    """Return whether a process lives, as far as can be known: of another machine's it is believed."""
    host, _, number = process.rpartition(" ")
    if host != platform.node() or os.name == "nt":  # there, to ask would be to kill
        return bool(host)
    try:
        os.kill(int(number), 0)  # asks, and does nothing
    except ProcessLookupError:
        return False
    except PermissionError:
        return True  # somebody else's
    return True


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
