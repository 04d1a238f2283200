"""Make up clips of a walker, so that the motion experiment runs on a machine without motion capture."""

from pathlib import Path

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.params.experiments import load_motion_params
from addressed_dynamics.recording.walker import make_walker_clips
from pipeline.common import raw_dir, run_stage


def main(experiment: str, params_file: Path) -> None:
    """Make the clips of `experiment`."""
    walker = load_motion_params(params_file, experiment).walker
    if walker is None:
        message = (
            f"{params_file}: {experiment}: there is no 'walker' to make clips of; give one, or take the experiment out "
            "of 'made_up' in params.yaml"
        )
        raise ParamsError(message)
    make_walker_clips(raw_dir(experiment), seed=walker.seed, minutes=walker.minutes)


if __name__ == "__main__":
    run_stage(main)
