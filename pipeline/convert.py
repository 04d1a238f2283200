"""Turn what was recorded or imported into typed tables (Parquet) with splits, and report on the data."""

import json

from addressed_dynamics.base.kinds import supplied
from addressed_dynamics.base.params.experiments import load_experiment
from pipeline.stage import Call, available_cores, counted, figures_dir, progress, run_stage, tables_dir


def main(call: Call) -> str:
    """Convert the raw data of an experiment; return what came out."""
    params = load_experiment(call.params_file, call.experiment, call.kind).convert
    tables, figures = tables_dir(call.experiment), figures_dir(call.experiment, "convert")
    with progress("convert", "step") as bar:
        supplied("sources", call.kind).convert(
            call.path, tables, figures, params, cores=available_cores(), progress=bar.update
        )
    report = figures / "data.json"
    splits = json.loads(report.read_text(encoding="utf-8")).get("splits", {})
    return f"rows in {tables}: {counted(splits)}; what the data are like is in {report}"


if __name__ == "__main__":
    run_stage(main)
