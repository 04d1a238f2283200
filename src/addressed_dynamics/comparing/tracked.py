"""Runs in MLflow as versions of an experiment."""

from __future__ import annotations

import io
import json

import numpy as np

from addressed_dynamics.comparing.versions import EpisodeErrors, Version
from addressed_dynamics.tracking.kept import KeptRun
from addressed_dynamics.tracking.parents import DATA_TAG

EVALUATION, EPISODES = "evaluation.json", "episodes.npz"
"""Files that an evaluation keeps with its run."""


def version_of_run(run: KeptRun, name: str) -> Version:
    """Return what MLflow has of an experiment.

    Args:
        run: one of the pipeline or of a stage.
        name: how the user named it.
    """
    evaluated = next((each for each in (run, *run.children) if each.stage == "evaluate"), None)
    text = None if evaluated is None else evaluated.file(EVALUATION)
    arrays = None if evaluated is None else evaluated.file(EPISODES)
    notes = []
    if run.status != "FINISHED":
        notes.append(f"the run did not end well ({run.status.lower()}); its figures may be of half a training")
    if text is None and run.stage in {"pipeline", "evaluate", "report"}:
        notes.append("no evaluation is kept with the run; compare the revisions, whose outputs DVC keeps")
    errors = None
    if arrays is not None:
        with np.load(io.BytesIO(arrays), allow_pickle=False) as kept:
            errors = EpisodeErrors.of({key: kept[key] for key in kept.files})
    commit = run.tags.get("git_commit", "")
    changed = ", with changes" if run.tags.get("git_dirty") == "true" else ""
    digest = run.tags.get(DATA_TAG)
    return Version(
        name,
        f"run '{run.name}' of {run.started}, {run.run_id}",
        run.experiment,
        run.params,
        {} if digest is None else {f"data/tables/{run.experiment}": digest[:8]},
        {},
        {"commit": f"{commit[:7]}{changed}"} if commit else {},
        run.metrics,
        {} if text is None else json.loads(text),
        errors,
        tuple(notes),
    )
