"""The brief trainings that `members: auto` chooses by."""

from functools import partial

from addressed_dynamics.base.params.training import EnsembleParams, EnsembleSection
from addressed_dynamics.features.common.training_data import Choice, Features, TrainingData
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.tracking import Run
from addressed_dynamics.training.addressing import train_addressing
from addressed_dynamics.training.choosing import BRIEF_ADDRESSING, NUMBERS, best_number, brief
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.losses import reported_loss
from pipeline.stage import checkpoints_dir
from pipeline.trainings import (
    Stage,
    TrackedJob,
    ensemble_job,
    ensemble_seconds,
    resumable,
    scaled_profiles,
    train_tracked,
)


def choose_members(
    stage: Stage, data: TrainingData[Features], section: EnsembleSection
) -> tuple[EnsembleParams, Choice | None, dict[str, TrackedJob]]:
    """Return how the ensembles are trained, and by what their number of members was chosen, if params leave it open.

    Also returns the trainings that it took, whose checkpoints are to be removed when the stage is done.

    All sizes are trained from the first seed, briefly, and then a network that addresses them. What counts is the mean
    loss on validation samples of the subnetworks that it picks.
    """
    if section.members != "auto":
        return section.with_members(section.members), None, {}
    seed, loss = section.seeds[0], reported_loss(section.loss)
    sizes = {f"members-{number}": brief(section, number) for number in NUMBERS if number <= len(data.train)}
    jobs = {
        name: ensemble_job(
            stage,
            data,
            params,
            seed,
            f"{stage.experiment} brief ensemble n={params.members} seed={seed}",
            {"ensemble": params.model_dump(mode="json"), "seed": seed},
            seconds=ensemble_seconds(data, params, stage.device),
        )
        for name, params in sizes.items()
    }
    networks, tried = dict[str, StackedMLP](), dict[str, dict[str, float]]()

    def keep(name: str, epoch: Epoch, _: Run) -> None:
        networks[name] = epoch.network

    def judge(name: str, epoch: Epoch, _: Run) -> None:
        tried[name] = {key: epoch.metrics[key] for key in ("loss/selected", "agreement")}

    train_tracked(stage, jobs, keep)
    addressing_jobs = {name: _addressing(stage, data, networks[name], loss, seed) for name in jobs}
    train_tracked(stage, addressing_jobs, judge)
    members = best_number({sizes[name].members: each["loss/selected"] for name, each in tried.items()})
    choice = Choice(members, {str(sizes[name].members): tried[name] for name in jobs})
    brief_jobs = jobs | {f"{name}/addressing": job for name, job in addressing_jobs.items()}
    return section.with_members(members), choice, brief_jobs


def _addressing(stage: Stage, data: TrainingData[Features], network: StackedMLP, loss: str, seed: int) -> TrackedJob:
    unit = data.features.loss_unit(loss)
    on_train, on_validation = scaled_profiles(network, data, loss, unit, f"profiles-{network.members}", stage.device)
    training = partial(
        train_addressing, data.train, on_train, data.validation, on_validation, BRIEF_ADDRESSING, seed=seed,
        variant="plain", augment=data.augment, device=stage.device,
    )  # fmt: skip
    return resumable(
        training,
        f"{stage.experiment} brief addressing n={network.members} seed={seed}",
        {"addressing": BRIEF_ADDRESSING.model_dump(mode="json"), "seed": seed},
        checkpoints_dir(stage.experiment),
        data,
        on_train,
        on_validation,
    )


def choice_words(name: str, choice: Choice) -> str:
    """Return what was chosen of a key, and what was reached with each, for instance `history 2 (1: 0.12, 2: 0.034)`."""
    reached = ", ".join(f"{number}: {next(iter(figures.values())):.3g}" for number, figures in choice.tried.items())
    return f"{name} {choice.chosen} ({reached or 'there was nothing to choose by'})"
