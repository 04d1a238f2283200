"""Turn what was recorded or imported into typed tables (Parquet) with splits, and report on the data."""

from addressed_dynamics.base.kinds import supplied
from addressed_dynamics.base.params.experiments import load_experiment
from pipeline.stage import Call, available_cores, figures_dir, progress, run_stage, tables_dir


def main(call: Call) -> None:
    """Convert the raw data of an experiment."""
    params = load_experiment(call.params_file, call.experiment, call.kind).convert
    tables, figures = tables_dir(call.experiment), figures_dir(call.experiment, "convert")
    with progress("convert", "step") as bar:
        supplied("sources", call.kind).convert(
            call.path, tables, figures, params, cores=available_cores(), progress=bar.update
        )


if __name__ == "__main__":
    run_stage(main)
