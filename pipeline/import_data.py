"""Import logs or tables that somebody else recorded as logs of transitions."""

from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.base.params.experiments import load_source_params
from addressed_dynamics.importing import import_logs
from addressed_dynamics.importing.importer import ACCOUNT
from pipeline.stage import Call, progress, raw_dir, run_stage


def main(call: Call) -> str:
    """Import what an experiment is made of; return what came out."""
    source = load_source_params(call.params_file, call.experiment, call.kind)
    with atomic_path(raw_dir(call.experiment)) as folder, progress("import", "step") as bar:
        import_logs(source, folder, name=call.experiment, progress=bar.update)
    return f"{bar.n:,} transitions were imported; what was dropped and why is in {raw_dir(call.experiment) / ACCOUNT}"


if __name__ == "__main__":
    run_stage(main)
