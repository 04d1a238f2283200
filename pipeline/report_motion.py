"""Write the report on an experiment of motion, and its closed loop as a scene for viewers of logs."""

from importlib.metadata import version
from pathlib import Path

from addressed_dynamics import tracking
from addressed_dynamics.base.params.experiments import load_motion_params
from addressed_dynamics.base.params.motion import AugmentationParams
from addressed_dynamics.base.params.training import AddressingParams, EnsembleParams
from addressed_dynamics.networks.files import addressed_folders, load_motion_network
from addressed_dynamics.reporting.common.render import FIGURES, write_report
from addressed_dynamics.reporting.motion.document import build_motion_report, motion_headline
from addressed_dynamics.reporting.motion.figures.films import write_motion_scene
from addressed_dynamics.reporting.motion.origin import MotionOrigin
from addressed_dynamics.reporting.motion.results import load_motion_results
from pipeline.common import evaluation_dir, models_dir, reports_dir, run_stage

LIBRARIES = ("addressed-dynamics", "numpy", "torch")
SCENE = "closed-loop.mcap"


def main(experiment: str, params_file: Path) -> None:
    """Report on `experiment`."""
    params = load_motion_params(params_file, experiment)
    results = load_motion_results(reports_dir(experiment), evaluation_dir(experiment))
    folder = models_dir(experiment)
    ensemble, addressing = map(load_motion_network, addressed_folders(folder, results.evaluation.delivered.seed, None))
    recipe = ensemble.notes["params"]
    origin = MotionOrigin(
        title=params.title,
        params_file=params_file.as_posix(),
        recipe=params.recipe,
        commit=tracking.code_version(),
        versions={name: version(name) for name in LIBRARIES},
        features=ensemble.features.params,
        augmentation=AugmentationParams.model_validate(recipe["augmentation"], strict=False),
        ensemble=EnsembleParams.model_validate(recipe["ensemble"], strict=False),
        addressing=AddressingParams.model_validate(addressing.notes["params"], strict=False),
        runs=tracking.run_links(folder),
    )
    target = reports_dir(experiment)
    write_report(build_motion_report(results, origin), target)
    write_motion_scene(target / SCENE, results.evaluation, results.arrays)
    with tracking.run(stage="report_motion", experiment=experiment, name=f"{experiment} report", params={},
                      params_file=params_file) as run:  # fmt: skip
        run.log(motion_headline(results), step=0)
        run.log_artifact(target / "report.html")
        run.log_artifact(target / FIGURES, FIGURES)


if __name__ == "__main__":
    run_stage(main)
