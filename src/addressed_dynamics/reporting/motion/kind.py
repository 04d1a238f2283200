"""What motion supplies to the stage that writes the report."""

from importlib.metadata import version
from pathlib import Path

from addressed_dynamics.base.params.training import AddressingParams, EnsembleParams
from addressed_dynamics.features.motion.features import MotionFeatures
from addressed_dynamics.networks.files import addressed_folders, load_network
from addressed_dynamics.reporting.common.further import with_further_measures
from addressed_dynamics.reporting.common.render import FIGURES, write_report
from addressed_dynamics.reporting.common.written import Subject, Written
from addressed_dynamics.reporting.motion.document import build_motion_report, motion_headline
from addressed_dynamics.reporting.motion.figures.films import write_motion_scene
from addressed_dynamics.reporting.motion.origin import MotionOrigin
from addressed_dynamics.reporting.motion.results import load_motion_results
from addressed_dynamics.sources.motion.params import MotionFeatureParams

LIBRARIES = ("addressed-dynamics", "numpy", "torch")
SCENE = "closed-loop.mcap"


def write(subject: Subject, target: Path) -> Written:
    """Write the report on `subject` into the folder `target`, and the closed loop as a scene for viewers of logs."""
    results = load_motion_results(subject.figures, subject.evaluation)
    seed = results.evaluation.delivered.seed
    folders = addressed_folders(subject.models, seed, None)
    ensemble, addressing = (load_network(folder, MotionFeatures) for folder in folders)
    recipe = ensemble.notes["params"]
    origin = MotionOrigin(
        title=subject.params.title,
        params_file=subject.params_file,
        recipe=subject.params.recipe,
        commit=subject.commit,
        versions={name: version(name) for name in LIBRARIES},
        features=MotionFeatureParams.model_validate(recipe["features"], strict=False),
        ensemble=EnsembleParams.model_validate(recipe["ensemble"], strict=False),
        addressing=AddressingParams.model_validate(addressing.notes["params"], strict=False),
        runs=subject.runs,
        paper=subject.params.paper is not None,
        experiment=subject.experiment,
    )
    report = with_further_measures(build_motion_report(results, origin), subject.evaluation)
    write_report(report, target)
    write_motion_scene(target / FIGURES / SCENE, results.evaluation, results.arrays)
    return Written(motion_headline(results), report.verdict)
