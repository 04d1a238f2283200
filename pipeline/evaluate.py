"""Measure all models of an experiment on data that none of them has seen, one step ahead and running freely."""

from functools import partial

from addressed_dynamics import tracking
from addressed_dynamics.base.files import atomic_path, write_json
from addressed_dynamics.base.kinds import supplied
from addressed_dynamics.base.memory import memory_for_samples
from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.evaluation.common.evaluated import write_evaluated
from addressed_dynamics.features.common.spool import Spool
from addressed_dynamics.simulators.calibrated import write_trust
from addressed_dynamics.simulators.delivery import write_delivered
from addressed_dynamics.simulators.packing import packed
from addressed_dynamics.simulators.rewards import write_task
from addressed_dynamics.simulators.starts import write_starts
from pipeline.stage import (
    Call,
    available_cores,
    checkpoints_dir,
    evaluation_dir,
    first_of,
    models_dir,
    reports_dir,
    run_stage,
    say,
    tables_dir,
)


def main(call: Call) -> str:
    """Evaluate the models of an experiment; return what came out."""
    experiment, evaluate = call.experiment, supplied("evaluation", call.kind).evaluate
    params = load_experiment(call.params_file, experiment, call.kind).evaluation
    spool = Spool(checkpoints_dir(experiment), memory_for_samples())
    found = evaluate(tables_dir(experiment), models_dir(experiment), params, cores=available_cores(), spool=spool)
    write_trust(models_dir(experiment), found.calibrated, found.uncalibrated)
    write_starts(models_dir(experiment), found.starts)
    write_task(models_dir(experiment), found.task)
    write_delivered(models_dir(experiment), found.delivered)
    with atomic_path(evaluation_dir(experiment)) as folder:
        write_evaluated(found, folder)
        name = f"{experiment} evaluation seed={found.delivered.seed}"
        with tracking.run(stage="evaluate", experiment=experiment, name=name, params=params.model_dump(mode="json"),
                          params_file=call.params_file, data=tables_dir(experiment)) as run:  # fmt: skip
            run.log(found.headline, step=0)
            run.log_dataset(experiment, tables_dir(experiment), context="evaluation")
            run.log_output(folder)
            run.log_artifact(folder / "evaluation.json")
            run.log_arrays(
                "episodes", {name: each for name, each in found.arrays.items() if name.startswith("paired_")}
            )
            if found.load_served is not None and (registered := run.register(
                experiment, partial(packed, models_dir(experiment), found.load_served), criteria=found.criteria,
                figures=found.figures, evaluation=params.model_dump(mode="json"), data=tables_dir(experiment),
            )):  # fmt: skip
                say(f"{experiment}: {registered}")
    write_json(reports_dir(experiment) / "summary.json", found.summary)
    return f"{first_of(found.summary)}; all in {reports_dir(experiment) / 'summary.json'}"


if __name__ == "__main__":
    run_stage(main)
