"""Runs in MLflow: the only package that imports mlflow, and that no stage depends on."""

from addressed_dynamics.tracking.registry import CHAMPION, Registered
from addressed_dynamics.tracking.runs import OUTPUT_TAG, Run, RunReference, find_runs, run, run_link, stage_seconds
from addressed_dynamics.tracking.store import UI_PORT
from addressed_dynamics.tracking.ui import serve_ui
from addressed_dynamics.tracking.views import CURVES, OVERVIEW_COLUMNS

__all__ = [
    "CHAMPION",
    "CURVES",
    "OUTPUT_TAG",
    "OVERVIEW_COLUMNS",
    "UI_PORT",
    "Registered",
    "Run",
    "RunReference",
    "find_runs",
    "run",
    "run_link",
    "serve_ui",
    "stage_seconds",
]
