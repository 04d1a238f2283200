"""Measure all models on held-out episodes: one step ahead, by addressing (Table 1), and in free-running rollouts."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.base.params.training import EnsembleParams
from addressed_dynamics.base.torch_runtime import computing_device, prepare_torch
from addressed_dynamics.episodes.index import read_episodes
from addressed_dynamics.episodes.parquet import TransitionStream, joined
from addressed_dynamics.episodes.splits import SPLITS, Split
from addressed_dynamics.evaluation.common.evaluated import Evaluated
from addressed_dynamics.evaluation.common.measures import further_rows
from addressed_dynamics.evaluation.transitions.calibration import calibrate, reachable
from addressed_dynamics.evaluation.transitions.candidates import (
    Candidate,
    baseline_candidates,
    ensemble_candidates,
    load_ensembles,
    load_other_recipe,
    load_pair,
    recorded_change,
)
from addressed_dynamics.evaluation.transitions.falling import falling
from addressed_dynamics.evaluation.transitions.hindsight import evaluate_guesses, evaluate_oracle
from addressed_dynamics.evaluation.transitions.horizons import median_course, percent_of_range
from addressed_dynamics.evaluation.transitions.noise_floor import noise_floor
from addressed_dynamics.evaluation.transitions.points import Points, bytes_per_point
from addressed_dynamics.evaluation.transitions.recommending import Score, deliver, recommend
from addressed_dynamics.evaluation.transitions.records import Evaluation
from addressed_dynamics.evaluation.transitions.repeats import repeats
from addressed_dynamics.evaluation.transitions.rewarding import judge_tasks, learn_task
from addressed_dynamics.evaluation.transitions.rollouts import roll_out, seen_range, squared_errors
from addressed_dynamics.evaluation.transitions.shifts import record_shifts
from addressed_dynamics.evaluation.transitions.starting import starts_of
from addressed_dynamics.evaluation.transitions.suite import (
    baseline_losses,
    evaluate_addressing,
    evaluate_candidates,
    evaluate_other_recipe,
    evaluate_specialisation,
    figure_arrays,
    held_out,
    pair_arrays,
    predicted_states,
)
from addressed_dynamics.evaluation.transitions.summary import summarise
from addressed_dynamics.evaluation.transitions.trusting import ASKED, calibrated, half_widths, judge_trust, pair_of
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts, true_rollouts
from addressed_dynamics.features.common.spool import IN_MEMORY, Spool
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.networks.files import load_network
from addressed_dynamics.simulators.calibrated import Calibrated
from addressed_dynamics.simulators.delivery import ENSEMBLE, Choice, Delivered, Origin
from addressed_dynamics.simulators.rewards import KeptTask
from addressed_dynamics.simulators.serving_transitions import load_served
from addressed_dynamics.sources.transitions.params import EvaluationParams
from addressed_dynamics.training.ensemble import untrained_ensemble
from addressed_dynamics.training.losses import reported_loss

EVALUATED: tuple[Split, ...] = ("train", "test")
"""Splits on which the addressing is judged: the paper's figures are of training points, its errors should not be."""


def evaluate(
    tables: Path, models: Path, params: EvaluationParams, *, cores: int, spool: Spool | None = None
) -> Evaluated:
    """Evaluate the models in the folder `models` on the held-out episodes in `tables`.

    With a `spool`, what belongs to each transition lies in files there, if it is larger than memory, as long as this
    process has them. What comes out is the same.
    """
    prepare_torch(threads=cores)
    device = computing_device()
    ensembles, delivered = load_ensembles(models)
    first = next(iter(ensembles))
    model = ensembles[first][delivered[first]]
    recipe = ensemble_recipe(models, first)
    loss = reported_loss(recipe.loss)
    candidates = [
        *ensemble_candidates(ensembles, delivered),
        *baseline_candidates(models / "baselines", model),
        *recorded_change(model.features),
    ]
    size = bytes_per_point(model.features, [each.model for each in candidates if each.model is not None])

    streams = {split: TransitionStream(tables, split) for split in SPLITS}
    rows = sum(stream.rows for stream in streams.values())
    scratch = IN_MEMORY if spool is None else spool.scratch(rows * size)

    def load(split: Split) -> Points:
        stream = streams[split]
        return Points.of(joined(stream, stream.rows, scratch.like), model.features, device, scratch)

    points = {split: load(split) for split in EVALUATED}
    segments = {each.episode: each.segment for each in read_episodes(tables / "episodes.parquet")}
    truth = true_rollouts(params.rollouts, points["test"].transitions, model.features.history, segments)
    predicted = roll_out(candidates, truth, cores=cores, device=device)
    validation = load("validation")
    found = recommend(candidates, validation, params.rollouts, segments, cores=cores)
    chosen, name = deliver(params.deliver, Choice(ENSEMBLE, first, delivered[first], "argmax"), found)
    dimensions, scale = model.features.spaces.observation, np.array(model.features.scale)
    errors = {
        key: median_course(squared_errors(predicted[each], truth), scale)
        for key, each in [("model", name), *((each.partition("/")[0], each) for each in predicted)]
    }
    trusted = _trusted(candidates, chosen, points | {"validation": validation}, truth, params, errors)
    results, rollouts, horizon, paired = evaluate_candidates(
        candidates, points["test"], truth, params.rollouts, loss, predicted, seen_range(points["train"].transitions),
        {} if trusted.half is None else {name: trusted.half},
    )  # fmt: skip
    used = {each.name: each for each in candidates}
    train, test = points["train"].transitions, points["test"].transitions
    learned, telling = learn_task(train, validation.transitions, segments, scratch)
    task = KeptTask(params.reward, learned)
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
        "candidates": {
            "ensemble/oracle": evaluate_oracle(model, points["test"], loss),
            "ensemble/guesses": evaluate_guesses(model, points["test"], loss),
            **results,
        },
        "angles": [asdict(angle) for angle in model.features.angles],
        "specialisation": {split: evaluate_specialisation(model, part, loss) for split, part in points.items()},
        "baseline_losses": {split: baseline_losses(candidates, part, loss) for split, part in points.items()},
        "other_recipe": evaluate_other_recipe(other, points) if other else None,
        "noise_floor": noise_floor(points["train"], points["test"], loss),
        "recommendation": None if found is None else found[0],
        "choice": {"candidate": name, "why": chosen.why},
        "trust": trusted.record,
        "reward": judge_tasks(task, telling, train, test, segments, scratch).model_dump(),
        "repeats": repeats(points["train"], points["test"], predicted_states(used[name], points["test"])),
        "falling": falling(
            percent_of_range(squared_errors(predicted[name], truth), scale), truth.states, dimensions, scale
        ),
    }
    untrained = untrained_ensemble(model.features.inputs, model.features.outputs, recipe, seed=first)
    arrays = figure_arrays(model, untrained, points["test"], truth, predicted["ensemble/argmax"], loss)
    arrays |= paired.arrays() | {"paired_scale": np.array(model.features.scale)}
    if pair := load_pair(models / "baselines"):
        network, seed = pair
        two = recipe.model_copy(update={"members": network.members})
        start = untrained_ensemble(model.features.inputs, model.features.outputs, two, seed=seed)
        arrays |= pair_arrays(network, start, points["test"], loss)
    arrays |= trusted.arrays
    features = model.features
    ranges = dict(zip((each.name for each in dimensions), features.scale, strict=True))
    summary = summarise(report, horizon, ranges, features.spaces.step_seconds)
    further = further_rows(f"{__package__}.measures", candidates, points["test"])
    Evaluation.model_validate(report)
    return Evaluated(
        report, arrays, {"horizon": horizon}, _headline(report), summary, chosen, further, trusted.calibrated,
        trusted.missing, starts_of(train, features.history),
        Score(**chosen.scores[name]).criteria() if name in chosen.scores else (), _figures(report, name), load_served,
        task,
    )  # fmt: skip


@dataclass(frozen=True)
class _Trusted:
    """What is known of the trust in the models that are delivered and recommended."""

    calibrated: tuple[Calibrated, ...] = ()
    missing: str | None = None
    """Why nothing is; None if something is."""
    record: dict[str, Any] | None = None
    """What the delivered one's was found to be worth, for evaluation.json."""
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    half: Float64[np.ndarray, "rollout step state"] | None = None
    """Half of the intervals around what the delivered one predicts in the rollouts; None without any."""


def _trusted(
    candidates: Sequence[Candidate],
    chosen: Delivered,
    points: Mapping[Split, Points],
    truth: TrueRollouts,
    params: EvaluationParams,
    errors: Mapping[str, Float64[np.ndarray, " step"]],
) -> _Trusted:
    """Calibrate the trust in what is delivered and recommended, and judge that of the former.

    Args:
        candidates: all models.
        chosen: which of them are meant.
        points: by split.
        truth: the rollouts on test episodes.
        params: which rollouts and shifts.
        errors: of the median rollout against the horizon, of `model`, the delivered one, and of others by name.
    """
    wanted = dict.fromkeys([chosen.choice, *([chosen.recommended] if chosen.recommended else [])])
    pairs = [pair for each in wanted if (pair := pair_of(candidates, each)) is not None]
    if not pairs:
        return _Trusted(missing="no second model was trained that could be held against one; train a second seed")
    steps = reachable(points["validation"], params.rollouts.steps)
    try:
        trusts = [
            calibrate(each.model, each.partner, points["train"], points["validation"], steps=steps) for each in pairs
        ]
    except EvaluationError as error:
        return _Trusted(missing=str(error))
    shifts = record_shifts(params.shifts, pairs[0].model.features.spaces)
    record, arrays = judge_trust(pairs[0], trusts[0], points, shifts, params.shifts, errors)
    kept = tuple(calibrated(pair, trust) for pair, trust in zip(pairs, trusts, strict=True))
    own = chosen.choice
    delivered = pairs[0].origin == Origin(own.candidate, own.seed, own.variant)
    half = half_widths(pairs[0], trusts[0], truth, points["validation"]) if delivered else None
    return _Trusted(kept, None, record, arrays, half)


def ensemble_recipe(folder: Path, seed: int) -> EnsembleParams:
    """Return how the ensemble in a folder of models was trained."""
    notes = load_network(folder / "ensemble" / f"seed-{seed}", FeatureSpec).notes
    return EnsembleParams.model_validate(notes["params"]["ensemble"], strict=False)


def _headline(report: dict[str, Any]) -> dict[str, float]:
    """Return the figures that a table of runs should show."""
    delivered = report["delivered"]
    table = report["seeds"][str(delivered["seed"])][delivered["variant"]]
    found = _figures(report, "ensemble/argmax")
    metrics = {"agreement": table["agreement"], "misclassified_per_thousand": table["misclassified_per_thousand"]}
    metrics |= {"loss/test": found.pop("loss"), "regret/mean": table["regret"]["mean"]}
    return metrics | found | _trust_headline(report["trust"] or {})


def _figures(report: Mapping[str, Any], name: str) -> dict[str, float]:
    """Return what a candidate reaches on test episodes: its loss, and the median errors of its rollouts."""
    result = report["candidates"][name]
    rollouts = result["rollouts"]["groups"]["all"]["mse"]
    return {"loss": result["one_step"]["scaled"]["mean"]} | {
        f"rollout_mse/{dimension}": spread["median"] for dimension, spread in rollouts.items() if spread is not None
    }


def _trust_headline(trust: Mapping[str, Any]) -> dict[str, float]:
    """Return how much the widest intervals cover one step ahead, and how well bad predictions are told, by shift."""
    covered = [each["of_all"] for each in trust.get("coverage", []) if (each["steps"], each["asked"]) == (1, ASKED[-1])]
    areas = {
        f"trust/{name}/{score}": shift["auroc"][score]
        for name, shift in trust.get("shifts", {}).items()
        for score in ("trust", "surprise")
        if shift["auroc"].get(score) is not None
    }
    return {f"trust/coverage_{ASKED[-1]:g}": share for share in covered} | areas
