"""Which two things a user means: revisions or runs, and of which experiments."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from addressed_dynamics.base.versions import project_root
from addressed_dynamics.comparing.comparison import Comparison, compare
from addressed_dynamics.comparing.revisions import Revision, find_revision, is_repository, version_of
from addressed_dynamics.comparing.tracked import version_of_run
from addressed_dynamics.comparing.versions import ComparisonError
from addressed_dynamics.tracking.kept import KeptRun, find_run


def compare_all(first: str, second: str, experiments: Sequence[str] = ()) -> list[Comparison]:
    """Compare two revisions in all experiments that both have, or two runs.

    Args:
        first: commit, branch, tag, DVC experiment, `workspace`, or identifier or name of a run in MLflow.
        second: what it is compared with.
        experiments: which experiments; all that both have by default.

    Raises:
        ComparisonError: one of them is not there, they are of different sorts, or they have nothing in common.
        ParamsError: a params file is no YAML.
        TrackingError: the store of runs cannot be read, or several runs have that name.
    """
    one, other = (_find(name) for name in (first, second))
    if isinstance(one, Revision) and isinstance(other, Revision):
        return [
            compare(version_of(one, experiment), version_of(other, experiment))
            for experiment in _common(one, other, experiments)
        ]
    if isinstance(one, KeptRun) and isinstance(other, KeptRun):
        found = compare(version_of_run(one, first), version_of_run(other, second))
        if experiments and found.experiment not in experiments:
            message = f"the runs are of the experiment '{found.experiment}', not of '{', '.join(experiments)}'"
            raise ComparisonError(message)
        return [found]
    revision, run = (first, second) if isinstance(one, Revision) else (second, first)
    message = f"{revision} is a revision, {run} a run in MLflow: compare two revisions or two runs"
    raise ComparisonError(message)


def _find(name: str) -> Revision | KeptRun:
    root = project_root()
    in_git = is_repository(root)
    if in_git and (revision := find_revision(root, name)) is not None:
        return revision
    if (run := find_run(name)) is not None:
        return run
    message = (
        f"{name}: there is no commit, branch, tag or DVC experiment of that name, nor a run in MLflow; "
        "'git log', 'dvc exp list --all-commits' and 'addressed-dynamics ui' show them"
        if in_git
        else f"{_shown(root)}: not a Git repository, so it has no revisions, and no run in MLflow is called {name}"
    )
    raise ComparisonError(message)


def _common(one: Revision, other: Revision, wanted: Sequence[str]) -> list[str]:
    if wanted:
        return list(wanted)  # version_of says where one is missing
    common = [name for name in one.experiments if name in other.experiments]
    if not common:
        lists = (f"{each.name} has {', '.join(each.experiments) or 'none'}" for each in (one, other))
        message = f"there is no experiment that both have: {'; '.join(lists)}"
        raise ComparisonError(message)
    return common


def _shown(root: Path) -> str:
    return "this folder" if root == Path.cwd() else str(root)
