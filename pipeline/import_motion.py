"""Turn motion capture, a database or a folder of clips, into typed tables (Parquet), and report on the data."""

from pathlib import Path

from addressed_dynamics.base.params.experiments import load_motion_params
from addressed_dynamics.sources.motion.conversion import convert_motion
from pipeline.common import progress, reports_dir, run_import, tables_dir


def main(experiment: str, params_file: Path, source: Path) -> None:
    """Import `source` as the motion of `experiment`."""
    params = load_motion_params(params_file, experiment).convert
    with progress("import", "row") as bar:
        convert_motion(source, tables_dir(experiment), reports_dir(experiment), params, bar.update)


if __name__ == "__main__":
    run_import(main)
