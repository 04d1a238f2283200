"""Write the report and the card of the delivered model, and keep the report in MLflow."""

import platform
from collections.abc import Mapping
from datetime import UTC, datetime

from addressed_dynamics import tracking
from addressed_dynamics.base.files import write_text
from addressed_dynamics.base.kinds import supplied
from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.base.versions import code_version, output_digests
from addressed_dynamics.reporting.common import card
from addressed_dynamics.reporting.common.numbers import listed
from addressed_dynamics.reporting.common.render import FIGURES, render_card
from addressed_dynamics.reporting.common.written import Subject
from addressed_dynamics.simulators.delivery import ROOMS
from addressed_dynamics.training.estimates import in_words
from pipeline.stage import (
    Call,
    available_cores,
    evaluation_dir,
    figures_dir,
    models_dir,
    policies_dir,
    reports_dir,
    run_stage,
    tables_dir,
)

TRAININGS = {"train_ensemble": "(ensemble)", "train_addressing": "(addressing)", "train_baselines": "(baselines)"}
"""What the trainings are called, by the stage."""


def main(call: Call) -> str:
    """Report on an experiment; return its verdict."""
    experiment, target, models = call.experiment, reports_dir(call.experiment), models_dir(call.experiment)
    params = load_experiment(call.params_file, experiment, call.kind)
    trained = {name: each for name, each in output_digests(models).items() if name.partition("/")[0] in ROOMS}
    subject = Subject(
        experiment, params, call.params_file.as_posix(), models, figures_dir(experiment), evaluation_dir(experiment),
        code_version(), trained, _when_and_where(), _trained_in(tracking.stage_seconds(experiment, trained.values())),
        policies_dir(experiment),
    )  # fmt: skip
    written = supplied("reporting", call.kind).write(subject, target)
    write_text(target / "verdict.txt", f"{written.verdict}\n")
    write_text(models / card.NAME, render_card(written.card or card.plain_card(subject, written.verdict)))
    with tracking.run(stage="report", experiment=experiment, name=f"{experiment} report", params={},
                      params_file=call.params_file, data=tables_dir(experiment)) as run:  # fmt: skip
        run.log(written.headline, step=0)
        run.conclude(written.verdict, written.headline, trained.values())
        run.log_artifact(target / "report.html")
        run.log_artifact(target / FIGURES, FIGURES)
    return f"{written.verdict} {target / 'report.html'}"


def _when_and_where() -> str:
    """Return the date and the machine on which the report is drawn."""
    day = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    machine = f"{platform.system()} {platform.machine()}, {available_cores()} cores"
    return f"{day}, {machine}, Python {platform.python_version()}"


def _trained_in(seconds: Mapping[str, float]) -> str:
    """Say how long the trainings took; nothing if nobody kept it."""
    parts = [f"{in_words(seconds[stage])} {words}" for stage, words in TRAININGS.items() if stage in seconds]
    return f"{listed(parts)}, by MLflow" if parts else ""


if __name__ == "__main__":
    run_stage(main)
