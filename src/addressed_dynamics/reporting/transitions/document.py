"""The report on an environment or a robot: which sections, tables and figures, in which order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from addressed_dynamics.evaluation.transitions.records import Recipe
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.reporting.common.blocks import Block, Chart, Figure, Fold, Section, Table, Text
from addressed_dynamics.reporting.common.candidates import Effort, efforts_of
from addressed_dynamics.reporting.common.document import Account, specialisation_blocks
from addressed_dynamics.reporting.common.figures import curves
from addressed_dynamics.reporting.common.figures.specialisation import OF_STATES
from addressed_dynamics.reporting.common.missing import missing_words
from addressed_dynamics.reporting.common.numbers import listed, percent, scientific
from addressed_dynamics.reporting.common.origin import Origin
from addressed_dynamics.reporting.common.targets import reached
from addressed_dynamics.reporting.transitions import rollout_tables, tables
from addressed_dynamics.reporting.transitions.animation.rollouts import animations
from addressed_dynamics.reporting.transitions.claims import claims_table, specialists_table
from addressed_dynamics.reporting.transitions.figures import comparison, episodes, members, physics
from addressed_dynamics.reporting.transitions.figures.angles import angle_forms
from addressed_dynamics.reporting.transitions.front import front, no_rollouts
from addressed_dynamics.reporting.transitions.one_step import one_step_beside
from addressed_dynamics.reporting.transitions.overview import overview_table
from addressed_dynamics.reporting.transitions.paired import paired_table
from addressed_dynamics.reporting.transitions.paper import PaperFigures
from addressed_dynamics.reporting.transitions.policy import TITLE, policy_blocks
from addressed_dynamics.reporting.transitions.quality import quality_blocks, repeated_words, warning_paragraphs
from addressed_dynamics.reporting.transitions.recipes import recipes_table
from addressed_dynamics.reporting.transitions.recorded import BlocksResult
from addressed_dynamics.reporting.transitions.results import TransitionResults
from addressed_dynamics.reporting.transitions.rewards import reward_blocks
from addressed_dynamics.reporting.transitions.settings import model_words
from addressed_dynamics.reporting.transitions.targets import judge_targets, targets_caption
from addressed_dynamics.reporting.transitions.trust import trust_blocks
from addressed_dynamics.reporting.transitions.verdict import findings, verdict


def account(results: TransitionResults, origin: Origin[FeatureSpec], paper: PaperFigures | None) -> Account:
    """Return all that there is to tell of transitions.

    Args:
        results: what was measured.
        origin: where it comes from.
        paper: what the paper reports on the same experiment, if it does.
    """
    evaluation, features = results.evaluation, origin.features
    targets = judge_targets(evaluation, paper, transitions=results.data.transitions) if paper else ()
    film, others = _films(results, features)
    efforts = efforts_by_name(results, origin)
    every = overview_table(evaluation, efforts)
    found = (
        Section("Rollouts", _rollout_blocks(results, origin, paper, others)),
        Section("One step ahead", _one_step_blocks(results, origin, paper, efforts)),
        Section("Trust", trust_blocks(evaluation.trust, results.arrays, features)),
        Section("Reward and end", reward_blocks(evaluation.reward)),
        Section("Candidates", (every,) if every else ()),
        Section(TITLE, policy_blocks(results.policy, features), folded=True),
    )
    both = recipes_table(evaluation, _recipe(origin))
    method = (
        Section("Subnetworks", _table_blocks(results, paper)),
        Section("Addressing", _addressing_blocks(results, origin)),
        Section("Specialisation", _specialisation_blocks(results, paper)),
        Section("The two recipes", (both,) if both else ()),
    )
    return Account(
        subtitle="A simulator learned from logs",
        verdict=verdict(evaluation, targets, paper),
        front=front(results, origin, film),
        findings=findings(evaluation, paper),
        targets=targets,
        targets_title="The paper's figures",
        targets_caption=targets_caption(paper, results.data.transitions),
        beside_targets=_stated_blocks(results, paper),
        paper=paper is not None,
        model=model_words(features),
        seed=evaluation.delivered.seed,
        titles={name: each.label for name, each in evaluation.candidates.items()},
        data=(*_data_blocks(results, origin.experiment, features.history), *quality_blocks(results.data)),
        found=found,
        method=method,
        seeds=_seed_blocks(results, origin),
        words=OF_STATES,
    )


def _films(results: TransitionResults, features: FeatureSpec) -> tuple[Figure | None, Figure | None]:
    """Return the film for the first screen, and the others; None for none."""
    films = animations(results.arrays, features.spaces)
    if films is None:
        return None, None
    words = "The truth (grey) and the addressed ensemble (blue), under the same actions."
    first, rest = Figure(words, films.panels[:1]), films.panels[1:]
    return first, Figure(films.caption, rest) if rest else None


def _stated_blocks(results: TransitionResults, paper: PaperFigures | None) -> tuple[Block, ...]:
    """Return what the paper states beside what was measured, apart from the targets; nothing if it states nothing."""
    if paper is None:
        return ()
    table = (tables.paper_table(results.evaluation, paper),) if paper.networks else ()
    claims = (claims_table(results.evaluation, paper.angles),) if paper.angles else ()
    return (*table, *claims)


def headline(results: TransitionResults, paper: PaperFigures | None) -> dict[str, float]:
    """Return the figures that a table of runs should show."""
    evaluation = results.evaluation
    metrics = {
        "agreement": evaluation.table.agreement,
        "misclassified_per_thousand": evaluation.table.misclassified_per_thousand,
        "regret/mean": evaluation.table.regret.mean,
        "loss/test": evaluation.own.one_step.scaled.mean,
    }
    if paper:
        metrics["targets/reached"] = float(
            reached(judge_targets(evaluation, paper, transitions=results.data.transitions))
        )
    if evaluation.own.rollouts:
        metrics |= {
            f"rollout_mse/{name}": spread.median for name, spread in evaluation.own.rollouts.all.mse.items() if spread
        }
    return metrics


def _recipe(origin: Origin[FeatureSpec]) -> Recipe:
    return Recipe(features=origin.features.params, ensemble=origin.ensemble, addressing=origin.addressing)


def _data_blocks(results: TransitionResults, experiment: str, history: int) -> tuple[Block, ...]:
    data = results.data
    coverage, per_dimension = data.coverage, data.coverage.per_dimension
    cells = listed([f"{percent(share, 0)} of {name}" for name, share in per_dimension.items()])
    plane = "" if coverage.plane is None else f" and {percent(coverage.plane, 0)} of the plane"
    learners = [name for name, segment in data.segments.items() if segment.behaviour == "dqn"]
    whole = "state, action and exogenous inputs" if data.exogenous else "state and action"
    sentences = [
        f"{data.transitions:,} transitions were recorded. In a grid of {coverage.cells_per_dimension} cells per "
        f"dimension they visit {cells}{plane}. {percent(data.duplicates.share)} of them repeat an earlier {whole}."
    ]
    if data.blocks:
        sentences.append(_blocks_sentence(data.blocks, data.transitions))
    for name in learners:
        share = data.segments[name].terminated_share_last_100
        if share is not None:
            sentences.append(
                f"Of the last finished episodes of the DQN of segment {name}, at most 100, {percent(share, 0)} ended "
                "inside the task, before the limit of time."
            )
    warnings = warning_paragraphs(data.imported) if data.imported else ()
    figure: Block | None = curves.learner_returns(results.learner, learners)
    if learners and not results.learner:
        figure = Text((missing_words("The returns of the agent are", "convert", experiment),))
    return (
        Text((" ".join(sentences), *warnings, *repeated_words(results.evaluation.repeats))),
        tables.segment_table(data, results.evaluation.test.transitions, history),
        *([tables.exogenous_table(data)] if data.exogenous else []),
        *([figure] if figure else []),
    )


def _blocks_sentence(blocks: BlocksResult, transitions: int) -> str:
    """Say what became of long episodes."""
    if blocks.steps is None:
        return "No episode was long enough to be cut in blocks in time."
    low, high = round(blocks.steps.min), round(blocks.steps.max)
    steps = f"{low:,}" if low == high else f"{low:,} to {high:,}"
    episodes = "One long episode was" if blocks.episodes == 1 else f"{blocks.episodes:,} long episodes were"
    return (
        f"{episodes} cut in {blocks.blocks:,} blocks in time of {steps} steps, each of which is for training, "
        "validation or testing as a whole; where models are trained and judged, an episode is such a block. "
        f"{blocks.dropped:,} steps ({percent(blocks.dropped / transitions)}) were dropped in gaps of "
        f"{blocks.gap_steps:,} steps at the {blocks.gaps:,} borders between blocks of different splits."
    )


def _table_blocks(results: TransitionResults, paper: PaperFigures | None) -> tuple[Block, ...]:
    figure = members.loss_profiles(results.arrays, cited=" (Fig. 2 of the paper)" * (paper is not None))
    table = () if paper and paper.networks else (tables.paper_table(results.evaluation, paper),)
    return (*table, *([figure] if figure else []))


def _addressing_blocks(results: TransitionResults, origin: Origin[FeatureSpec]) -> tuple[Block, ...]:
    if len(results.evaluation.table.members) < 2:
        return ()
    figure = members.state_maps(results.arrays, origin.features.spaces, origin.features.angles)
    return (
        Text((_why_delivered(results, origin.addressing.deliver),)),
        tables.variants_table(results.evaluation),
        tables.confusion_table(results.evaluation.table),
        *([figure] if figure else []),
    )


def _why_delivered(results: TransitionResults, deliver: str) -> str:
    seed, variant = results.evaluation.delivered.seed, results.evaluation.delivered.variant
    title = variant.replace("_", "-")
    if deliver != "best":
        return f"The ensemble has the {title} addressing network, because the params file asks for it."
    regrets = {
        name.partition("/")[2]: float(metrics["regret/mean"])
        for name, metrics in results.addressing.validation.items()
        if name.startswith(f"seed-{seed}/") and "regret/mean" in metrics
    }
    others = [f"{name.replace('_', '-')}: {scientific(value)}" for name, value in regrets.items() if name != variant]
    if variant not in regrets or not others:
        return f"The ensemble has the {title} addressing network, the only one that was trained."
    return (
        f"The ensemble has the {title} addressing network, because its mean regret on validation episodes is the "
        f"lowest: {scientific(regrets[variant])} ({'; '.join(others)}). The test episodes had no part in the choice."
    )


def _specialisation_blocks(results: TransitionResults, paper: PaperFigures | None) -> tuple[Block, ...]:
    evaluation = results.evaluation
    if len(evaluation.table.members) < 2:
        return ()
    agreement = paper.agreement if paper else None
    return specialisation_blocks(
        evaluation.specialisation,
        replace(OF_STATES, paper=paper is not None),
        single=evaluation.baseline_losses,
        agreement=agreement,
    )


def _one_step_blocks(
    results: TransitionResults,
    origin: Origin[FeatureSpec],
    paper: PaperFigures | None,
    efforts: Mapping[str, Effort],
) -> tuple[Block, ...]:
    features, evaluation = origin.features, results.evaluation
    pairs = paired_table(evaluation)
    numbers = (
        tables.one_step_table(evaluation, efforts, paper),
        *((pairs,) if pairs else ()),
        comparison.candidates(evaluation, features.spaces.observation),
    )
    return (
        one_step_beside(evaluation),
        episodes.one_step_prediction(results.arrays, features.spaces.observation, features.angles),
        Fold("All candidates one step ahead", numbers),
        *(
            (Fold("Angles from a noisy cosine and sine", (angle_forms(features.angle_from),)),)
            if features.angles
            else ()
        ),
    )


def efforts_by_name(results: TransitionResults, origin: Origin[FeatureSpec]) -> dict[str, Effort]:
    """Return how long each candidate was trained, by its name."""
    train = results.data.splits.get("train")
    return efforts_of(results.baselines, origin.ensemble, train.transitions if train else None)


def _rollout_blocks(
    results: TransitionResults, origin: Origin[FeatureSpec], paper: PaperFigures | None, film: Figure | None
) -> tuple[Block, ...]:
    dimensions, evaluation = origin.features.spaces.observation, results.evaluation
    if evaluation.own.rollouts is None:
        return (Text((no_rollouts(origin.experiment),)),)
    mechanics: tuple[Chart, ...] = ()
    numbers: tuple[Table, ...] = rollout_tables.rollout_tables(evaluation, paper)
    if (found := evaluation.rollouts.physics) and results.horizon["all"]:
        mechanics = (physics.angles_and_energy(results.horizon, found),)
        numbers += (rollout_tables.lost_table(evaluation, found), rollout_tables.energy_table(evaluation, found))
    return (
        *((Text((rollout_tables.falling_words(falls),)),) if (falls := evaluation.falling) else ()),
        episodes.rollouts(results.arrays, dimensions, results.evaluation.rollouts.kind),
        *((film,) if film else ()),
        *mechanics,
        Fold("All candidates in rollouts", numbers),
    )


def _seed_blocks(results: TransitionResults, origin: Origin[FeatureSpec]) -> tuple[Block, ...]:
    beside_one = specialists_table(results.evaluation, efforts_by_name(results, origin))
    seeds = tables.seed_table(results.evaluation, results.addressing.delivered)
    return (seeds, *([beside_one] if beside_one else []))
