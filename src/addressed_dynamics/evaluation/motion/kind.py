"""Measure all models of motion on held-out frames, one step ahead, and in the closed loop under scripts of commands."""

from pathlib import Path
from typing import Any

from addressed_dynamics.base.torch_runtime import prepare_torch
from addressed_dynamics.evaluation.common.evaluated import Evaluated
from addressed_dynamics.evaluation.common.measures import further_rows
from addressed_dynamics.evaluation.motion.candidates import (
    baseline_candidates,
    ensemble_candidates,
    load_motion_ensembles,
    reference_candidates,
)
from addressed_dynamics.evaluation.motion.closed_loop.commands import standard_script
from addressed_dynamics.evaluation.motion.one_step import block_deviation
from addressed_dynamics.evaluation.motion.recommending import Score, recommend
from addressed_dynamics.evaluation.motion.records import UNCALIBRATED, MotionEvaluation
from addressed_dynamics.evaluation.motion.suite import (
    ClosedLoopPlan,
    MotionData,
    evaluate_motion,
    evaluate_motion_addressing,
    motion_arrays,
    shown_candidates,
)
from addressed_dynamics.evaluation.motion.summary import summarise
from addressed_dynamics.features.common.spool import Spool
from addressed_dynamics.features.motion.features import MotionFeatures
from addressed_dynamics.networks.files import load_network
from addressed_dynamics.simulators.delivery import Delivered
from addressed_dynamics.simulators.serving_motion import load_served
from addressed_dynamics.sources.motion.params import MotionEvaluationParams
from addressed_dynamics.sources.motion.splits import MotionSplit
from addressed_dynamics.sources.motion.tables import load_motion, read_columns
from addressed_dynamics.training.losses import reported_loss

HELD_OUT: tuple[MotionSplit, ...] = ("test", "cycles", "rows")
"""Splits that are evaluated: whole clips, which are always needed, and what else the params hold out."""


def evaluate(
    tables: Path,
    models: Path,
    params: MotionEvaluationParams,
    *,
    cores: int,
    spool: Spool | None = None,  # noqa: ARG001 - motion is judged in memory
) -> Evaluated:
    """Evaluate the models in the folder `models` on the held-out frames in `tables`, and in the closed loop."""
    prepare_torch(threads=1)
    filled = {"test", *read_columns(tables, ["split"])["split"].tolist()}
    data = MotionData(
        load_motion(tables, "train"),
        load_motion(tables, "validation"),
        {split: load_motion(tables, split) for split in HELD_OUT if split in filled},
    )
    ensembles = load_motion_ensembles(models)
    candidates = [
        *ensemble_candidates(ensembles),
        *baseline_candidates(models / "baselines", next(iter(ensembles.values())).parameters),
        *reference_candidates(data.train, data.validation, Path(params.released) if params.released else None),
    ]
    plan = ClosedLoopPlan(
        params.closed_loop.validation_seed,
        params.closed_loop.validation_scripts,
        params.closed_loop.validation_seconds,
        standard_script(),
    )
    report, traces = evaluate_motion(candidates, data, plan, cores=cores)
    seed, mode = report["delivered"]["seed"], report["delivered"]["mode"]
    loss = reported_loss(
        load_network(models / "ensemble" / f"seed-{seed}", MotionFeatures).notes["params"]["ensemble"]["loss"]
    )
    report |= {
        "splits": {"train": len(data.train), "validation": len(data.validation)}
        | {split: len(motion) for split, motion in data.held_out.items()},
        "addressing": {
            split: evaluate_motion_addressing(ensembles[seed], motion, loss)
            for split, motion in {"train": data.train, "test": data.held_out["test"]}.items()
        },
    }
    report["recommendation"], recommended = recommend(
        candidates, report["candidates"], data.validation, block_deviation(data.train.y)
    )
    arrays = motion_arrays(shown_candidates(candidates, seed, mode), traces, data)
    delivered = Delivered(seed, None, mode, recommended)
    further = further_rows(f"{__package__}.measures", candidates, data)
    MotionEvaluation.model_validate(report)
    own, measured = f"ensemble/{mode}/seed-{seed}", report["recommendation"]["scores"]
    return Evaluated(
        report, arrays, {}, _headline(report), summarise(report), delivered, further,
        uncalibrated=UNCALIBRATED,
        criteria=Score(**measured[own]).criteria() if own in measured else (), figures=_figures(report, own),
        load_served=load_served,
    )  # fmt: skip


def _headline(report: dict[str, Any]) -> dict[str, float]:
    """Return the figures that a table of runs should show."""
    delivered = report["delivered"]
    found = _figures(report, f"ensemble/{delivered['mode']}/seed-{delivered['seed']}")
    names = {"mae": "mae/test", "mae_normalised": "mae_normalised/test", "closed_loop": "closed_loop/score"}
    return {names[name]: value for name, value in found.items()}


def _figures(report: dict[str, Any], name: str) -> dict[str, float]:
    """Return what a candidate reaches on test clips and under the standard script."""
    found = report["candidates"][name]
    return {
        "mae": found["one_step"]["test"]["raw"],
        "mae_normalised": found["one_step"]["test"]["normalised"],
        "closed_loop": found["closed_loop"]["score"],
    }
