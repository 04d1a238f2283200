"""The report as a whole: which sections stand in which order, whatever the kind of data.

A kind supplies an `Account`: its verdict, and as much else as it has to say. What it leaves out, or leaves empty, is
left out of the report.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from addressed_dynamics.evaluation.common.records import BaselineLosses, Specialisations
from addressed_dynamics.reporting.common.blocks import Block, Facts, Fold, Front, Links, Report, Section, Text
from addressed_dynamics.reporting.common.figures import curves, histograms, specialisation
from addressed_dynamics.reporting.common.figures.specialisation import OF_ANY, Words
from addressed_dynamics.reporting.common.further import further_measures
from addressed_dynamics.reporting.common.missing import missing_words, remedy
from addressed_dynamics.reporting.common.origin import ModelWords, Origin, run_facts
from addressed_dynamics.reporting.common.paper import CITATION
from addressed_dynamics.reporting.common.render import write_report
from addressed_dynamics.reporting.common.results import AddressingTrainings, Trainings, read_curves
from addressed_dynamics.reporting.common.runs import run_blocks
from addressed_dynamics.reporting.common.targets import Target, target_table
from addressed_dynamics.reporting.common.written import Subject, Written

NO_LOSSES = BaselineLosses(train={}, test={})
"""Of no single network."""


@dataclass(frozen=True)
class Account:
    """What a kind of data tells of an experiment."""

    verdict: str
    """The result in one or two sentences."""
    front: Front | None = None
    """What stands on the first screen; None for the verdict alone."""
    subtitle: str = "An error-based addressing architecture"
    """One line below the title."""
    findings: tuple[str, ...] = ()
    """The sentences that the verdict rests on."""
    targets: tuple[Target, ...] = ()
    """What was to be reached, and what was."""
    targets_title: str = "Targets"
    """Title of the section on them."""
    beside_targets: tuple[Block, ...] = ()
    """What else stands in it."""
    paper: bool = False
    """Whether the experiment is the paper's, so that this section is unfolded at first."""
    targets_caption: str = ""
    """What the table of targets shows."""
    model: ModelWords = field(default_factory=ModelWords)
    """What there is to say of the networks, among all that was run."""
    seed: int | None = None
    """The one that the report is about; None for the first."""
    data: tuple[Block, ...] = ()
    """The section on the data."""
    found: tuple[Section, ...] = ()
    """What was found of the data and of the models, in the kind's own order."""
    method: tuple[Section, ...] = ()
    """What was found of the method, which is folded away."""
    seeds: tuple[Block, ...] = ()
    """The section on the spread over seeds."""
    titles: Mapping[str, str] = field(default_factory=dict)
    """What the candidates of the evaluation are called, by their names."""
    words: Words = OF_ANY
    """What samples and losses are called."""
    sources: tuple[str, ...] = (CITATION,)
    """What the experiment rests on."""


def write_account(
    account: Account,
    trainings: Trainings,
    origin: Origin[Any],
    subject: Subject,
    target: Path,
    beside: Callable[[Path], None] | None = None,
) -> Report:
    """Write the report that `build_report` makes of an account, with further measures of `subject`, into `target`.

    What else belongs into its folder of figures, `beside` writes there.

    Raises:
        EvaluationError: the table of measures is missing or damaged.
    """
    report = build_report(account, trainings, origin, further_measures(subject.evaluation, account.titles))
    write_report(report, target, beside)
    return report


def build_report(account: Account, trainings: Trainings, origin: Origin[Any], further: Sequence[Block] = ()) -> Report:
    """Put a report together; sections without content are left out.

    Args:
        account: what the kind tells.
        trainings: what the trainings found.
        origin: where the results come from.
        further: what was measured and has no section of its own.
    """
    seed = origin.ensemble.seeds[0] if account.seed is None else account.seed
    method = (
        Section("In words", (Text((account.verdict, *account.findings)),) if account.findings else ()),
        *account.method,
        Section("Seeds", account.seeds),
        Section("Further measures", tuple(further)),
        Section("Training", training_blocks(trainings, str(seed), account.words, origin.experiment)),
    )
    sections = (
        Section("The data", account.data),
        *account.found,
        Section(account.targets_title, _target_blocks(account), folded=True, opened=account.paper),
        *(replace(section, folded=True) for section in method),
        Section("What was run", _run_blocks(account, origin, seed)),
    )
    return Report(
        title=origin.title,
        subtitle=account.subtitle,
        verdict=account.verdict,
        front=account.front,
        sections=tuple(section for section in sections if section.blocks),
    )


def _target_blocks(account: Account) -> tuple[Block, ...]:
    targets = (target_table(account.targets, account.targets_caption),) if account.targets else ()
    return (*targets, *account.beside_targets)


def _run_blocks(account: Account, origin: Origin[Any], seed: int) -> tuple[Block, ...]:
    about = {
        "Drawn": origin.drawn,
        "Trained in": origin.trained,
        "Params": origin.params_file,
        "Git commit": origin.commit,
    }
    facts = Facts({name: value for name, value in about.items() if value})
    found = (
        Fold("Settings", (run_facts(origin, account.model, seed),)),
        Fold("Runs in MLflow", run_blocks(origin.experiment, origin.runs)),
        Fold("Source of the method", (Text(account.sources),)),
    )
    links = (Links(_beside(origin.experiment)),) if origin.experiment else ()
    return (facts, *links, *(fold for fold in found if fold.blocks))


def _beside(experiment: str) -> dict[str, str]:
    """Return where the files of an experiment lie beside its report in `data/reports`."""
    return {
        "Logs": f"../../raw/{experiment}",
        "Tables": f"../../tables/{experiment}",
        "Models": f"../../models/{experiment}",
        "What the trainings found": f"../../figures/{experiment}",
        "What the evaluation found": f"../../evaluation/{experiment}/evaluation.json",
    }


def specialisation_blocks(
    found: Specialisations, words: Words, *, single: BaselineLosses = NO_LOSSES, agreement: float | None = None
) -> tuple[Block, ...]:
    """Return how the members share the samples (Figs. 8 to 11 of the paper).

    Args:
        found: the shares of the members.
        words: what samples and losses are called.
        single: losses of single networks, to stand beside those of the members.
        agreement: what the paper reports of it on its training points; None if nothing.
    """
    return (
        specialisation.samples_by_member(found, agreement, words),
        specialisation.mean_losses(found, single, words),
        histograms.loss_histograms(found, words),
        histograms.output_histograms(found, words),
    )


def training_blocks(trainings: Trainings, seed: str, words: Words, experiment: str) -> tuple[Block, ...]:
    """Return the curves of the trainings, or what makes them where there are none."""
    phase_1 = (
        curves.ensemble_training(trainings.ensemble_curves, words)
        if trainings.ensemble_curves
        else Text((missing_words("The curves of phase 1 are", "train_ensemble", experiment),))
    )
    phase_2: Block | None = curves.addressing_training(trainings.addressing_curves, seed, words.validation)
    if not trainings.addressing_curves:
        phase_2 = Text((missing_words("The curves of phase 2 are", "train_addressing", experiment),))
    return (phase_1, *([phase_2] if phase_2 else []))


def write_unfinished(subject: Subject, target: Path) -> Written:
    """Write the report on an experiment that was not evaluated: what there is of its trainings, and what is to be run.

    Raises:
        ReportError: a file of the trainings is malformed.
    """
    found = read_curves(subject.figures)
    trainings = Trainings(AddressingTrainings(delivered={}, validation={}), {}, **found)
    first = next((name.partition("/")[0].removeprefix("seed-") for name in trainings.addressing_curves), "0")
    verdict = f"Nothing was evaluated: '{remedy('evaluate', subject.experiment)}' makes what is missing here."
    blocks = training_blocks(trainings, first, OF_ANY, subject.experiment)
    report = Report(subject.params.title, "Half run", verdict, None, (Section("Training", blocks),))
    write_report(report, target)
    return Written({}, verdict)
