"""Import logs or tables that somebody else recorded as logs of transitions."""

from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.base.params.experiments import load_source_params
from addressed_dynamics.episodes.imports import read_import_record
from addressed_dynamics.importing import import_logs
from addressed_dynamics.importing.importer import ACCOUNT
from pipeline.stage import Call, available_cores, progress, raw_dir, run_stage, say


def main(call: Call) -> str:
    """Import what an experiment is made of; return what came out."""
    source = load_source_params(call.params_file, call.experiment, call.kind)
    with atomic_path(raw_dir(call.experiment)) as folder, progress("import", "step") as bar:
        import_logs(source, folder, name=call.experiment, progress=bar.update, cores=available_cores())
    account = raw_dir(call.experiment) / ACCOUNT
    record = read_import_record(account)
    warnings = record.warnings if record else []
    if warnings:
        say(f"{call.experiment}: warning: {warnings[0]}")
    number = {0: "", 1: " with one warning"}.get(len(warnings), f" with {len(warnings):,} warnings")
    return f"{bar.n:,} transitions were imported{number}; what was dropped and why is in {account}"


if __name__ == "__main__":
    run_stage(main)
