"""What MLflow's user interface shows of an experiment: columns, curves and description (forms read from MLflow 3.17).

A saved view is a name, two times and a state, itself JSON in a string, in a tag of the experiment; it is shown at an
address that ends in `viewStateShareKey=overview`.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from typing import Any

OVERVIEW_COLUMNS = (
    "tags.`dvc_experiment`",
    "tags.`stage`",
    "params.`seed`",
    "params.`variant`",
    "params.`baseline`",
    "metrics.`loss/train`",
    "metrics.`loss/validation`",
    "metrics.`loss/selected`",
    "metrics.`loss/test`",
    "metrics.`agreement`",
    "metrics.`regret/mean`",
)
"""Columns of the runs table in the saved view `overview`; MLflow itself shows no metric at first."""

CURVES = {
    "loss/train": "log",
    "loss/validation": "log",
    "loss/selected": "log",
    "regret/mean": "log",
    "agreement": "linear",
}
"""Charts of the saved view, with the scale of their y axis: losses fall by powers of ten."""

VIEW = "overview"
"""Name of the saved view in addresses."""

_WORKFLOW = "workflowType=machine_learning"  # or the UI shows its pages for language models
_VIEW_TAG = f"mlflow.sharedViewState.{VIEW}"
_NOTE_TAG = "mlflow.note.content"
_LINK = "[Runs with losses and parameters]"
_CURVES = "curves"


def run_path(experiment_id: str, run_id: str) -> str:
    """Return where a run's page is, on whichever host and port."""
    return f"#/experiments/{experiment_id}/runs/{run_id}?{_WORKFLOW}"


def model_path(experiment_id: str, model_id: str) -> str:
    """Return where the page of a logged model is, on whichever host and port."""
    return f"#/experiments/{experiment_id}/models/{model_id}"


def model_description(name: str) -> str:
    """Return what the page of a registered model says of it, in Markdown."""
    return (
        f"The learned simulator of {name}: from a table of states and actions to the next states. A version is a model "
        "that an evaluation delivered.\n\n"
        "`champion` is the version to use. The alias moves to a new one only if that is better on validation data, and "
        "both were measured on the same data with the same params; each version says why it moved or stayed. After a "
        "change of the data, move it by hand.\n\n"
        f'`mlflow.pyfunc.load_model("models:/{name}@champion")`'
    )


def view_path(experiment_id: str) -> str:
    """Return where an experiment's runs are with the saved view, on whichever host and port."""
    return f"#/experiments/{experiment_id}/runs?{_WORKFLOW}&viewStateShareKey={VIEW}"


def description(experiment_id: str, verdict: str = "") -> str:
    """Return an experiment's description: what was found last, and the saved view."""
    link = f"{_LINK}({view_path(experiment_id)})"
    return f"{verdict}\n\n{link}" if verdict else link


def experiment_tags(experiment_id: str, known: Mapping[str, str]) -> dict[str, str]:
    """Return the tags of an experiment that are to be set: none that says already what it should.

    Args:
        experiment_id: MLflow's identifier.
        known: the tags that it has; a description that somebody else wrote stays.
    """
    tags = {} if "mlflow.experimentKind" in known else {"mlflow.experimentKind": "custom_model_development"}
    state = json.dumps(_state())
    if _state_of(known.get(_VIEW_TAG)) != state:
        now = int(time.time() * 1000)
        view = {"name": "Overview", "createdAt": now, "updatedAt": now, "state": state}
        tags[_VIEW_TAG] = json.dumps(view)
    note = known.get(_NOTE_TAG)
    if note is None or note.startswith(f"{_LINK}(http"):
        tags[_NOTE_TAG] = description(experiment_id)
    return tags


def verdict_tags(experiment_id: str, known: Mapping[str, str], verdict: str) -> dict[str, str]:
    """Return the tags that tell of a verdict; none if somebody else wrote the description."""
    note = known.get(_NOTE_TAG)
    if note is not None and _LINK not in note:
        return {}
    return {_NOTE_TAG: description(experiment_id, verdict)}


def _state() -> dict[str, Any]:
    return {
        "selectedColumns": list(OVERVIEW_COLUMNS),
        "columnOrder": ["attributes.`Run Name`", "runDateAndNestInfo"],
        "columnWidths": {"attributes.`Run Name`": 330, "runDateAndNestInfo": 150},
        "orderByKey": "attributes.start_time",
        "orderByAsc": False,
        "compareRunCharts": [_chart(metric, scale) for metric, scale in CURVES.items()],
        "isAccordionReordered": True,  # or the sections are sorted by name
        "compareRunSections": [{"uuid": _CURVES, "name": "Curves", "display": True, "isReordered": False}],
    }


def _chart(metric: str, scale: str) -> dict[str, Any]:
    return {
        "type": "LINE", "uuid": f"curve-{metric}", "deleted": False, "isGenerated": False, "metricSectionId": _CURVES,
        "metricKey": metric, "selectedMetricKeys": [metric], "scaleType": scale, "xAxisScaleType": "linear",
        "xAxisKey": "step", "selectedXAxisMetricKey": "", "yAxisKey": "metric", "yAxisExpressions": [],
        "lineSmoothness": 0, "range": {}, "ignoreOutliers": False, "runsCountToCompare": 20,
        "useGlobalXaxisKey": True, "useGlobalLineSmoothing": True,
    }  # fmt: skip


def _state_of(view: str | None) -> str | None:
    try:
        return None if view is None else str(json.loads(view)["state"])
    except (ValueError, LookupError, TypeError):
        return None
