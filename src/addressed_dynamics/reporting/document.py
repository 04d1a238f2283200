"""The report as a whole: which sections, tables and figures, in which order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from addressed_dynamics.params import AddressingParams, EnsembleParams
from addressed_dynamics.reporting import tables
from addressed_dynamics.reporting.blocks import Block, Facts, Links, Report, Section, Text
from addressed_dynamics.reporting.figures import comparison, curves, episodes, members
from addressed_dynamics.reporting.numbers import listed, percent, scientific
from addressed_dynamics.reporting.paper import CITATION, PaperFigures
from addressed_dynamics.reporting.quality import quality_blocks
from addressed_dynamics.reporting.results import Results
from addressed_dynamics.reporting.targets import judge_targets
from addressed_dynamics.reporting.verdict import findings, verdict
from addressed_dynamics.training.epochs import updates_per_epoch
from addressed_dynamics.transitions import SpaceSpec


@dataclass(frozen=True)
class Origin:
    """Where the results come from."""

    title: str
    """Title of the experiment."""
    params_file: str
    """Params file of the run."""
    commit: str
    """Git commit of the code; empty if it is not known."""
    versions: Mapping[str, str]
    """Versions of the libraries that the results depend on."""
    target: str
    """What the networks predict: `change` or `absolute`."""
    ensemble: EnsembleParams
    """Recipe of phase 1."""
    addressing: AddressingParams
    """Recipe of phase 2."""
    spaces: SpaceSpec
    """What states and actions mean."""
    runs: Mapping[str, str]
    """Addresses of the MLflow runs by their names."""


def build_report(results: Results, origin: Origin, paper: PaperFigures | None) -> Report:
    """Put the report together.

    Args:
        results: what was measured.
        origin: where it comes from.
        paper: what the paper reports on the same experiment, if it does.
    """
    evaluation = results.evaluation
    targets = judge_targets(evaluation, paper) if paper else ()
    held_against = " and held against the paper" if paper else ""
    sections = (
        Section("What was run", _run_blocks(results, origin)),
        Section("The data", _data_blocks(results)),
        Section("Data quality", quality_blocks(results.data)),
        Section("Table 1" if paper else "Subnetworks", _table_blocks(results, paper)),
        Section("Addressing", _addressing_blocks(results, origin)),
        Section("One step ahead", _one_step_blocks(results, origin)),
        Section("Rollouts", _rollout_blocks(results, origin, paper)),
        Section("Seeds", (tables.seed_table(evaluation, results.addressing.delivered),)),
        Section("Training", _training_blocks(results)),
        Section("Runs", (Links("Runs in MLflow that made these models", origin.runs),) if origin.runs else ()),
        Section("Source", (Text((CITATION,)),)),
    )
    return Report(
        title=origin.title,
        subtitle=f"An error-based addressing architecture, learned from logs{held_against}",
        verdict=verdict(evaluation, targets),
        findings=findings(evaluation, in_paper=paper is not None),
        targets=tables.target_table(targets),
        sections=tuple(section for section in sections if section.blocks),
    )


def headline(results: Results, paper: PaperFigures | None) -> dict[str, float]:
    """Return the figures that a table of runs should show."""
    evaluation = results.evaluation
    metrics = {
        "agreement": evaluation.table.agreement,
        "misclassified_per_thousand": evaluation.table.misclassified_per_thousand,
        "regret/mean": evaluation.table.regret.mean,
        "loss/test": evaluation.own.one_step.scaled.mean,
    }
    if paper:
        metrics["targets/reached"] = float(sum(target.met is True for target in judge_targets(evaluation, paper)))
    if evaluation.own.rollouts:
        metrics |= {
            f"rollout_mse/{name}": spread.median for name, spread in evaluation.own.rollouts.all.mse.items() if spread
        }
    return metrics


def _run_blocks(results: Results, origin: Origin) -> tuple[Block, ...]:
    ensemble, addressing = origin.ensemble, origin.addressing
    widths = " × ".join(map(str, ensemble.hidden))
    target = {"change": "the change of the state", "absolute": "the next state"}.get(origin.target, origin.target)
    bins = (
        "in every epoch"
        if ensemble.cluster_epochs >= ensemble.epochs
        else f"in the first {ensemble.cluster_epochs} epochs, kept after that"
    )
    facts = {
        "Params": origin.params_file,
        "Subnetworks": f"{ensemble.members} with hidden layers {widths}, {ensemble.activation}; they predict {target}",
        "Phase 1": (
            f"{ensemble.epochs} epochs, bins by Algorithm 1 {bins}; loss {ensemble.loss}, {ensemble.batch_size} "
            f"samples per network and update, {_optimiser(ensemble.optimiser.model_dump())}"
        ),
        "Addressing": f"hidden layers {' × '.join(map(str, addressing.hidden))}, {addressing.activation}",
        "Phase 2": (
            f"{addressing.epochs} epochs, {addressing.batch_size} samples per update, "
            f"{_optimiser(addressing.optimiser.model_dump())}"
        ),
        "Seeds": f"{listed(list(map(str, ensemble.seeds)))}; delivered is seed {results.evaluation.delivered.seed}",
        "Versions": ", ".join(f"{name} {version}" for name, version in origin.versions.items()),
    }
    if unbounded := [each.name for each in origin.spaces.observation if not np.isfinite([each.low, each.high]).all()]:
        facts["Scale"] = f"of {listed(unbounded)}: the range of the training data, for lack of bounds"
    if origin.commit:
        facts["Git commit"] = origin.commit
    return (Facts(facts),)


def _optimiser(optimiser: Mapping[str, Any]) -> str:
    share = optimiser["final_share"]
    course = "constant" if share == 1 else f"falling to {percent(share, 0) if share else '0'} of it"
    first, second = optimiser["betas"]
    return f"Adam, learning rate {optimiser['learning_rate']:g}, {course}, betas {first:g} and {second:g}"


def _data_blocks(results: Results) -> tuple[Block, ...]:
    data = results.data
    coverage, per_dimension = data.coverage, data.coverage.per_dimension
    cells = listed([f"{percent(share, 0)} of {name}" for name, share in per_dimension.items()])
    plane = "" if coverage.plane is None else f" and {percent(coverage.plane, 0)} of the plane"
    learners = [name for name, segment in data.segments.items() if segment.behaviour == "dqn"]
    sentences = [
        f"{data.transitions:,} transitions were recorded. In a grid of {coverage.cells_per_dimension} cells per "
        f"dimension they visit {cells}{plane}. {percent(data.duplicates.share)} of them repeat an earlier state and "
        "action."
    ]
    for name in learners:
        share = data.segments[name].goal_share_last_100
        if share is not None:
            sentences.append(
                f"The DQN of segment {name} reaches the goal in {percent(share, 0)} of its last 100 episodes."
            )
    figure = curves.learner_returns(results.learner, learners)
    return (Text((" ".join(sentences),)), tables.segment_table(data), *([figure] if figure else []))


def _table_blocks(results: Results, paper: PaperFigures | None) -> tuple[Block, ...]:
    figure = members.loss_profiles(results.arrays)
    return (tables.paper_table(results.evaluation, paper), *([figure] if figure else []))


def _addressing_blocks(results: Results, origin: Origin) -> tuple[Block, ...]:
    if len(results.evaluation.table.members) < 2:
        return ()
    figure = members.state_maps(results.arrays, origin.spaces)
    return (
        Text((_why_delivered(results, origin.addressing.deliver),)),
        tables.variants_table(results.evaluation),
        tables.confusion_table(results.evaluation.table),
        *([figure] if figure else []),
    )


def _why_delivered(results: Results, deliver: str) -> str:
    seed, variant = results.evaluation.delivered.seed, results.evaluation.delivered.variant
    title = variant.replace("_", "-")
    if deliver != "best":
        return f"Delivered is the {title} addressing network, because the params file asks for it."
    regrets = {
        name.partition("/")[2]: float(metrics["regret/mean"])
        for name, metrics in results.addressing.validation.items()
        if name.startswith(f"seed-{seed}/") and "regret/mean" in metrics
    }
    others = [f"{name.replace('_', '-')}: {scientific(value)}" for name, value in regrets.items() if name != variant]
    if variant not in regrets or not others:
        return f"Delivered is the {title} addressing network, the only one that was trained."
    return (
        f"Delivered is the {title} addressing network, because its mean regret on validation episodes is the lowest: "
        f"{scientific(regrets[variant])} ({'; '.join(others)}). The test episodes had no part in the choice."
    )


def _one_step_blocks(results: Results, origin: Origin) -> tuple[Block, ...]:
    dimensions, evaluation = origin.spaces.observation, results.evaluation
    updates = {name: int(metrics["updates"]) for name, metrics in results.baselines.items() if "updates" in metrics}
    recipe, train = origin.ensemble, results.data.splits.get("train")
    if train:
        per_epoch = updates_per_epoch(train.transitions, recipe.members, recipe.batch_size)
        updates["ensemble"] = recipe.epochs * per_epoch
    return (
        tables.one_step_table(evaluation, updates),
        comparison.candidates(evaluation, dimensions),
        episodes.one_step_prediction(results.arrays, dimensions),
    )


def _rollout_blocks(results: Results, origin: Origin, paper: PaperFigures | None) -> tuple[Block, ...]:
    dimensions = origin.spaces.observation
    return (
        tables.rollout_table(results.evaluation, paper),
        episodes.error_against_horizon(results.horizon, dimensions),
        episodes.rollouts(results.arrays, dimensions, results.evaluation.rollouts.kind),
    )


def _training_blocks(results: Results) -> tuple[Block, ...]:
    figure = curves.addressing_training(results.addressing_curves, str(results.evaluation.delivered.seed))
    return (curves.ensemble_training(results.ensemble_curves), *([figure] if figure else []))
