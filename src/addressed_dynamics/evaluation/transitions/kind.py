"""Measure all models on held-out episodes: one step ahead, by addressing (Table 1), and in free-running rollouts."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from addressed_dynamics.base.params.training import EnsembleParams
from addressed_dynamics.base.torch_runtime import prepare_torch
from addressed_dynamics.episodes.index import read_episodes
from addressed_dynamics.episodes.parquet import load_transitions
from addressed_dynamics.episodes.splits import Split
from addressed_dynamics.evaluation.common.evaluated import Evaluated
from addressed_dynamics.evaluation.common.measures import further_rows
from addressed_dynamics.evaluation.transitions.candidates import (
    baseline_candidates,
    ensemble_candidates,
    load_ensembles,
    load_other_recipe,
    load_pair,
)
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.recommending import deliver, recommend
from addressed_dynamics.evaluation.transitions.records import Evaluation
from addressed_dynamics.evaluation.transitions.rollouts import roll_out, seen_range
from addressed_dynamics.evaluation.transitions.suite import (
    baseline_losses,
    evaluate_addressing,
    evaluate_candidates,
    evaluate_oracle,
    evaluate_other_recipe,
    evaluate_specialisation,
    figure_arrays,
    held_out,
    pair_arrays,
)
from addressed_dynamics.evaluation.transitions.summary import summarise
from addressed_dynamics.evaluation.transitions.truth import true_rollouts
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.networks.files import load_network
from addressed_dynamics.simulators.delivery import ENSEMBLE, Choice
from addressed_dynamics.sources.transitions.params import EvaluationParams
from addressed_dynamics.training.ensemble import untrained_ensemble
from addressed_dynamics.training.losses import reported_loss

EVALUATED: tuple[Split, ...] = ("train", "test")
"""Splits on which the addressing is judged: the paper's figures are of training points, its errors should not be."""


def evaluate(tables: Path, models: Path, params: EvaluationParams, *, cores: int) -> Evaluated:
    """Evaluate the models in the folder `models` on the held-out episodes in `tables`."""
    prepare_torch(threads=cores)
    ensembles, delivered = load_ensembles(models)
    first = next(iter(ensembles))
    model = ensembles[first][delivered[first]]
    recipe = ensemble_recipe(models, first)
    loss = reported_loss(recipe.loss)
    points = {split: Points.of(load_transitions(tables, split=split), model.features) for split in EVALUATED}
    segments = {each.episode: each.segment for each in read_episodes(tables / "episodes.parquet")}
    truth = true_rollouts(params.rollouts, points["test"].transitions, model.features.history, segments)
    candidates = [*ensemble_candidates(ensembles, delivered), *baseline_candidates(models / "baselines")]
    predicted = roll_out(candidates, truth, cores=cores)
    results, rollouts, horizon = evaluate_candidates(
        candidates, points["test"], truth, params.rollouts, loss, predicted, seen_range(points["train"].transitions)
    )
    other = load_other_recipe(models / "baselines", candidates)
    report = {
        "loss": loss,
        "test": held_out(points["test"]),
        "rollouts": rollouts,
        "delivered": {"seed": first, "variant": delivered[first]},
        "seeds": {
            str(seed): {variant: evaluate_addressing(each, points["test"], loss) for variant, each in variants.items()}
            for seed, variants in ensembles.items()
        },
        "candidates": {"ensemble/oracle": evaluate_oracle(model, points["test"], loss), **results},
        "angles": [asdict(angle) for angle in model.features.angles],
        "specialisation": {split: evaluate_specialisation(model, part, loss) for split, part in points.items()},
        "baseline_losses": {split: baseline_losses(candidates, part, loss) for split, part in points.items()},
        "other_recipe": evaluate_other_recipe(other, points) if other else None,
    }
    validation = Points.of(load_transitions(tables, split="validation"), model.features)
    found = recommend(candidates, validation, params.rollouts, segments, cores=cores)
    report["recommendation"] = None if found is None else found[0]
    chosen, name = deliver(params.deliver, Choice(ENSEMBLE, first, delivered[first], "argmax"), found)
    report["choice"] = {"candidate": name, "why": chosen.why}
    untrained = untrained_ensemble(model.features.inputs, model.features.outputs, recipe, seed=first)
    arrays = figure_arrays(model, untrained, points["test"], truth, predicted["ensemble/argmax"], loss)
    if pair := load_pair(models / "baselines"):
        network, seed = pair
        two = recipe.model_copy(update={"members": network.members})
        start = untrained_ensemble(model.features.inputs, model.features.outputs, two, seed=seed)
        arrays |= pair_arrays(network, start, points["test"], loss)
    features = model.features
    scale = dict(zip((each.name for each in features.spaces.observation), features.scale, strict=True))
    summary = summarise(report, horizon, scale, features.spaces.step_seconds)
    further = further_rows(f"{__package__}.measures", candidates, points["test"])
    Evaluation.model_validate(report)
    return Evaluated(report, arrays, {"horizon": horizon}, _headline(report), summary, chosen, further)


def ensemble_recipe(folder: Path, seed: int) -> EnsembleParams:
    """Return how the ensemble in a folder of models was trained."""
    notes = load_network(folder / "ensemble" / f"seed-{seed}", FeatureSpec).notes
    return EnsembleParams.model_validate(notes["params"]["ensemble"], strict=False)


def _headline(report: dict[str, Any]) -> dict[str, float]:
    """Return the figures that a table of runs should show."""
    delivered = report["delivered"]
    table = report["seeds"][str(delivered["seed"])][delivered["variant"]]
    result = report["candidates"]["ensemble/argmax"]
    metrics = {"agreement": table["agreement"], "misclassified_per_thousand": table["misclassified_per_thousand"]}
    metrics |= {"loss/test": result["one_step"]["scaled"]["mean"], "regret/mean": table["regret"]["mean"]}
    rollouts = result["rollouts"]["groups"]["all"]["mse"]
    metrics |= {f"rollout_mse/{name}": spread["median"] for name, spread in rollouts.items()}
    return metrics
