"""Measure all models of an experiment on data that none of them has seen, one step ahead and running freely."""

from addressed_dynamics import tracking
from addressed_dynamics.base.files import atomic_path, save_arrays, write_json
from addressed_dynamics.base.kinds import supplied
from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.simulators.delivery import write_delivered
from pipeline.stage import (
    Call,
    available_cores,
    evaluation_dir,
    models_dir,
    reports_dir,
    run_stage,
    tables_dir,
    write_curves,
)


def main(call: Call) -> None:
    """Evaluate the models of an experiment."""
    experiment, evaluate = call.experiment, supplied("evaluation", call.kind).evaluate
    params = load_experiment(call.params_file, experiment, call.kind).evaluation
    found = evaluate(tables_dir(experiment), models_dir(experiment), params, cores=available_cores())
    with atomic_path(evaluation_dir(experiment)) as folder:
        folder.mkdir()
        save_arrays(folder / "arrays.npz", dict(found.arrays))
        for name, rows in found.curves.items():
            write_curves(folder / f"{name}.csv", rows)
        write_json(folder / "evaluation.json", found.report)
        name = f"{experiment} evaluation seed={found.delivered.seed}"
        with tracking.run(stage="evaluate", experiment=experiment, name=name, params=params.model_dump(mode="json"),
                          params_file=call.params_file) as run:  # fmt: skip
            run.log(found.headline, step=0)
            run.log_output(folder)
    write_delivered(models_dir(experiment), found.delivered)
    write_json(reports_dir(experiment) / "summary.json", found.summary)


if __name__ == "__main__":
    run_stage(main)
