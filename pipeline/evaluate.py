"""Measure all models on held-out episodes: one step ahead, by addressing (Table 1), and in free-running rollouts."""

from pathlib import Path
from typing import Any

from addressed_dynamics import tracking
from addressed_dynamics.evaluation.candidates import baseline_candidates, ensemble_candidates, load_ensembles
from addressed_dynamics.evaluation.suite import (
    evaluate_addressing,
    evaluate_candidate,
    evaluate_oracle,
    evaluate_rollouts,
    figure_arrays,
)
from addressed_dynamics.evaluation.truth import true_rollouts
from addressed_dynamics.files import atomic_path, save_arrays, write_json
from addressed_dynamics.models.files import load_network
from addressed_dynamics.params import EnsembleParams, load_params
from addressed_dynamics.tables import load_transitions
from addressed_dynamics.training.ensemble import untrained_ensemble
from addressed_dynamics.training.losses import reported_loss
from addressed_dynamics.training.runtime import prepare_torch
from pipeline.common import available_cores, evaluation_dir, models_dir, reports_dir, run_stage, tables_dir
from pipeline.training import write_curves


def main(experiment: str, params_file: Path) -> None:
    """Evaluate the models of `experiment`."""
    params = load_params(params_file, experiment).evaluation
    prepare_torch(threads=available_cores())
    test = load_transitions(tables_dir(experiment), split="test")
    models, delivered = load_ensembles(models_dir(experiment))
    first = next(iter(models))
    model = models[first][delivered[first]]
    saved = load_network(models_dir(experiment) / "ensemble" / f"seed-{first}")
    recipe = EnsembleParams.model_validate(saved.notes["params"]["ensemble"], strict=False)
    loss = reported_loss(recipe.loss)
    truth = true_rollouts(params.rollouts, test)
    candidates = [*ensemble_candidates(models, delivered), *baseline_candidates(models_dir(experiment) / "baselines")]
    results: dict[str, Any] = {"ensemble/oracle": evaluate_oracle(model, test, loss)}
    horizon: list[dict[str, Any]] = []
    for candidate in candidates:
        results[candidate.name] = evaluate_candidate(candidate, test, model.features.scale, loss)
        if candidate.model is not None:
            results[candidate.name]["rollouts"], rows = evaluate_rollouts(candidate, truth)
            horizon += rows
    report = {
        "loss": loss,
        "test": {"transitions": len(test), "episodes": len(set(test.episode.tolist()))},
        "rollouts": {"kind": params.rollouts.kind, "steps": truth.steps, "steps_wanted": params.rollouts.steps},
        "delivered": {"seed": first, "variant": delivered[first]},
        "seeds": {
            str(seed): {variant: evaluate_addressing(each, test, loss) for variant, each in variants.items()}
            for seed, variants in models.items()
        },
        "candidates": results,
    }
    untrained = untrained_ensemble(model.features.inputs, model.features.outputs, recipe, seed=first)
    with atomic_path(evaluation_dir(experiment)) as folder:
        folder.mkdir()
        save_arrays(folder / "arrays.npz", figure_arrays(model, untrained, test, truth, loss))
        with tracking.run(stage="evaluate", experiment=experiment, name=f"{experiment} evaluation seed={first}",
                          params=params.model_dump(mode="json"), params_file=params_file) as run:  # fmt: skip
            run.log(headline(report), step=0)
            run.write_run_id(folder)
    write_json(reports_dir(experiment) / "evaluation.json", report)
    write_curves(reports_dir(experiment) / "horizon.csv", horizon)


def headline(report: dict[str, Any]) -> dict[str, float]:
    """Return the figures that a table of runs should show."""
    delivered = report["delivered"]
    table = report["seeds"][str(delivered["seed"])][delivered["variant"]]
    result = report["candidates"]["ensemble/argmax"]
    metrics = {"agreement": table["agreement"], "misclassified_per_thousand": table["misclassified_per_thousand"]}
    metrics |= {"loss/test": result["one_step"]["scaled"]["mean"], "regret/mean": table["regret"]["mean"]}
    metrics |= {f"rollout_mse/{name}": spread["median"] for name, spread in result["rollouts"]["all"]["mse"].items()}
    return metrics


if __name__ == "__main__":
    run_stage(main)
