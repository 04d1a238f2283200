"""Measure all models of motion on held-out frames, one step ahead, and in the closed loop under scripts of commands."""

from pathlib import Path
from typing import Any

from addressed_dynamics import tracking
from addressed_dynamics.base.files import atomic_path, save_arrays, write_json
from addressed_dynamics.base.params.experiments import load_motion_params
from addressed_dynamics.base.torch_runtime import prepare_torch
from addressed_dynamics.evaluation.motion.candidates import (
    baseline_candidates,
    ensemble_candidates,
    load_motion_ensembles,
    reference_candidates,
)
from addressed_dynamics.evaluation.motion.closed_loop.commands import standard_script
from addressed_dynamics.evaluation.motion.suite import (
    ClosedLoopPlan,
    MotionData,
    evaluate_motion,
    evaluate_motion_addressing,
    motion_arrays,
    shown_candidates,
)
from addressed_dynamics.networks.files import load_motion_network
from addressed_dynamics.sources.motion.splits import MotionSplit
from addressed_dynamics.sources.motion.tables import load_motion, read_columns
from addressed_dynamics.training.losses import reported_loss
from pipeline.addressings import trained_ensembles
from pipeline.common import available_cores, evaluation_dir, models_dir, reports_dir, run_stage, tables_dir

HELD_OUT: tuple[MotionSplit, ...] = ("test", "cycles", "rows")
"""Splits that are evaluated: whole clips, which are always needed, and what else the params hold out."""


def main(experiment: str, params_file: Path) -> None:
    """Evaluate the models of `experiment`."""
    params = load_motion_params(params_file, experiment).evaluation
    prepare_torch(threads=1)
    tables, folder_of_models = tables_dir(experiment), models_dir(experiment)
    filled = {"test", *read_columns(tables, ["split"])["split"].tolist()}
    data = MotionData(
        load_motion(tables, "train"),
        load_motion(tables, "validation"),
        {split: load_motion(tables, split) for split in HELD_OUT if split in filled},
    )
    ensembles = load_motion_ensembles(folder_of_models)
    candidates = [
        *ensemble_candidates(ensembles),
        *baseline_candidates(folder_of_models / "baselines"),
        *reference_candidates(data.train, data.validation, Path(params.released) if params.released else None),
    ]
    plan = ClosedLoopPlan(
        params.closed_loop.validation_seed,
        params.closed_loop.validation_scripts,
        params.closed_loop.validation_seconds,
        standard_script(),
    )
    report, traces = evaluate_motion(candidates, data, plan, cores=available_cores())
    seed, mode = report["delivered"]["seed"], report["delivered"]["mode"]
    folder = trained_ensembles(experiment)[seed]
    loss = reported_loss(load_motion_network(folder).notes["params"]["ensemble"]["loss"])
    report |= {
        "splits": {"train": len(data.train), "validation": len(data.validation)}
        | {split: len(motion) for split, motion in data.held_out.items()},
        "addressing": {
            split: evaluate_motion_addressing(ensembles[seed], motion, loss)
            for split, motion in {"train": data.train, "test": data.held_out["test"]}.items()
        },
    }
    with atomic_path(evaluation_dir(experiment)) as target:
        target.mkdir()
        shown = shown_candidates(candidates, seed, mode)
        save_arrays(target / "arrays.npz", motion_arrays(shown, traces, data))
        with tracking.run(stage="evaluate_motion", experiment=experiment, name=f"{experiment} evaluation seed={seed}",
                          params=params.model_dump(mode="json"), params_file=params_file) as run:  # fmt: skip
            run.log(headline(report), step=0)
            run.write_run_id(target)
    write_json(reports_dir(experiment) / "evaluation.json", report)


def headline(report: dict[str, Any]) -> dict[str, float]:
    """Return the figures that a table of runs should show."""
    delivered = report["delivered"]
    own = report["candidates"][f"ensemble/{delivered['mode']}/seed-{delivered['seed']}"]
    return {
        "mae/test": own["one_step"]["test"]["raw"],
        "mae_normalised/test": own["one_step"]["test"]["normalised"],
        "closed_loop/score": own["closed_loop"]["score"],
    }


if __name__ == "__main__":
    run_stage(main)
