"""Small made-up results to report on: everything that the stages before the report write."""

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from builders import CAR
from example_params import EXAMPLE

from addressed_dynamics.base.params.training import AddressingParams, EnsembleParams
from addressed_dynamics.episodes.transitions import ContinuousAction, SpaceSpec
from addressed_dynamics.evaluation.common.specialisation import specialisation
from addressed_dynamics.evaluation.transitions.physics import SIMULATIONS
from addressed_dynamics.evaluation.transitions.records import Evaluation, Recipe
from addressed_dynamics.features.transitions.spec import Angle, FeatureSpec, predicted_dimensions
from addressed_dynamics.reporting.common.blocks import Report
from addressed_dynamics.reporting.common.document import build_report
from addressed_dynamics.reporting.common.origin import Origin
from addressed_dynamics.reporting.transitions.document import account
from addressed_dynamics.reporting.transitions.paper import PaperFigures
from addressed_dynamics.reporting.transitions.results import TransitionResults

OTHERS = ("total_parameters/seed-0", "wide/seed-0", "unequal_bins/seed-0", "random_bins/seed-0")


def summary(mean: float) -> dict[str, float]:
    return {"mean": mean, "median": mean / 10, "p99": mean * 3, "max": mean * 1000}


def candidate(
    one_step: float,
    rollout: float,
    spaces: SpaceSpec = CAR,
    *,
    wall_free: int | None = 30,
    segments: Mapping[str, int] = MappingProxyType({}),
) -> dict[str, Any]:
    """A model with these errors, in every dimension; `wall_free` is None where there are no walls.

    With `segments`, rollouts beside recorded stretches of Acrobot, so many of each segment.
    """
    dimensions = [
        {"name": each.name, "unit": each.unit, "squared": summary(one_step), "absolute": summary(one_step)}
        for each in spaces.observation
    ]
    dimensions += [
        {"name": name.removeprefix("cos_"), "unit": "rad", "squared": summary(one_step), "absolute": summary(one_step)}
        for name in spaces.observation_names
        if name.startswith("cos_angle")
    ]
    return {
        "label": "some model",
        "parameters": 1234,
        "one_step": {"scaled": summary(one_step), "dimensions": dimensions},
        "rollouts": rollouts(rollout, spaces, wall_free, segments),
    }


def beside(one_step: tuple[float, float], rollout: tuple[float, float], spaces: SpaceSpec = CAR) -> dict[str, Any]:
    """Errors in multiples of the addressed ensemble's, with these intervals."""
    first, second = ({"value": (low * high) ** 0.5, "low": low, "high": high} for low, high in (one_step, rollout))
    return {"one_step": first, "rollouts": second, "dimensions": dict.fromkeys(spaces.observation_names, second)}


def rollouts(error: float, spaces: SpaceSpec, wall_free: int | None, segments: Mapping[str, int]) -> dict[str, Any]:
    """Errors of rollouts, with physics where there are segments."""
    spread = {"median": error, "mean": error * 2, "p10": error / 9, "p90": error * 9, "max": error * 20}
    walls = {} if wall_free is None else {"no_wall": wall_free, "wall": 50 - wall_free}
    groups = {"all": sum(segments.values()), **segments} if segments else {"all": 50, **walls}
    bounded = np.isfinite([(each.low, each.high) for each in spaces.observation]).any()
    lost = {"p10": 1.2, "median": 7.25, "p90": None, "never_share": 0.25}
    mechanics = {"lost_seconds": lost, "energy_error": spread, "energy_drift": spread} if segments else None
    return {
        "left_bounds_share": 0.25 if bounded else None,
        "groups": {
            name: {
                "episodes": size,
                "mse": {each: spread if size else None for each in spaces.observation_names},
                "physics": mechanics,
            }
            for name, size in groups.items()
        },
    }


def physics(spaces: SpaceSpec, segments: Mapping[str, int]) -> dict[str, Any]:
    """What simulations make of the rollouts."""
    result = rollouts(1e-7, spaces, None, segments)
    return {
        "step_seconds": 0.5,
        "angle_limit": 0.5,
        "apart": 1e-6,
        "simulations": {name: {"label": f"simulation {name}", **result} for name in SIMULATIONS},
    }


def table(members: int = 2, *, unused: bool = False, selected: float = 1e-7, ratio: float = 500.0) -> dict[str, Any]:
    """A Table 1; with `unused`, the last member is never selected."""
    rows = []
    for member in range(members):
        absent = unused and member == members - 1
        rows.append(
            {
                "member": member,
                "share": 0.0 if absent else 1 / (members - unused),
                "selected": None if absent else selected,
                "not_selected": selected * ratio if members > 1 else None,
                "misclassified": {"per_thousand": 0.0 if absent else 3.0, **summary(0.0 if absent else 1e-6)},
            }
        )
    return {
        "samples": 300,
        "members": rows,
        "agreement": 0.97,
        "misclassified_per_thousand": 3.0 * (members - unused),
        "regret": summary(1e-8),
        "confusion": np.eye(members, dtype=int).tolist(),
    }


def shares(members: int, samples: int, *, unused: bool = False) -> dict[str, Any]:
    """How the members share the samples; with `unused`, the last one is never selected."""
    generator = torch.Generator().manual_seed(members)
    losses = 10.0 ** (torch.rand(members, samples, generator=generator) * 5 - 8)
    scores = -losses.log10().T + torch.randn(samples, members, generator=generator)
    if unused:
        scores[:, -1] = -50.0
    return specialisation(losses, torch.softmax(4 * scores, dim=1))


def evaluation_json(
    own: tuple[float, float] = (1e-7, 1e-6), others: tuple[float, float] = (1e-6, 1e-5), **changes: Any
) -> dict[str, Any]:
    """What evaluate writes, with these one-step and rollout errors of the delivered model and of all others."""
    spaces, members = changes.pop("spaces", CAR), changes.pop("members", 2)
    unused, wall_free = changes.pop("unused", False), changes.pop("wall_free", 30)
    segments = changes.pop("segments", {})
    walls = wall_free is not None
    oracle = candidate(own[0] / 2, 0.0, spaces)
    del oracle["rollouts"]
    own_candidate = candidate(*own, spaces, wall_free=wall_free, segments=segments)
    tables = {variant: table(members, unused=unused) for variant in ("plain", "cost_sensitive")}
    return {
        "loss": "mse",
        "test": {"transitions": 300, "episodes": 4},
        "rollouts": {
            "kind": "environment" if walls else "recorded",
            "steps": 30,
            "steps_wanted": 30 if walls or segments else 50,
            "too_short": {"brief_swings": 12} if segments else {},
            "physics": physics(spaces, segments) if segments else None,
        },
        "delivered": {"seed": 0, "variant": "cost_sensitive"},
        "seeds": {"0": tables, "1": tables},
        "candidates": {
            "ensemble/oracle": oracle,
            "ensemble/argmax": own_candidate,
            "ensemble/argmax/plain": own_candidate,
            "ensemble/argmax/seed-1": own_candidate,
            **{name: candidate(*others, spaces, wall_free=wall_free, segments=segments) for name in OTHERS},
        },
        "specialisation": {
            split: shares(members, samples, unused=unused) for split, samples in (("train", 900), ("test", 300))
        },
        "baseline_losses": {split: dict.fromkeys(OTHERS[:2], others[0]) for split in ("train", "test")},
        "other_recipe": None,
        **changes,
    }


def with_other_recipe(
    document: dict[str, Any], recipe: Recipe, errors: tuple[float, float], *, name: str = "paper_recipe", **kind: Any
) -> dict[str, Any]:
    """What evaluate writes, with one more candidate that has these one-step and rollout errors."""
    members = len(document["specialisation"]["test"]["addressed"])
    other = {
        "name": name,
        "recipe": recipe.model_dump(),
        "specialisation": {split: shares(members, 300) for split in ("train", "test")},
    }
    candidates = {**document["candidates"], f"{name}/seed-0": candidate(*errors, **kind)}
    return {**document, "candidates": candidates, "other_recipe": other}


def evaluation(*args: Any, **changes: Any) -> Evaluation:
    return Evaluation.model_validate(evaluation_json(*args, **changes))


DATA = {
    "transitions": 2000,
    "splits": {name: {"episodes": 4, "transitions": 300} for name in ("train", "validation", "test")},
    "segments": {
        "learning": {"behaviour": "dqn", "count": 6, "transitions": 1000, "terminated_share_last_100": 0.5},
        "walls": {"behaviour": "random", "count": 6, "transitions": 1000, "terminated_share_last_100": None},
    },
    "coverage": {"cells_per_dimension": 50, "per_dimension": {"position": 1.0, "velocity": 0.9}, "plane": 0.7},
    "duplicates": {"rows": 20, "share": 0.01},
    "quality": [],
}


FILES = {
    "data.json": "figures/convert/data.json",
    "learner.csv": "figures/convert/learner.csv",
    "ensemble.csv": "figures/ensemble/ensemble.csv",
    "addressing.json": "figures/addressing/addressing.json",
    "addressing.csv": "figures/addressing/addressing.csv",
    "baselines.json": "figures/baselines/baselines.json",
    "evaluation.json": "evaluation/evaluation.json",
    "horizon.csv": "evaluation/horizon.csv",
    "arrays.npz": "evaluation/arrays.npz",
}
"""Where the stages before the report write what it reads."""
NEEDED = [path for name, path in FILES.items() if not name.endswith(".csv")]
"""Those without which there is no report; of the others it says that they are missing."""


def write_results(
    folder: Path, *, spaces: SpaceSpec = CAR, members: int = 2, unused: bool = False, samples: int = 300, **changes: Any
) -> tuple[Path, Path]:
    """Write what the stages before the report write; return the folders of figures and of the evaluation."""
    figures, arrays = folder / "figures", folder / "evaluation"
    for stage in ("convert", "ensemble", "addressing", "baselines"):
        (figures / stage).mkdir(parents=True)
    arrays.mkdir()
    documents = {
        "data": DATA,
        "evaluation": evaluation_json(spaces=spaces, members=members, unused=unused, **changes),
        "addressing": {
            "delivered": {"0": "cost_sensitive", "1": "plain"},
            "validation": {
                "seed-0/plain": {"regret/mean": 2e-8, "confusion": [[1, 0], [0, 1]]},
                "seed-0/cost_sensitive": {"regret/mean": 1e-8, "confusion": [[1, 0], [0, 1]]},
            },
        },
        "baselines": {name: {"parameters": 1234, "updates": 77} for name in OTHERS},
    }
    for name, document in documents.items():
        (folder / FILES[f"{name}.json"]).write_text(json.dumps(document))
    epochs = range(1, 4)
    per_member = [f"{kind}/{k}" for k in range(members) for kind in ("loss_member", "selected", "not_selected")]
    columns = ["loss/train", "loss/validation", "bins/changed", *per_member]
    trainings = [{"training": f"seed-{seed}", "epoch": epoch} for seed in (0, 1) for epoch in epochs]
    _write_csv(folder / FILES["ensemble.csv"], [row | dict.fromkeys(columns, 0.1 / row["epoch"]) for row in trainings])
    columns = ["agreement", "regret/mean", "regret/max"]
    trainings = [
        {"training": f"seed-0/{name}", "epoch": epoch} for name in ("plain", "cost_sensitive") for epoch in epochs
    ]
    _write_csv(
        folder / FILES["addressing.csv"], [row | dict.fromkeys(columns, 0.1 / row["epoch"]) for row in trainings]
    )
    _write_csv(folder / FILES["horizon.csv"], horizon_rows(spaces, changes.get("segments", {})))
    rows = [{"segment": "learning", "return": -200.0 + i, "terminated": i % 2} for i in range(6)]
    _write_csv(folder / FILES["learner.csv"], rows)
    walls = changes.get("wall_free", 3) is not None
    np.savez(arrays / "arrays.npz", **example_arrays(spaces, members, unused=unused, samples=samples, walls=walls))
    return figures, arrays


def horizon_rows(spaces: SpaceSpec, segments: Mapping[str, int]) -> list[dict[str, Any]]:
    names, models = [*spaces.observation_names], ["ensemble/argmax", *OTHERS]
    if segments:
        names += ["angle_1_error", "angle_2_error", "angle_error", "energy_error", "energy_drift"]
        models = [*SIMULATIONS, *models]
    percentiles = [f"{name}_{share}" for name in names for share in ("p10", "p50", "p90")]
    return [
        {"model": model, "group": group, "horizon": horizon} | dict.fromkeys(percentiles, 1e-5 * horizon)
        for model in models
        for group in ("all", *segments)
        for horizon in (10, 20)
    ]


def example_arrays(
    spaces: SpaceSpec, members: int, *, unused: bool = False, samples: int = 300, walls: bool = True
) -> dict[str, Any]:
    generator = np.random.default_rng(0)
    width = len(spaces.observation)
    observation = generator.uniform(-0.05, 0.05, (samples, width)).astype(np.float32)
    continuous = isinstance(spaces.action, ContinuousAction)
    action = generator.normal(size=(samples, 2)).astype(np.float32) if continuous else np.arange(samples) % 3
    profile = 10.0 ** generator.uniform(-12, -3, (members, samples))
    profile[:, 0] = 0.0
    chosen = np.arange(samples) % (members - unused)
    groups = ["no_wall", "wall"] if walls else ["all"]
    rollouts = generator.uniform(-0.05, 0.05, (len(groups), 31, width))
    return {
        "observation": observation,
        "action": action,
        "episode": np.repeat([3, 7], [samples // 3, samples - samples // 3]),
        "next_observation": observation,
        "predicted": observation + (np.arange(samples) % 2 * 1e-4).astype(np.float32)[:, None],
        "chosen": chosen,
        "best": profile.argmin(axis=0),
        "profile": profile,
        "profile_untrained": profile * 100,
        "rollout_true": rollouts,
        "rollout_predicted": rollouts.astype(np.float32),
        "rollout_group": np.array(groups),
    }


ACROBOT_ANGLES = tuple(Angle(f"angle_{k}", f"cos_angle_{k}", f"sin_angle_{k}", f"velocity_{k}") for k in (1, 2))


def features_of(spaces: SpaceSpec, angles: tuple[Angle, ...] = (), **changes: Any) -> FeatureSpec:
    """Features without any normalisation."""
    width = len(spaces.observation)
    values: dict[str, Any] = {
        "spaces": spaces,
        "history": 1,
        "history_weight": 1.0,
        "target": "change",
        "angles": angles,
        "angle_from": "atan2",
        "velocity": "predicted",
        "input_mean": (0.0,) * (width + 3),
        "input_deviation": (1.0,) * (width + 3),
        "scale": (1.0,) * width,
        "target_deviation": 1.0,
        **changes,
    }
    outputs = len(predicted_dimensions(spaces, angles, values["velocity"]))
    return FeatureSpec(**values, target_mean=(0.0,) * outputs)


def recipe(features: FeatureSpec, ensemble: dict[str, Any] | None = None, **addressing: Any) -> Recipe:
    """The example's recipe with these features and changes."""
    return Recipe(
        features=features.params,
        ensemble=EnsembleParams.model_validate(EXAMPLE["ensemble"] | (ensemble or {}), strict=False),
        addressing=AddressingParams.model_validate(EXAMPLE["addressing"] | addressing, strict=False),
    )


def origin(spaces: SpaceSpec = CAR, **changes: Any) -> Origin[FeatureSpec]:
    values: dict[str, Any] = {
        "title": "MountainCar",
        "params_file": "params.yaml",
        "commit": "abc, with changes",
        "versions": {"torch": "2.0"},
        "recipe": "default",
        "features": features_of(spaces),
        "ensemble": EnsembleParams.model_validate(EXAMPLE["ensemble"], strict=False),
        "addressing": AddressingParams.model_validate(EXAMPLE["addressing"], strict=False),
        "runs": {"ensemble/seed-0": "0123456789abcdef"},
        "experiment": "mountaincar",
    }
    return Origin(**values | changes)


def transitions_report(results: TransitionResults, origin: Origin[FeatureSpec], paper: PaperFigures | None) -> Report:
    return build_report(account(results, origin, paper), results, origin)


def _write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
