"""What transitions supply to the stage that writes the report."""

from pathlib import Path

from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.reporting.common.document import write_account, write_unfinished
from addressed_dynamics.reporting.common.origin import load_trained, origin_of
from addressed_dynamics.reporting.common.written import Subject, Written
from addressed_dynamics.reporting.transitions.card import transitions_card
from addressed_dynamics.reporting.transitions.document import account, headline
from addressed_dynamics.reporting.transitions.paper import PAPER
from addressed_dynamics.reporting.transitions.results import load_results

LIBRARIES = ("addressed-dynamics", "gymnasium", "numpy", "stable-baselines3", "torch")


def write(subject: Subject, target: Path) -> Written:
    """Write the report on `subject` into the folder `target`."""
    if not (subject.evaluation / "evaluation.json").is_file():
        return write_unfinished(subject, target)
    results = load_results(subject.figures, subject.evaluation, subject.policies)
    delivered = results.evaluation.delivered
    trained = load_trained(subject, FeatureSpec, seed=delivered.seed, variant=delivered.variant)
    features = trained.ensemble.features
    origin = origin_of(subject, trained, features, LIBRARIES)
    paper = PAPER[subject.params.paper] if subject.params.paper else None
    told = account(results, origin, paper)
    report = write_account(told, results, origin, subject, target)
    return Written(headline(results, paper), report.verdict, transitions_card(subject, results, origin, told))
