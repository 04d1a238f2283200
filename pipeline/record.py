"""Record the segments of an experiment's plan as MCAP logs."""

from pathlib import Path

from addressed_dynamics.base.params.experiments import load_record_params
from addressed_dynamics.recording.plan import record_plan, recording_folder
from pipeline.common import progress, raw_dir, run_stage


def main(experiment: str, params_file: Path) -> None:
    """Record `experiment`."""
    plan = load_record_params(params_file, experiment)
    total = sum(segment.transitions for segment in plan.segments)
    with recording_folder(raw_dir(experiment)) as folder, progress("record", "step", total) as bar:
        record_plan(plan, folder, progress=bar.update)


if __name__ == "__main__":
    run_stage(main)
