"""Small made-up results of an experiment of motion to report on: everything that the stages before the report write."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from example_params import EXAMPLE
from report_examples import FILES

from addressed_dynamics.base.params.training import AddressingParams, EnsembleParams
from addressed_dynamics.episodes.layout import JOINTS, OUTPUT
from addressed_dynamics.evaluation.common.specialisation import specialisation
from addressed_dynamics.evaluation.motion.records import MotionEvaluation
from addressed_dynamics.reporting.common.origin import Origin
from addressed_dynamics.sources.motion.params import MotionFeatureParams

FRAMES = 40
OWN = "ensemble/argmax"
LABELS = {
    "phase_functioned": "PFNN, trained here",
    "total_parameters": "one network, as many parameters as members and addressing together",
    "ridge": "ridge regression",
    "persistence": "persistence and velocity",
}


def one_step(raw: float, normalised: float) -> dict[str, Any]:
    """Errors that are the same in all blocks and joints."""
    blocks = [
        {"block": each.name, "unit": each.unit, "columns": len(each.columns), "raw": raw, "normalised": normalised}
        for each in OUTPUT.blocks
    ]
    joints = [{"joint": name, "position": raw + index / 10, "velocity": raw / 10} for index, name in enumerate(JOINTS)]
    return {"rows": 300, "raw": raw, "normalised": normalised, "blocks": blocks, "joints": joints}


def kind(name: str, limbs: float, skate: float | None, frozen: float) -> dict[str, Any]:
    return {
        "kind": name,
        "frames": 100,
        "lost": 0,
        "commanded_speed": 150.0,
        "speed": 140.0,
        "speed_error": 10.0,
        "facing_error": None if name == "stand" else 5.0,
        "limb_speed": limbs,
        "frozen_share": frozen,
        "skate_speed": skate,
        "contact_share": 0.3,
        "slowest_foot_speed": 20.0,
        "bone_drift": 0.01,
    }


def candidate(
    group: str,
    seed: int | None = 0,
    *,
    raw: float = 0.2,
    normalised: float | None = None,
    score: float = 0.9,
    limbs: float = 60.0,
    skate: float | None = 10.0,
    alive: bool = True,
    near: float | None = None,
) -> dict[str, Any]:
    """A model with these figures; `near` is its error on near copies."""
    normalised = raw / 2 if normalised is None else normalised
    errors = {"test": one_step(raw, normalised), "rows": one_step(raw / 2 if near is None else near, normalised / 2)}
    frozen = 0.0 if alive else 0.9
    return {
        "group": group,
        "seed": seed,
        "label": LABELS.get(group, group),
        "parameters": 1234,
        "one_step": errors,
        "closed_loop": {
            "score": score,
            "validation_score": score - 0.1,
            "run": {
                "seconds": 60.0,
                "lived_seconds": 60.0,
                "alive": alive,
                "largest_bone_drift": 0.1,
                "kinds": [kind(name, limbs, skate, frozen) for name in ("all", "moving", "stand", "walk", "jog_turn")],
            },
        },
    }


def phase_use(gait: str, information: float) -> dict[str, Any]:
    return {
        "gait": gait,
        "rows": 96,
        "counts": [[2] * 12 + [1] * 12, [1] * 12 + [2] * 11 + [0]],
        "choice_bits": 1.0,
        "information_share": information,
        "chance_share": 0.05,
        "chance_share_p95": 0.08,
    }


def split_addressing(samples: int, gaits: tuple[str, ...], information: float, members: int = 2) -> dict[str, Any]:
    generator = torch.Generator().manual_seed(samples)
    losses = 10.0 ** (torch.rand(members, samples, generator=generator) - 2)
    return {
        "specialisation": specialisation(losses, torch.softmax(-losses.log().T, dim=1)),
        "phase_use": [phase_use(gait, information) for gait in ("all", *gaits)],
    }


def evaluation_json(*others: dict[str, Any], own: dict[str, Any] | None = None, **changes: Any) -> dict[str, Any]:
    """What evaluate_motion writes of the delivered model with these figures, and of these other candidates."""
    information = changes.pop("information", 0.5)
    delivered = [candidate(OWN, **(own or {})), *changes.pop("more_seeds", []), candidate("ensemble/sample", score=0.7)]
    found = [*delivered, *others]
    gait = {"frames": 100, "root_speed": 150.0, "skate_speed": 1.0, "slowest_foot_speed": 2.0, "contact_share": 0.3}
    speeds = {"all": 55.0, "walk": 50.0, "jog": 80.0}
    return {
        "candidates": {
            each["group"] if each["seed"] is None else f"{each['group']}/seed-{each['seed']}": each for each in found
        },
        "delivered": {"seed": 0, "mode": "argmax"},
        "splits": {"train": 900, "validation": 100, "test": 300, "rows": 20},
        "reference": {"gaits": [gait | {"gait": name, "limb_speed": speed} for name, speed in speeds.items()]},
        "addressing": {
            "train": split_addressing(900, ("walk", "jog"), information),
            "test": split_addressing(300, ("walk",), information),
        },
        **changes,
    }


def evaluation(*others: dict[str, Any], own: dict[str, Any] | None = None, **changes: Any) -> MotionEvaluation:
    return MotionEvaluation.model_validate(evaluation_json(*others, own=own, **changes))


def example() -> dict[str, Any]:
    """An evaluation with all kinds of candidates."""
    return evaluation_json(
        candidate("phase_functioned", raw=0.3, score=0.8),
        candidate("total_parameters", raw=0.15, score=0.95),
        candidate("persistence", None, raw=0.05, score=0.1, alive=False, skate=None),
        candidate("ridge", None, raw=0.02, score=0.05, alive=False, limbs=1000.0),
    )


def data_json(prefix: str = "Walker", *, made_up: bool = True) -> dict[str, Any]:
    """What convert writes, of clips with such names."""
    clips = {
        f"{prefix}_{name}{mirror}": {
            "group": f"{prefix}_{name}",
            "rows": 300,
            "cycles": 5,
            "seconds": 5.0,
            "splits": {split: 300},
        }
        for name, split in (("jog", "train"), ("run", "train"), ("stroll", "test"))
        for mirror in ("", "_mirror")
    }
    speeds = {"q05": 1.0, "q50": 100.0, "q95": 200.0}
    return {
        "rows": 1800,
        "seconds": 30.0,
        "source": {
            "rows": 1800,
            "exact_duplicates": 0,
            "other_patches": 0,
            "boundaries": "files",
            "made_up": {"program": "walker", "seed": 0, "minutes": 3.0} if made_up else None,
        },
        "splits": {"train": {"rows": 1200, "clips": 4}, "test": {"rows": 600, "clips": 2}},
        "clips": clips,
        "gaits": {"stand": 0.0, "walk": 0.4, "jog": 0.6},
        "speed": {"unit": "cm/s", "all": speeds, "walk": speeds, "jog": speeds},
        "quality": {
            "constant_columns": ["input.height_left.+0", "input.height_left.+10"],
            "flat_terrain": True,
            "greatest_jump_inside_cycles": {"joint_velocity": {"value": 0.0, "unit": "cm/frame"}},
        },
    }


def arrays(
    names: tuple[str, ...] = (f"{OWN}/seed-0", "phase_functioned/seed-0"), frames: int = FRAMES
) -> dict[str, Any]:
    """What evaluate_motion keeps for figures: people whose joints are all over the place."""
    generator = np.random.default_rng(0)
    found: dict[str, Any] = {"frames.true": generator.normal(size=(30, 2, 3)).astype(np.float32)}
    for name in names:
        ahead = np.linspace(0.0, 100.0, frames)
        joints = generator.normal(0.0, 20.0, (1, len(JOINTS), 3)) + np.array([0.0, 90.0, 0.0])
        steps = {
            each: generator.uniform(1.0, 100.0, frames - 1)
            for each in ("speed", "commanded_speed", "facing_error", "limb_speed", "slowest_foot_speed", "bone_drift")
        }
        loop = {
            "joint_position": (joints + ahead[:, None, None] * [0.0, 0.0, 1.0]).astype(np.float32),
            "root_position": np.stack([np.zeros(frames), ahead], axis=1),
            "commanded_velocity": np.tile([0.0, 2.5], (frames, 1)),
            "contact": np.ones((frames, 4), np.float32),
            "living": np.ones(frames - 1, np.bool_),
            **steps,
        }
        found[f"frames.{name}"] = found["frames.true"] + np.float32(0.1)
        found |= {f"loop.{name}.{key}": value for key, value in loop.items()}
    return found


def write_results(folder: Path, *, prefix: str = "Walker", **changes: Any) -> tuple[Path, Path]:
    """Write what the stages before the report write; return the folders of figures and of the evaluation."""
    figures, target = folder / "figures", folder / "evaluation"
    for stage in ("convert", "ensemble", "addressing", "baselines"):
        (figures / stage).mkdir(parents=True)
    target.mkdir()
    documents = {
        "data": data_json(prefix),
        "evaluation": example() | changes,
        "addressing": {"delivered": {"0": "plain"}, "validation": {"seed-0/plain": {"regret/mean": 0.1}}},
        "baselines": {"phase_functioned/seed-0": {"parameters": 1234, "updates": 77}},
    }
    for name, document in documents.items():
        (folder / FILES[f"{name}.json"]).write_text(json.dumps(document))
    columns = ["loss/train", "loss/validation", "bins/changed"]
    columns += [f"{name}/{member}" for name in ("loss_member", "selected", "not_selected") for member in (0, 1)]
    _write_csv(folder / FILES["ensemble.csv"], "seed-0", columns)
    _write_csv(folder / FILES["addressing.csv"], "seed-0/plain", ["agreement", "regret/mean", "regret/max"])
    np.savez(target / "arrays.npz", **arrays())
    return figures, target


def origin(**changes: Any) -> Origin[MotionFeatureParams]:
    values: dict[str, Any] = {
        "title": "Motion",
        "params_file": "params.yaml",
        "recipe": "default",
        "commit": "abc",
        "versions": {"torch": "2.0"},
        "features": MotionFeatureParams(target="trajectory_change"),
        "ensemble": EnsembleParams.model_validate(EXAMPLE["ensemble"], strict=False),
        "addressing": AddressingParams.model_validate(EXAMPLE["addressing"], strict=False),
        "runs": {"ensemble/seed-0": "0123456789abcdef"},
        "experiment": "pfnn",
    }
    return Origin(**values | changes)


def _write_csv(path: Path, training: str, columns: list[str]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=["training", "epoch", *columns])
        writer.writeheader()
        writer.writerows(
            {"training": training, "epoch": epoch} | dict.fromkeys(columns, 0.1 / epoch) for epoch in (1, 2)
        )
