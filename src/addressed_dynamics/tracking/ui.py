"""MLflow's user interface on this project's runs, which opens on them."""

from __future__ import annotations

import json
import os
import socket
import sqlite3
import sys
from importlib.metadata import entry_points
from typing import Any, NoReturn
from urllib.parse import urlsplit

from addressed_dynamics.base.errors import TrackingError
from addressed_dynamics.tracking.store import (
    ARTIFACTS,
    ENVIRONMENT,
    UI_PORT,
    find_store,
    locked,
    move_artifacts,
    ui_base,
)
from addressed_dynamics.tracking.views import VIEW, view_path

APP = "addressed-dynamics"
"""Name of the entry point of the group `mlflow.app`, MLflow's own way to extend its server."""

# What the page keeps of its visitor is set only where it keeps nothing yet: the panel that opens by itself at the first
# visit does so no more, and the pages are those for trainings. An experiment opens once with its saved view.
_SCRIPT = """<script>
(() => {
  const kept = {
    "mlflow.assistant.fab.autoOpenedOnFirstLoad_v1": "true",
    "mlflow.workflowType_v1": '"machine_learning"',
  };
  for (const [key, value] of Object.entries(kept))
    if (localStorage.getItem(key) === null) localStorage.setItem(key, value);
  const show = () => {
    const place = location.hash.match(/^#\\/experiments\\/(\\d+)(\\/runs)?(\\?[^/]*)?$/);
    if (!place || place[3]?.includes("viewStateShareKey")) return;
    const seen = `addressed-dynamics.seen.${place[1]}`;
    if (localStorage.getItem(seen)) return;
    localStorage.setItem(seen, "true");
    location.replace(VIEW_PATH.replace("EXPERIMENT", place[1]));
  };
  if (location.hash.length < 3) location.replace(FIRST);
  show();
  addEventListener("hashchange", show);
})();
</script>"""


def serve_ui(port: int = UI_PORT) -> NoReturn:
    """Become the MLflow UI on 127.0.0.1, on the store that the stages write to; Ctrl-C ends it.

    Raises:
        TrackingError: there is no store yet, it lies on a server that has its own UI, or the port is taken.
    """
    store = find_store()
    if urlsplit(store.uri).scheme in {"http", "https"}:
        message = f"the runs are on the server of MLFLOW_TRACKING_URI: open {ui_base(store)} in a browser"
        raise TrackingError(message)
    if not store.is_there:
        message = f"{store.folder}: there are no runs yet; 'dvc repro' makes them"
        raise TrackingError(message)
    _check_port(port)
    command = [sys.executable, "-m", "mlflow", "server", "--host", "127.0.0.1", "--port", str(port), "--workers", "1"]
    if store.folder is not None:
        try:
            with locked(store.folder):
                move_artifacts(store.folder)
        except (sqlite3.Error, OSError) as error:
            message = f"{store.folder / 'mlflow.db'}: the store of runs cannot be opened ({error})"
            raise TrackingError(message) from error
        command += ["--default-artifact-root", (store.folder / ARTIFACTS).as_uri()]
    # An installation of before there was an entry point has none until the next 'pip install'.
    if entry_points(group="mlflow.app", name=APP):
        command += ["--app-name", APP]
    # Without the job runner the UI starts in a third of the time and takes a quarter of the memory.
    environment = {**ENVIRONMENT, **os.environ, "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
    environment["MLFLOW_BACKEND_STORE_URI"] = store.uri  # not an option: a list of processes shows those
    # In place of this process, so that Ctrl-C and a signal from outside reach the server itself and leave no orphan.
    os.execve(sys.executable, command, environment)


def create_app() -> Any:
    """Return MLflow's server with a first page that opens on the runs; MLflow calls it, see `APP`."""
    from mlflow.server import handlers
    from mlflow.server.fastapi_app import create_fastapi_app
    from starlette.responses import HTMLResponse

    app = create_fastapi_app()

    async def first_page(request: Any, answer: Any) -> Any:
        response = await answer(request)
        if request.method != "GET" or request.url.path != "/" or response.status_code != 200:
            return response
        page = b"".join([part async for part in response.body_iterator]).decode("utf-8")
        return HTMLResponse(opening_on(page, _last_experiment(handlers._get_tracking_store())))

    app.middleware("http")(first_page)
    return app


def opening_on(page: str, experiment_id: str | None) -> str:
    """Return MLflow's page with a script that opens it on the runs of an experiment, on the experiments without one."""
    first = "#/experiments" if experiment_id is None else view_path(experiment_id)
    view = view_path("EXPERIMENT")
    script = _SCRIPT.replace("VIEW_PATH", json.dumps(view)).replace("FIRST", json.dumps(first))
    return page.replace("<head>", f"<head>{script}", 1)


def _last_experiment(store: Any) -> str | None:
    """Return the experiment of the last run among those with a saved view."""
    tag = f"mlflow.sharedViewState.{VIEW}"
    shown = [each.experiment_id for each in store.search_experiments() if tag in each.tags]
    from mlflow.entities import ViewType

    runs = store.search_runs(shown, "", ViewType.ACTIVE_ONLY, max_results=1, order_by=["start_time DESC"])
    return str(runs[0].info.experiment_id) if runs else None


def _check_port(port: int) -> None:
    with socket.socket() as probe:
        # As the server itself does: a port whose last connections are still closing is free.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as error:
            message = f"port {port} of 127.0.0.1 cannot be used ({error}); choose another one"
            raise TrackingError(message) from error
