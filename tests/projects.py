"""Projects as Git and DVC keep them, made by hand: a params file, a lock and a cache, without a pipeline that runs."""

import hashlib
import io
import json
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

PARAMS = """
params_file: params.yaml
experiments:
  car: {kind: transitions, raw: data/raw/car}
recorded: {}
imported: {}
car:
  title: A car
  ensemble: {epochs: EPOCHS}
"""
EPISODES, POINTS, ROLLOUTS = 40, 25, 20
CANDIDATES = ("ensemble/argmax", "persistence/seed-0")


def git(root: Path, *arguments: str) -> str:
    identity = ("-c", "user.name=n", "-c", "user.email=e@example.org", "-c", "commit.gpgsign=false")
    command = ["git", "-C", str(root), *identity, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def new_project(root: Path) -> Path:
    """An empty project under Git."""
    (root / ".dvc").mkdir(parents=True)
    (root / ".dvc" / "config").write_text("[core]\n    analytics = false\n")
    (root / ".gitignore").write_text("/.dvc/cache\n/.mlflow\n/data/*/\n!/data/reports\n")
    git(root, "init", "--quiet", "--initial-branch", "main")
    return root


def begin_project(root: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project whose first commit has results; it becomes the working directory, and nothing names another one."""
    monkeypatch.chdir(new_project(root))
    for name in ("DVC_ROOT", "DVC_EXP_NAME", "MLFLOW_TRACKING_URI"):
        monkeypatch.delenv(name, raising=False)
    write_results(root)
    commit(root, "Begin")
    return root


def errors_by_episode(factor: float = 1.0, spread: float = 0.0, episodes: int = EPISODES) -> dict[str, np.ndarray]:
    """Errors of two candidates, the first's multiplied by a factor that varies from episode to episode."""
    random = np.random.default_rng(1)
    losses = random.lognormal(0.0, 1.0, size=(len(CANDIDATES), episodes))
    rollouts = random.lognormal(0.0, 1.0, size=(len(CANDIDATES), ROLLOUTS, 2))
    varied = np.random.default_rng(2)
    losses[0] *= factor * np.exp(spread * varied.normal(size=episodes))
    rollouts[0] *= factor * np.exp(spread * varied.normal(size=(ROLLOUTS, 1)))
    return {
        "paired_episode": np.arange(episodes),
        "paired_samples": np.full(episodes, POINTS),
        "paired_candidates": np.array(CANDIDATES),
        "paired_one_step": losses,
        "paired_rollout_episode": np.arange(ROLLOUTS),
        "paired_rollout_candidates": np.array(CANDIDATES),
        "paired_rollouts": rollouts,
        "paired_scale": np.array([2.0, 4.0]),
    }


def evaluation(**changes: Any) -> dict[str, Any]:
    """As much of evaluation.json as a comparison reads."""
    dimensions = [{"name": "position", "unit": "m"}, {"name": "speed", "unit": "m/s"}]
    candidates = {
        name: {
            "label": label,
            "one_step": {"dimensions": dimensions},
            "rollouts": {"horizon": {"seconds": 3.0, "lost": True}},
        }
        for name, label in zip(CANDIDATES, ("the ensemble", "nothing changes"), strict=True)
    }
    recommendation = {"candidate": CANDIDATES[0]}
    return {"loss": "mse", "candidates": candidates, "recommendation": recommendation, "trust": None, **changes}


def npz(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Arrays as a file."""
    buffer = io.BytesIO()
    np.savez(buffer, **dict(arrays))
    return buffer.getvalue()


def keep(root: Path, content: bytes, suffix: str = "") -> str:
    """Put bytes into the cache; return their digest."""
    digest = hashlib.md5(content).hexdigest() + suffix
    file = root / ".dvc" / "cache" / "files" / "md5" / digest[:2] / digest[2:]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)
    return digest


def write_results(
    root: Path,
    *,
    epochs: int = 3,
    tables: str = "t1",
    arrays: Mapping[str, np.ndarray] | None = None,
    report: Mapping[str, Any] | None = None,
    code: str = "c1",
) -> None:
    """Write what a run of the pipeline leaves: params, the lock, the cache, the workspace and the summary."""
    (root / "params.yaml").write_text(PARAMS.replace("EPOCHS", str(epochs)))
    files = {"evaluation.json": json.dumps(report or evaluation()).encode()}
    files |= {"arrays.npz": npz(errors_by_episode() if arrays is None else arrays)}
    digest = keep_folder(root, "data/evaluation/car", files)
    counts = json.dumps({"transitions": 1000, "splits": {"test": {"episodes": EPISODES}}}).encode()
    figures = keep_folder(root, "data/figures/car/convert", {"data.json": counts})
    lock = {
        "schema": "2.0",
        "stages": {
            "convert@car": {
                "deps": [{"path": "data/raw/car", "md5": f"raw-{tables}.dir"}, {"path": "src/base", "md5": code}],
                "outs": [
                    {"path": "data/tables/car", "md5": f"{tables}.dir"},
                    {"path": "data/figures/car/convert", "md5": figures},
                ],
            },
            "train_ensemble@car": {"params": {"params.yaml": {"car.ensemble": {"epochs": epochs}}}},
            "evaluate@car": {"outs": [{"path": "data/evaluation/car", "md5": digest}]},
        },
    }
    (root / "dvc.lock").write_text(json.dumps(lock))  # JSON is YAML, too
    summary = root / "data" / "reports" / "car" / "summary.json"
    summary.parent.mkdir(parents=True, exist_ok=True)
    summary.write_text(json.dumps({"one_step_rmse_percent": float(epochs)}))


def keep_folder(root: Path, folder: str, files: Mapping[str, bytes]) -> str:
    """Put a folder into the cache and into the workspace; return its digest."""
    listing = []
    for name, content in files.items():
        (root / folder).mkdir(parents=True, exist_ok=True)
        (root / folder / name).write_bytes(content)
        listing.append({"md5": keep(root, content), "relpath": name})
    return keep(root, json.dumps(listing).encode(), ".dir")


def commit(root: Path, message: str) -> str:
    """Commit everything; return the commit."""
    git(root, "add", "--all")
    git(root, "commit", "--quiet", "--message", message)
    return git(root, "rev-parse", "HEAD")
