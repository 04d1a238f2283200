"""Phase 2: train the networks that pick a subnetwork for each input, for every seed and variant."""

from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

from addressed_dynamics.files import atomic_path, write_json
from addressed_dynamics.models.files import SavedNetwork, load_network, read_index, save_network
from addressed_dynamics.params import load_params
from addressed_dynamics.tracking import Run
from addressed_dynamics.training.addressing import confusion_matrix, train_addressing
from addressed_dynamics.training.ensemble import evaluate_profiles
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.losses import reported_loss
from addressed_dynamics.training.runtime import prepare_torch
from pipeline.common import checkpoints_dir, models_dir, reports_dir, run_stage
from pipeline.training import (
    Stage,
    TrackedJob,
    load_training_data,
    remove_checkpoints,
    resumable,
    train_tracked,
    write_curves,
)


def main(experiment: str, params_file: Path) -> None:
    """Train the addressing networks of `experiment`."""
    params = load_params(params_file, experiment).addressing
    prepare_torch(threads=1)
    ensembles_dir = models_dir(experiment) / "ensemble"
    seeds = read_index(ensembles_dir, "ensemble.json")["seeds"]
    ensembles = {seed: load_network(ensembles_dir / f"seed-{seed}") for seed in seeds}
    data = load_training_data(experiment, ensembles[seeds[0]].features)
    recipe = params.model_dump(mode="json")
    jobs, profiles = dict[str, TrackedJob](), dict[str, Tensor]()
    for seed, ensemble in ensembles.items():
        loss = reported_loss(ensemble.notes["params"]["ensemble"]["loss"])
        unit = data.features.loss_unit(loss)
        on_train, on_validation = (
            evaluate_profiles(ensemble.stack, part, loss) * unit for part in (data.train, data.validation)
        )
        training = partial(train_addressing, data.train, on_train, data.validation, on_validation, params, seed=seed)
        for variant in params.variants:
            name = f"seed-{seed}/{variant}"
            profiles[name] = on_validation
            jobs[name] = resumable(
                partial(training, variant=variant),
                f"{experiment} addressing {variant} lr={params.optimiser.learning_rate:g} seed={seed}",
                {"addressing": recipe, "seed": seed, "variant": variant},
                checkpoints_dir(experiment),
                *data.tensors,
                on_train,
                on_validation,
            )
    results = dict[str, dict[str, Any]]()
    with atomic_path(models_dir(experiment) / "addressing") as folder:

        def finish(name: str, epoch: Epoch, run: Run) -> None:
            notes = {"params": recipe, "training": name}
            save_network(folder / name, SavedNetwork(epoch.network, data.features, notes))
            run.write_run_id(folder / name)
            confusion = confusion_matrix(epoch.network, data.validation, profiles[name])
            results[name] = {**epoch.metrics, "confusion": confusion}

        stage = Stage("train_addressing", experiment, params_file, params.processes)
        rows = train_tracked(stage, jobs, finish)
        delivered = {str(seed): deliver(seed, params.deliver, params.variants, results) for seed in seeds}
        index = {"format": 1, "delivered": delivered, "variants": list(params.variants)}
        write_json(folder / "addressing.json", index)
    report = {"delivered": delivered, "validation": {name: results[name] for name in jobs}}
    write_json(reports_dir(experiment) / "addressing.json", report)
    write_curves(reports_dir(experiment) / "addressing.csv", rows)
    remove_checkpoints(jobs)


def deliver(seed: int, choice: str, variants: tuple[str, ...], results: dict[str, dict[str, Any]]) -> str:
    """Return the variant to deliver: the one asked for, or the one with the lowest regret on validation episodes."""
    if choice != "best":
        return choice
    return min(variants, key=lambda variant: results[f"seed-{seed}/{variant}"]["regret/mean"])


if __name__ == "__main__":
    run_stage(main)
