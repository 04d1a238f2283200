"""Convert an experiment's MCAP logs to Parquet tables, and report on the data."""

from pathlib import Path

from addressed_dynamics.base.params.experiments import load_params
from addressed_dynamics.sources.transitions.conversion import convert_recording
from pipeline.common import available_cores, progress, raw_dir, reports_dir, run_stage, tables_dir


def main(experiment: str, params_file: Path) -> None:
    """Convert the recording of `experiment`."""
    params = load_params(params_file, experiment).convert
    with progress("convert", "step") as bar:
        convert_recording(
            raw_dir(experiment),
            tables_dir(experiment),
            reports_dir(experiment),
            params,
            cores=available_cores(),
            progress=bar.update,
        )


if __name__ == "__main__":
    run_stage(main)
