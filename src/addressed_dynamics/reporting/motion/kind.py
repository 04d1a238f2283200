"""What motion supplies to the stage that writes the report."""

from pathlib import Path

from addressed_dynamics.features.motion.features import MotionFeatures
from addressed_dynamics.reporting.common.document import write_account, write_unfinished
from addressed_dynamics.reporting.common.origin import load_trained, origin_of
from addressed_dynamics.reporting.common.written import Subject, Written
from addressed_dynamics.reporting.motion.card import motion_card
from addressed_dynamics.reporting.motion.document import motion_account, motion_headline
from addressed_dynamics.reporting.motion.figures.films import write_motion_scene
from addressed_dynamics.reporting.motion.results import load_motion_results
from addressed_dynamics.sources.motion.params import MotionFeatureParams

SCENE = "closed-loop.mcap"


def write(subject: Subject, target: Path) -> Written:
    """Write the report on `subject` into the folder `target`, and the closed loop as a scene for viewers of logs."""
    if not (subject.evaluation / "evaluation.json").is_file():
        return write_unfinished(subject, target)
    results = load_motion_results(subject.figures, subject.evaluation)
    trained = load_trained(subject, MotionFeatures, seed=results.evaluation.delivered.seed)
    features = MotionFeatureParams.model_validate(trained.ensemble.notes["params"]["features"], strict=False)
    origin = origin_of(subject, trained, features)
    paper = subject.params.paper is not None
    told = motion_account(results, origin, paper=paper)
    report = write_account(
        told, results, origin, subject, target,
        beside=lambda figures: write_motion_scene(figures / SCENE, results.evaluation, results.arrays),
    )  # fmt: skip
    return Written(motion_headline(results), report.verdict, card=motion_card(subject, results, origin, told))
