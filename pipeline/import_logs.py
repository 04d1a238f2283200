"""Import logs or tables that somebody else recorded as logs of transitions."""

from pathlib import Path

from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.base.params.experiments import load_source_params
from addressed_dynamics.importing import import_logs
from pipeline.common import progress, raw_dir, run_stage


def main(experiment: str, params_file: Path) -> None:
    """Import what `experiment` is made of."""
    source = load_source_params(params_file, experiment)
    with atomic_path(raw_dir(experiment)) as folder, progress("import", "step") as bar:
        import_logs(source, folder, name=experiment, progress=bar.update)


if __name__ == "__main__":
    run_stage(main)
