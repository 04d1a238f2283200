"""Write the report, and keep it in MLflow together with the delivered model."""

from importlib.metadata import version
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from addressed_dynamics import tracking
from addressed_dynamics.base.params.experiments import load_params
from addressed_dynamics.base.params.training import AddressingParams, EnsembleParams
from addressed_dynamics.networks.files import load_network
from addressed_dynamics.reporting.common.paper import PAPER
from addressed_dynamics.reporting.common.render import FIGURES, write_report
from addressed_dynamics.reporting.common.results import Arrays, load_results
from addressed_dynamics.reporting.transitions.document import build_report, headline
from addressed_dynamics.reporting.transitions.origin import Origin
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.portable import PortableDynamics
from pipeline.common import evaluation_dir, models_dir, reports_dir, run_stage

LIBRARIES = ("addressed-dynamics", "gymnasium", "numpy", "stable-baselines3", "torch")


def main(experiment: str, params_file: Path) -> None:
    """Report on `experiment`."""
    params = load_params(params_file, experiment)
    results = load_results(reports_dir(experiment), evaluation_dir(experiment))
    delivered, folder = results.evaluation.delivered, models_dir(experiment)
    ensemble = load_network(folder / "ensemble" / f"seed-{delivered.seed}")
    addressing = load_network(folder / "addressing" / f"seed-{delivered.seed}" / delivered.variant)
    origin = Origin(
        title=params.title,
        params_file=params_file.as_posix(),
        recipe=params.recipe,
        commit=tracking.code_version(),
        versions={name: version(name) for name in LIBRARIES},
        features=ensemble.features,
        ensemble=EnsembleParams.model_validate(ensemble.notes["params"]["ensemble"], strict=False),
        addressing=AddressingParams.model_validate(addressing.notes["params"], strict=False),
        runs=tracking.run_links(folder),
    )
    paper = PAPER.get(experiment)
    report = build_report(results, origin, paper)
    target = reports_dir(experiment)
    write_report(report, target)
    with tracking.run(stage="report", experiment=experiment, name=f"{experiment} report", params={},
                      params_file=params_file) as run:  # fmt: skip
        run.log(headline(results, paper), step=0)
        run.log_artifact(target / "report.html")
        run.log_artifact(target / FIGURES, FIGURES)
        model = PortableDynamics(AddressedDynamics(ensemble.features, ensemble.stack, addressing.stack))
        run.log_model(model, input_example(results.arrays, ensemble.features.history), experiment)


def input_example(arrays: Arrays, history: int) -> Float32[np.ndarray, "4 input"]:
    """Return inputs of `PortableDynamics` that show their form: test points, each in place of its whole history."""
    action = arrays.action.reshape(len(arrays.observation), -1)
    frames = np.hstack([arrays.observation, action])[:4].astype(np.float32)
    return np.tile(frames, (1, history))


if __name__ == "__main__":
    run_stage(main)
