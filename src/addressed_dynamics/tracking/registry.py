"""Delivered models in MLflow's registry: a version for each, and the alias `champion` on the best that is known.

The alias moves only to a model that is better on validation data, and only between models that were measured on the
same data in the same way; a version's description says why it moved or stayed. What is registered is a folder of
safetensors and JSON that a module of this package loads: no pickle, and no code.
"""

from __future__ import annotations

import hashlib
import json
import platform
import re
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version as version_of
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from addressed_dynamics.base.criteria import Criterion, is_better
from addressed_dynamics.base.files import write_json, write_text
from addressed_dynamics.base.versions import tree_digest
from addressed_dynamics.tracking.parents import DATA_TAG
from addressed_dynamics.tracking.store import current_store
from addressed_dynamics.tracking.views import model_description, model_path, run_path

if TYPE_CHECKING:
    from addressed_dynamics.simulators.serving import Served

CHAMPION = "champion"
"""Alias of the best version of a model."""
DIGEST_TAG = "digest"
"""Tag of a version: what tells its model from others."""
PARAMS_TAG = "evaluation_params"
"""Tag of a version: digest of the params that it was evaluated with."""
VALIDATION = "validation/"
"""With it begin the tags and metrics of what a model reaches on validation data."""
TEST = "test/"
"""With it begin the metrics of what it reaches on test data."""

DATA = "model"
"""Folder of a logged model with what `simulators.packing.pack` writes."""

_DIGITS = 16
_SHOWN_UNITS = 12
_NEEDED = ("mlflow", "numpy", "pandas", "safetensors", "torch")


@dataclass(frozen=True)
class Offer:
    """A delivered model, as the registry takes it."""

    name: str
    """Name of the registered model."""
    folder: Path
    """The model's files."""
    served: Served
    """The same, loaded."""
    criteria: Sequence[Criterion]
    """What it reaches on validation data, what counts most first; nothing if that was not measured."""
    figures: Mapping[str, float]
    """What it reaches on test data."""
    evaluation: Mapping[str, Any]
    """Params of the evaluation."""
    data: str | None
    """Digest of the data that it was evaluated on; None if that is not known."""

    @property
    def digest(self) -> str:
        """What tells the model from others: a function of its files."""
        return tree_digest(self.folder)

    @property
    def tags(self) -> dict[str, str]:
        """What is kept of its evaluation."""
        measured = {f"{VALIDATION}{each.name}": repr(each.value) for each in self.criteria}
        data = {} if self.data is None else {DATA_TAG: self.data}
        return {**data, PARAMS_TAG: _digest(self.evaluation), **measured}


@dataclass(frozen=True)
class Registered:
    """What became of an offer."""

    name: str
    """Name of the registered model."""
    version: str
    """Its version."""
    model_id: str
    """MLflow's identifier of the logged model."""
    is_new: bool
    """Whether the version was made now; else the same model was registered before."""
    why: str
    """Whether the version is the champion, and why, in a sentence."""

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.name} version {self.version} in MLflow: {self.why}"


def register(client: Any, run_id: str, offer: Offer) -> Registered:
    """Register a delivered model if that was not done before, and let the alias `champion` move if it is better.

    Call it while the store is locked: of two at once each would make the first version.

    Args:
        client: MLflow's.
        run_id: the run that evaluated it; metrics of the model are logged with it.
        offer: the model.
    """
    from mlflow.entities import LoggedModelInput

    digest, run = offer.digest, client.get_run(run_id)
    champion, versions = _versions(client, offer.name)
    known = next((each for each in versions if each.tags.get(DIGEST_TAG) == digest), None)
    if known is None:
        model_id = _log_model(client, run, offer, digest)
        with current_store(client.tracking_uri):  # the registry's own client looks for the model there
            found = client.create_model_version(
                offer.name, f"models:/{model_id}", run_id, {DIGEST_TAG: digest}, model_id=model_id
            )
        # By which the page of the logged model links to the version.
        linked = json.dumps([{"name": offer.name, "version": found.version}])
        client.set_logged_model_tags(model_id, {"mlflow.modelVersions": linked})
    else:
        found, model_id = known, str(known.source).removeprefix("models:/")
        client.log_inputs(run_id, models=[LoggedModelInput(model_id)])
    version = str(found.version)
    _log_metrics(client, run_id, model_id, offer)
    moves, why = _judged(offer, version, next((each for each in versions if str(each.version) == champion), None))
    if moves or known is None or not offer.tags.items() <= known.tags.items():
        for key, value in offer.tags.items():
            client.set_model_version_tag(offer.name, version, key, value)
        if moves:
            client.set_registered_model_alias(offer.name, CHAMPION, version)
        client.update_model_version(offer.name, version, _description(run, model_id, offer, why))
    return Registered(offer.name, version, model_id, is_new=known is None, why=why)


def _versions(client: Any, name: str) -> tuple[str | None, list[Any]]:
    """Return the version that is the champion, if one is, and all; the registered model is made if there is none."""
    from mlflow.exceptions import MlflowException
    from mlflow.protos.databricks_pb2 import RESOURCE_DOES_NOT_EXIST, ErrorCode

    try:
        model = client.get_registered_model(name)
    except MlflowException as error:
        if error.error_code != ErrorCode.Name(RESOURCE_DOES_NOT_EXIST):
            raise
        client.create_registered_model(name, description=model_description(name))
        return None, []
    found, token = list[Any](), None
    while True:
        page = client.search_model_versions(f"name = '{name}'", page_token=token)
        found += page
        if not (token := page.token):
            break
    champion = model.aliases.get(CHAMPION)
    return None if champion is None else str(champion), found


def _judged(offer: Offer, version: str, champion: Any | None) -> tuple[bool, str]:
    """Return whether the alias moves to a version, and why or why not."""
    if champion is None:
        return True, "it is the champion, because no other version was"
    other = f"version {champion.version}"
    if str(champion.version) == version:
        return False, "it is the champion still"
    if not offer.criteria:
        return False, f"{other} stays the champion, because this one was not measured on validation data"
    if offer.data is None or champion.tags.get(DATA_TAG) != offer.data:
        return False, f"{other} stays the champion, because it was measured on other data and so cannot be compared"
    if champion.tags.get(PARAMS_TAG) != offer.tags[PARAMS_TAG]:
        return False, f"{other} stays the champion, because it was evaluated with other params and cannot be compared"
    try:
        theirs = {each.name: float(champion.tags[f"{VALIDATION}{each.name}"]) for each in offer.criteria}
    except (KeyError, ValueError):
        return False, f"{other} stays the champion, because it was not measured by the same figures"
    figures = ", ".join(f"{each.name} {each.value:.4g} and not {theirs[each.name]:.4g}" for each in offer.criteria)
    if is_better(offer.criteria, theirs):
        return True, f"it is the champion in place of {other}, because it is better on validation data ({figures})"
    return False, f"{other} stays the champion, because this one is no better on validation data ({figures})"


def _description(run: Any, model_id: str, offer: Offer, why: str) -> str:
    """Return what a version's page says of it, in Markdown."""
    day = datetime.now(UTC).strftime("%Y-%m-%d")
    measured = ", ".join(f"{each.name} {each.value:.4g}" for each in offer.criteria) or "not measured"
    links = (
        f"[evaluation]({run_path(run.info.experiment_id, run.info.run_id)}), "
        f"[model and metrics]({model_path(run.info.experiment_id, model_id)})"
    )
    which = ", ".join(f"{name} {value}" for name, value in offer.served.facts.items())
    # Those of frames before have the same.
    now = [each for each in offer.served.inputs if each.unit and not re.search(r"\.-\d+$", each.name)]
    units = [f"{each.name} [{each.unit}]" for each in now]
    shown = f" ({', '.join(units)})" if 0 < len(units) <= _SHOWN_UNITS else ""
    return "\n\n".join(
        [
            f"As of {day}, {why}.",
            f"On validation data: {measured}.",
            f"Which model: {which}; {links}.",
            f"Units and bounds of its columns stand in the model's metadata{shown}.",
        ]
    )


def _log_model(client: Any, run: Any, offer: Offer, digest: str) -> str:
    """Keep a model with the run that evaluated it; return MLflow's identifier of it."""
    from mlflow.entities import LoggedModelOutput

    model = client.create_logged_model(
        run.info.experiment_id, name=offer.name, source_run_id=run.info.run_id, tags={DIGEST_TAG: digest},
        params=dict(offer.served.facts), model_type="simulator",
    )  # fmt: skip
    model_id = str(model.model_id)
    try:
        with tempfile.TemporaryDirectory() as temporary:
            _write_model(Path(temporary), model, run, offer.served)
            client.log_model_artifacts(model_id, temporary)
        # What is large is sent as it lies.
        client.log_model_artifacts(model_id, str(offer.folder), DATA)
    except Exception:
        client.finalize_logged_model(model_id, "FAILED")
        raise
    client.finalize_logged_model(model_id, "READY")
    client.log_outputs(run.info.run_id, [LoggedModelOutput(model_id, step=0)])
    return model_id


def _write_model(folder: Path, model: Any, run: Any, served: Served) -> None:
    """Write the files that make a folder an MLflow model of the flavour pyfunc, but for its data.

    Not by mlflow.pyfunc.save_model: that would copy the data once more, load the model to try it, which the caller did,
    and look through all installed packages, which takes seconds.
    """
    from mlflow.models import Model

    example = {name: values.tolist() for name, values in served.example().items()}
    table = {"columns": list(example), "data": [list(row) for row in zip(*example.values(), strict=True)]}
    write_json(folder / "input_example.json", table)
    write_json(folder / "serving_input_example.json", {"dataframe_split": table})
    # This package is on no index, and to name it would invite whoever takes its name there.
    pins = [f"{name}=={version_of(name).partition('+')[0]}" for name in _NEEDED]
    write_text(folder / "requirements.txt", "".join(f"{pin}\n" for pin in pins))
    write_text(
        folder / "python_env.yaml", f"python: {platform.python_version()}\ndependencies:\n- -r requirements.txt\n"
    )
    columns = (*served.inputs, *served.outputs)
    about = Model(
        artifact_path=model.artifact_location,
        run_id=run.info.run_id,
        signature=_signature(served),
        model_uuid=model.model_id,
        model_id=model.model_id,
        saved_input_example_info={
            "artifact_path": "input_example.json",
            "type": "dataframe",
            "pandas_orient": "split",
            "serving_input_path": "serving_input_example.json",
        },
        metadata={
            "package": f"addressed-dynamics {version_of('addressed-dynamics')}",
            "units": {each.name: each.unit for each in columns if each.unit},
            "bounds": {
                each.name: [each.low, each.high] for each in columns if np.isfinite([each.low, each.high]).all()
            },
        },
    )
    about.add_flavor(
        "python_function",
        loader_module=type(served).__module__,
        data=DATA,
        python_version=platform.python_version(),
        env={"virtualenv": "python_env.yaml"},
    )
    about.save(str(folder / "MLmodel"))


def _signature(served: Served) -> Any:
    from mlflow.models import ModelSignature
    from mlflow.types import ColSpec, DataType, ParamSchema, ParamSpec, Schema

    def schema(columns: Sequence[Any]) -> Any:
        # As wide as there are: MLflow widens what it is given, and narrows nothing.
        return Schema([ColSpec(DataType.long if each.whole else DataType.double, each.name) for each in columns])

    settings = [ParamSpec(name, DataType.double, float(value)) for name, value in served.settings.items()]
    return ModelSignature(schema(served.inputs), schema(served.outputs), ParamSchema(settings) if settings else None)


def _log_metrics(client: Any, run_id: str, model_id: str, offer: Offer) -> None:
    from mlflow.entities import Metric

    now = int(time.time() * 1000)
    values = {f"{VALIDATION}{each.name}": each.value for each in offer.criteria}
    values |= {f"{TEST}{name}": value for name, value in offer.figures.items()}
    data = {} if offer.data is None else {"dataset_name": offer.name, "dataset_digest": offer.data}
    metrics = [
        Metric(key, float(value), now, 0, model_id=model_id, run_id=run_id, **data) for key, value in values.items()
    ]
    client.log_batch(run_id, metrics=metrics)


def _digest(value: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:_DIGITS]
