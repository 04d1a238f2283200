"""Learn a policy inside the delivered model, and score it there and in the true environment, if there is one."""

from addressed_dynamics import tracking
from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.base.torch_runtime import computing_device, prepare_torch
from addressed_dynamics.episodes.parquet import load_transitions
from addressed_dynamics.policies.records import FIGURES
from addressed_dynamics.policies.suite import train_policy, write_outcome
from pipeline.stage import Call, first_of, models_dir, policies_dir, progress, run_stage, tables_dir


def main(call: Call) -> str:
    """Train the policy of an experiment, if it asks for one; return what came out."""
    experiment, target = call.experiment, policies_dir(call.experiment)
    params = getattr(load_experiment(call.params_file, experiment, call.kind), "policy", None)
    if params is None:
        with atomic_path(target) as folder:
            write_outcome(folder, None)
        return "no policy is asked for"
    prepare_torch(threads=1)
    device = computing_device()
    learners = 2 if params.environment is None else 3
    with progress("learning", "decision", learners * params.decisions) as bar:
        outcome = train_policy(
            models_dir(experiment),
            lambda: load_transitions(tables_dir(experiment), "train"),
            params,
            bar.update,
            device,
        )
    with atomic_path(target) as folder:
        write_outcome(folder, outcome)
        with tracking.run(stage="train_policy", experiment=experiment, name=f"{experiment} policy",
                          params=params.model_dump(mode="json"), params_file=call.params_file,
                          data=tables_dir(experiment)) as run:  # fmt: skip
            for name, learned in outcome.curves.items():
                for check in learned.checks:
                    values = {f"return/{name}_checked": check.mean_return, f"ended/{name}_checked": check.ended}
                    run.log(values, step=check.decisions)
            run.log(outcome.figures.headline, step=0)
            run.log({f"seconds/{name}": value for name, value in outcome.seconds.items()}, step=0)
            run.log_output(folder)
            run.log_artifact(folder / FIGURES)
    seconds = ", ".join(f"{name} {value:.0f} s" for name, value in outcome.seconds.items())
    return f"{first_of(outcome.figures.headline, 7)}; {seconds}; {target}"


if __name__ == "__main__":
    run_stage(main)
