"""Revisions of a project: what Git has of them, and what DVC's cache has of their outputs."""

from __future__ import annotations

import configparser
import hashlib
import io
import json
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, final

import numpy as np
import yaml  # type: ignore[import-untyped]  # as in base/versions.py

from addressed_dynamics.base.dotted import dotted
from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.params.experiments import EXTENDS, load_experiment, parse_params
from addressed_dynamics.comparing.versions import ComparisonError, EpisodeErrors, Version

WORKSPACE = "workspace"
"""What the files are called that are checked out, as DVC calls them."""

PARAMS = "params.yaml"
STAGES = ("record", "import", "convert", "train_ensemble", "train_addressing", "train_baselines", "evaluate", "report")
"""Stages of an experiment, in order."""

_COUNTED = ("transitions", "rows", "seconds", "episodes", "splits", "clips", "segments")
_DEPTH = 3
"""So deep are counts read from data.json; what lies deeper is no count of a whole."""
_DIGITS = 8


@final
@dataclass(frozen=True)
class Revision:
    """One state of a project."""

    name: str
    """As the user gave it."""
    root: Path
    """Folder of the project."""
    commit: str | None
    """What Git has; None for the workspace."""
    is_experiment: bool = False
    """Whether it is one of DVC's experiments, which `git checkout` knows nothing of."""

    @property
    def what(self) -> str:
        """What it is, for people."""
        if self.commit is None:
            return "the workspace"
        described = _git(self.root, "show", "--no-patch", "--format=%h%n%cs%n%s", self.commit)
        commit, date, subject = described.split("\n", 2)
        if self.is_experiment:
            return f"DVC experiment {self.name}, {commit} of {date}"
        return f"commit {commit} of {date}: {subject}"

    def file(self, path: str) -> bytes | None:
        """Return a file of the project that Git keeps; None if there is none."""
        if self.commit is None:
            file = self.root / path
            return file.read_bytes() if file.is_file() else None
        found = _run(self.root, "show", f"{self.commit}:./{path}")
        return found.stdout if found.returncode == 0 else None

    def output(self, folder: str, name: str) -> bytes | None:
        """Return a file of an output; None if DVC's cache does not have it."""
        if self.commit is None:
            file = self.root / folder / name
            return file.read_bytes() if file.is_file() else None
        return self._cached(self.listing(folder).get(name, ""))

    def listing(self, folder: str) -> dict[str, str]:
        """Return the digests of an output's files by their names; nothing if DVC's cache does not have them."""
        listing = self._cached(self.outputs.get(folder, ""))
        return {} if listing is None else {each["relpath"]: each["md5"] for each in json.loads(listing)}

    @cached_property
    def lock(self) -> Mapping[str, Any]:
        """What dvc.lock says of each stage; nothing if there is none."""
        text = self.file("dvc.lock")
        stages = (yaml.load(text, yaml.CSafeLoader) or {}).get("stages") if text else None
        return stages if isinstance(stages, dict) else {}

    @cached_property
    def outputs(self) -> dict[str, str]:
        """Digests of all outputs by their paths."""
        outs = [each for stage in self.lock.values() for each in stage.get("outs", ())]
        return {each["path"]: each["md5"] for each in outs if "md5" in each}

    @cached_property
    def params(self) -> dict[str, Any]:
        """What params.yaml says.

        Raises:
            ComparisonError: there is none.
            ParamsError: it is no YAML.
        """
        text = self.file(PARAMS)
        if text is None:
            message = f"{self.name}: there is no {PARAMS} in it; compare revisions that have the pipeline"
            raise ComparisonError(message)
        return parse_params(Path(f"{self.name}:{PARAMS}"), text.decode("utf-8"))

    @property
    def experiments(self) -> list[str]:
        """Names of the experiments that the pipeline runs."""
        entries = self.params.get("experiments")
        return list(entries) if isinstance(entries, dict) else []

    def how_to_get(self, stage: str) -> str:
        """Return the command that brings the output of a stage back."""
        get = f"dvc pull {stage}' or 'dvc repro {stage}" if _has_remote(self.root) else f"dvc repro {stage}"
        if self.commit is None:
            return f"'{get}'"
        checkout = f"dvc exp apply {self.name}" if self.is_experiment else f"git checkout {self.name}"
        return f"'{checkout}', then '{get}'"

    def _cached(self, digest: str) -> bytes | None:
        if not digest:
            return None
        file = _cache(self.root) / "files" / "md5" / digest[:2] / digest[2:]
        return file.read_bytes() if file.is_file() else None


def find_revision(root: Path, name: str) -> Revision | None:
    """Return a commit, branch, tag, the workspace or a DVC experiment; None if there is none of that name.

    Raises:
        ComparisonError: several DVC experiments have that name.
    """
    if name == WORKSPACE:
        return Revision(name, root, None)
    found = _run(root, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{name}^{{commit}}")
    if found.returncode == 0:
        return Revision(name, root, found.stdout.decode().strip())
    refs = _git(root, "for-each-ref", "--format=%(objectname) %(refname)", "refs/exps").splitlines()
    named = [line.partition(" ")[::2] for line in refs]
    commits = {commit for commit, ref in named if ref.rpartition("/")[2] == name and "/exec/" not in ref}
    if len(commits) > 1:
        which = ", ".join(sorted(commits))
        message = f"{name}: DVC has {len(commits)} experiments of that name; give the commit: {which}"
        raise ComparisonError(message)
    return Revision(name, root, commits.pop(), is_experiment=True) if commits else None


def is_repository(root: Path) -> bool:
    """Whether Git knows the project."""
    return _run(root, "rev-parse", "--git-dir").returncode == 0


def version_of(revision: Revision, experiment: str) -> Version:
    """Return an experiment as it is in a revision, with what is missing of it.

    Raises:
        ComparisonError: the experiment is not in it.
        ParamsError: its params file is no YAML.
    """
    if experiment not in revision.experiments:
        known = ", ".join(revision.experiments) or "none"
        message = f"{revision.name}: there is no experiment '{experiment}' in it (experiments there: {known})"
        raise ComparisonError(message)
    params, params_notes = _params(revision, experiment)
    evaluation, errors, notes = _results(revision, experiment)
    summary = revision.file(f"data/reports/{experiment}/summary.json")
    counts = revision.output(f"data/figures/{experiment}/convert", "data.json")
    return Version(
        revision.name,
        revision.what,
        experiment,
        params,
        dict(_data(revision, experiment)),
        {} if counts is None else dict(_counts(json.loads(counts))),
        dict(_code(revision, experiment)),
        {} if summary is None else json.loads(summary),
        evaluation,
        errors,
        (*params_notes, *_stale(revision, experiment), *notes),
    )


def _params(revision: Revision, experiment: str) -> tuple[dict[str, Any], list[str]]:
    """Return the params with the defaults of the installed version; as they are written if that refuses them."""
    entry = revision.params["experiments"][experiment] or {}
    file = str(revision.params.get("params_file") or PARAMS)
    own = {f"experiments.{experiment}.{key}": value for key, value in entry.items()}
    if imported := (revision.params.get("imported") or {}).get(experiment):
        own[f"imported.{experiment}"] = imported
    with tempfile.TemporaryDirectory() as folder:
        _write_params(revision, file, Path(folder))
        try:
            sections = load_experiment(Path(folder) / file, experiment, str(entry.get("kind", "transitions")))
            return own | dict(dotted(sections.model_dump(mode="json"))), []
        except ParamsError as error:
            reason = str(error).replace(f"{folder}/", "")
    written = dict(dotted(revision.params.get(experiment) or {}))
    return own | written, [f"its params are of another version, so defaults are not compared ({reason})"]


def _write_params(revision: Revision, file: str, folder: Path) -> None:
    """Write a params file of a revision into a folder, with those that it extends."""
    text = revision.file(file)
    if text is None or (folder / file).exists():
        return
    (folder / file).parent.mkdir(parents=True, exist_ok=True)
    (folder / file).write_bytes(text)
    below = parse_params(Path(file), text.decode("utf-8")).get(EXTENDS)
    if isinstance(below, str):
        _write_params(revision, (Path(file).parent / below).as_posix(), folder)


def _data(revision: Revision, experiment: str) -> Iterator[tuple[str, str]]:
    """Yield the digests of what goes into the tables, and of the tables."""
    for stage in ("import", "convert"):
        entry = revision.lock.get(f"{stage}@{experiment}", {})
        for dep in entry.get("deps", ()):
            if not _is_code(dep["path"]) and "md5" in dep:
                yield dep["path"], dep["md5"][:_DIGITS]
    if (tables := f"data/tables/{experiment}") in revision.outputs:
        yield tables, revision.outputs[tables][:_DIGITS]


def _code(revision: Revision, experiment: str) -> Iterator[tuple[str, str]]:
    for stage in STAGES:
        for dep in revision.lock.get(f"{stage}@{experiment}", {}).get("deps", ()):
            if _is_code(dep["path"]) and "md5" in dep:
                yield dep["path"], dep["md5"][:_DIGITS]


def _is_code(path: str) -> bool:
    return path.startswith(("src/", "pipeline/", "released"))


def _counts(data: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    for key, value in dotted({name: data[name] for name in _COUNTED if name in data}):
        if isinstance(value, int | float) and key.count(".") < _DEPTH:
            yield key, value


def _results(revision: Revision, experiment: str) -> tuple[dict[str, Any], EpisodeErrors | None, list[str]]:
    """Return what the evaluation found, and what is missing of it."""
    folder, stage = f"data/evaluation/{experiment}", f"evaluate@{experiment}"
    text, arrays = revision.output(folder, "evaluation.json"), revision.output(folder, "arrays.npz")
    if text is None:
        if stage not in revision.lock:
            return {}, None, [f"it has no results yet; {revision.how_to_get(f'report@{experiment}')} makes them"]
        where = "is not there" if revision.commit is None else "is not in DVC's cache"
        return {}, None, [f"{folder} {where}: {revision.how_to_get(stage)} brings it back"]
    notes = []
    if revision.commit is None and not _is_locked(revision, folder, {"evaluation.json": text, "arrays.npz": arrays}):
        notes.append(f"{folder} is not what dvc.lock says; 'dvc checkout {stage}' or 'dvc repro {stage}' puts it right")
    if arrays is None:
        return json.loads(text), None, notes
    # By name, for what figures are made of is a hundred times as large.
    with np.load(io.BytesIO(arrays), allow_pickle=False) as kept:
        errors = EpisodeErrors.of({name: kept[name] for name in kept.files if name.startswith("paired_")})
    return json.loads(text), errors, notes


def _is_locked(revision: Revision, folder: str, files: Mapping[str, bytes | None]) -> bool:
    """Return whether files of the workspace are those of dvc.lock, as far as DVC's cache knows their digests."""
    listing = revision.listing(folder)
    return all(
        name not in listing or hashlib.md5(content or b"", usedforsecurity=False).hexdigest() == listing[name]
        for name, content in files.items()
    )


def _stale(revision: Revision, experiment: str) -> Iterator[str]:
    """Yield what says that results are not of the params that stand beside them."""
    changed, missing = list[str](), list[str]()
    documents = dict[str, Any]()
    for stage in STAGES:
        entry = revision.lock.get(f"{stage}@{experiment}")
        if entry is None:
            if stage not in {"record", "import"}:
                missing.append(stage)
            continue
        for file, values in (entry.get("params") or {}).items():
            if file not in documents:
                text = revision.file(file)
                documents[file] = {} if text is None else parse_params(Path(file), text.decode("utf-8"))
            if any(_plain(_at(documents[file], key)) != _plain(value) for key, value in values.items()):
                changed.append(stage)
    again = f"'dvc repro report@{experiment}'"
    if changed:
        yield f"params changed after its results were made ({', '.join(dict.fromkeys(changed))}); {again} renews them"
    if missing and len(missing) < len(STAGES) - 2:
        yield f"not run yet: {', '.join(missing)}; {again} does it"


def _at(document: Any, key: str) -> Any:
    for part in key.split("."):
        document = document.get(part) if isinstance(document, dict) else None
    return document


def _plain(value: Any) -> Any:
    """Return a value in a form in which two dialects of YAML agree: 1e-05 is a text in one, a number in the other."""
    if isinstance(value, dict):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_plain(each) for each in value]
    if isinstance(value, bool) or value is None:
        return value
    try:
        return float(value)
    except (TypeError, ValueError):
        return str(value)


def _cache(root: Path) -> Path:
    """Return where DVC keeps outputs, as its configuration says; the local one goes before that in Git."""
    for name in ("config.local", "config"):
        place = _config(root, name).get("cache", "dir", fallback=None)
        if place is not None:
            return (root / ".dvc" / place).resolve()
    return root / ".dvc" / "cache"


def _has_remote(root: Path) -> bool:
    return any(section.startswith("'remote") for name in ("config.local", "config") for section in _config(root, name))


def _config(root: Path, name: str) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    try:
        parser.read(root / ".dvc" / name, encoding="utf-8")
    except (configparser.Error, UnicodeDecodeError) as error:
        message = f"{root / '.dvc' / name}: DVC's configuration cannot be read ({str(error).splitlines()[0]})"
        raise ComparisonError(message) from error
    return parser


def _git(root: Path, *arguments: str) -> str:
    done = _run(root, *arguments)
    if done.returncode != 0:
        message = f"git {arguments[0]}: {(done.stderr.decode(errors='replace').splitlines() or ['it failed'])[0]}"
        raise ComparisonError(message)
    return done.stdout.decode("utf-8", errors="replace").strip()


def _run(root: Path, *arguments: str) -> subprocess.CompletedProcess[bytes]:
    try:
        return subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, check=False, timeout=60)
    except (OSError, subprocess.SubprocessError) as error:
        message = f"git cannot be run ({error}); revisions are read from Git"
        raise ComparisonError(message) from error
