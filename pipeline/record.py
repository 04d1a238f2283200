"""Record the segments of an experiment's plan as MCAP logs, or clips of a walker that is made up."""

from addressed_dynamics.base.params.experiments import load_record_params
from addressed_dynamics.base.params.recording import WalkerParams
from addressed_dynamics.recording.walker import make_walker_clips
from pipeline.stage import Call, progress, raw_dir, run_stage


def main(call: Call) -> str:
    """Record an experiment; return what came out."""
    plan, target = load_record_params(call.params_file, call.experiment, call.kind), raw_dir(call.experiment)
    if isinstance(plan, WalkerParams):
        make_walker_clips(target, seed=plan.seed, minutes=plan.minutes)
        return f"{plan.minutes:g} minutes of clips of a made-up walker are in {target}"
    from addressed_dynamics.recording.plan import record_plan, recording_folder

    total = sum(segment.transitions for segment in plan.segments)
    with recording_folder(target) as folder, progress("record", "step", total) as bar:
        record_plan(plan, folder, progress=bar.update)
    return f"{total:,} transitions are in {len(list(target.glob('*.mcap')))} logs in {target}"


if __name__ == "__main__":
    run_stage(main)
