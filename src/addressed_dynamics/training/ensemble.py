"""Phase 1 of the paper (Section 2.1): cluster by loss, train each member on its bin, again and again."""

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Literal

import torch
from jaxtyping import Float, Int16, Int64, Shaped
from torch import Tensor

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.params.training import EnsembleParams
from addressed_dynamics.base.torch_runtime import CPU, named_generator
from addressed_dynamics.features.common.augmentation import Augment
from addressed_dynamics.features.common.courses import Courses
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.common.spool import beside, release
from addressed_dynamics.networks.ridge import Ridge, fit_ridge, linear_maps
from addressed_dynamics.networks.stacked import BLOCKS_HELD, CHUNK_ROWS, StackedMLP, in_blocks
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.clustering import Make, best_members, bins_dtype, draw_bins, small_bins
from addressed_dynamics.training.epochs import Batch, Epoch, Length, draw_order, overlapping
from addressed_dynamics.training.losses import REGRESSION_LOSSES, loss_per_sample, loss_profile, reported_loss
from addressed_dynamics.training.shares import ALONE, Shares
from addressed_dynamics.training.staging import Gather, gather_from
from addressed_dynamics.training.stopping import Stopping
from addressed_dynamics.training.update import StackTrainer

START_STEPS = 50
"""Steps in a row for which the linear map has to hold that members begin with, if they are trained through rollouts."""
HOLDING = 1.5
"""A map holds if its error over these steps is no more than so many times the lowest of all penalties."""
MOST_STARTS = 1000
"""Validation samples that such rows of steps begin with, evenly spaced, if there are more."""
Binning = Literal["equal", "lowest_loss", "random"]
"""How samples get their member: Algorithm 1; its ablation without equal bins; fixed random bins."""


def train_ensemble(
    train: Samples,
    validation: Samples,
    params: EnsembleParams,
    *,
    seed: int,
    loss_unit: float,
    binning: Binning = "equal",
    augment: Augment | None = None,
    checkpoint: Checkpoint | None = None,
    updates: int | None = None,
    device: torch.device = CPU,
) -> Iterator[Epoch]:
    """Train `params.members` networks from `seed`; yield after every epoch.

    Metrics of an epoch, all losses as `reported_loss` has them and times `loss_unit`, so of states scaled to [0, 1]:
    `loss/train` and `loss_member/k` on the members' own bins; on the validation samples `loss/validation` under each
    sample's best member, `selected/k` and `not_selected/k`: mean loss of member k on the samples where it is best, and
    on the others; `share/k` of the former. `bins/changed`: share of the training samples that changed their bin;
    `learning_rate`.

    With `updates` training stops after exactly so many, those before a restart included: the last epoch is cut short,
    and the learning rate's schedule ends with it.

    With `params.restart` the epochs in which bins are made anew only find the bins: the networks then start again from
    their first weights and the learning rate from its peak, so that no network has ever seen what is not in its bin.

    With `params.horizon` of H > 1 steps the loss is that of a member's own predictions, from a sample on, in the steps
    that its episode has, at most `horizon`: 1 in the first epoch, H in the second half. A sample belongs, with all the
    steps after it, to the bin of one member, and bins are made by the loss of its first step alone: for that step it is
    addressed, and a choice by what happens in H steps is one that its input tells even less about (measured:
    docs/decisions/0017-small-data.md). Metrics are `horizon` and `loss/rollout` beside `loss/validation`: the same over
    H steps.

    With `params.temperature` bins are drawn in the first epochs, the more freely the earlier; those that are kept are
    Algorithm 1's.

    With `params.overlap` members also learn, once the bins are kept, from samples that lie beside theirs, which the
    addressing network may give to them: those for which a member was the best of the others.

    With `params.early_stopping` the last epoch that is yielded, which may come before the epochs end, has the networks
    and metrics of the epoch with the lowest `loss/validation`, or `loss/rollout` if there is one (after the restart, if
    there is one), and `epoch/kept` says which that is.

    With `params.linear` every member begins with the linear map of ridge regression, to which its layers add. Its
    penalty is chosen on validation samples by the error of a step; with a horizon, of those that hold for `START_STEPS`
    steps in a row, for the best map of a step may well fly off.

    With `augment` the members train on what it makes of their batches; bins and metrics are of the samples as they are.

    With `params.shares` of more than one, every batch is divided into so many parts and their gradients are added, by
    one process or by several that `torch.distributed` has made a group of: the networks are the same, bit for bit,
    whatever their number, and those of one share up to rounding.

    All samples are sent to `device` once, and trained on there. What is random is drawn on the CPU, so that networks
    differ from those of another device by rounding and what grows of it. Networks that are yielded are on the CPU, and
    checkpoints of any device go on on any other.

    With a checkpoint, training goes on from it if it exists: the epochs before it are yielded again with their metrics
    (and the networks as they are after the last of them), and it ends as it would have without the interruption.

    Raises:
        TrainingError: there are fewer samples than members, `updates` are more than the epochs have or end before the
            restart, networks cannot go on from these samples but should, or a loss is not finite.
    """
    check_enough(train, validation, params.members)
    if params.horizon > 1:
        _courses(train)
    members = params.members
    generator = named_generator(seed, "ensemble/batches")
    length = Length.of(len(train), members, params.batch_size, epochs=params.epochs, updates=updates)
    search = params.cluster_epochs if params.restart else 0
    reported = reported_loss(params.loss)
    if length.epochs <= search:
        message = f"the networks start again after {search} epochs, but {updates} updates end before that: give more"
        raise TrainingError(message)

    shares = Shares.here(params.shares)
    start = _linear_start(train, validation, params) if params.linear else None
    train, validation = train.to(device), validation.to(device)

    def begin(epoch: int) -> StackTrainer:
        untrained = untrained_ensemble(train.x.shape[1], train.y.shape[1], params, seed=seed)
        if start is not None:
            _start_from(start, untrained)
        found_after = length.updates_after(search)
        return StackTrainer(
            untrained.on(device), REGRESSION_LOSSES[params.loss], params.optimiser,
            found_after if epoch <= search else length.updates - found_after,
            dropout=params.dropout, weight_decay=params.weight_decay, generator=generator,
        )  # fmt: skip

    judged_by = "loss/rollout" if params.horizon > 1 else "loss/validation"
    stopping = Stopping(length.epochs, params.early_stopping, judged_by, first=search + 1)
    fixed = named_generator(seed, "ensemble/random_bins")
    bins = torch.randint(0, members, (len(train),), generator=fixed, dtype=bins_dtype(members))
    near = torch.full((len(train) if params.overlap else 0,), -1, dtype=torch.int16)
    history, state = checkpoint.load() if checkpoint else ([], {})
    trainer = begin(max(len(history), 1))
    kept = trainer.parameters()
    if history:
        bins, random_state, kept = state.pop("bins"), state.pop("generator"), state.pop("kept", kept)
        near = state.pop("near", near)
        generator.set_state(random_state)
        trainer.restore(state)
    for epoch in range(1, len(history) + 1):
        yield _ended(history[:epoch], length, stopping, trainer, kept)
    while not history or not stopping.ends(history):
        epoch = len(history) + 1
        if search and epoch == search + 1:
            trainer = begin(epoch)
        stack, previous = trainer.stack, bins
        if binning != "random" and epoch <= params.cluster_epochs:
            make = beside(train)
            profiles = evaluate_profiles(stack, train, params.loss, shares=shares, make=make)
            equal = binning == "equal"
            bins = _equal_bins(profiles, params, epoch, generator, make) if equal else best_members(profiles)
            if params.overlap:
                near = _best_of_the_others(profiles, bins).cpu()
            bins = bins.cpu()
            del profiles
        rate = trainer.learning_rate
        order, updates_now = draw_order(bins, members, generator).on(device), length.updates_in(epoch)
        passed: Iterable[Batch] = order.batches(params.batch_size)
        overlaps = bool(params.overlap) and epoch > params.cluster_epochs
        if overlaps:
            passed = overlapping(passed, near, members, params.overlap, generator)
        passed = islice(passed, updates_now)
        horizon = horizon_in(epoch - search, length.epochs - search, params.horizon)
        known = None if overlaps or horizon > 1 else order.rows[:, : updates_now * params.batch_size]
        gather = gather_from(train, known, params.batch_size)
        found = _train_one_epoch(trainer, train, gather, passed, generator, augment, horizon, shares)
        del gather
        member_losses = found * loss_unit
        metrics = {"loss/train": float(member_losses.mean()), "learning_rate": rate}
        metrics |= {f"loss_member/{k}": float(loss) for k, loss in enumerate(member_losses)}
        metrics |= specialisation(evaluate_profiles(stack, validation, reported, shares=shares).cpu().mul_(loss_unit))
        if params.horizon > 1:
            unrolled = evaluate_profiles(stack, validation, reported, params.horizon, shares).cpu().mul_(loss_unit)
            metrics |= {"horizon": float(horizon), "loss/rollout": float(unrolled.min(dim=1).values.double().mean())}
        metrics["bins/changed"] = int((bins != previous).count_nonzero()) / len(bins) if epoch > 1 else 1.0
        history.append(metrics)
        if params.early_stopping and stopping.kept(history) == epoch:
            kept = trainer.parameters()
        if checkpoint and shares.leads:
            state = {**trainer.state(), "bins": bins, "generator": generator.get_state()}
            state |= {"kept": kept} if params.early_stopping else {}
            checkpoint.save(history, state | ({"near": near} if params.overlap else {}))
        yield _ended(history, length, stopping, trainer, kept)


def check_enough(train: Samples, validation: Samples, members: int) -> None:
    """Refuse samples that cannot be divided among so many members.

    Raises:
        TrainingError: a member would have none, or there is none for validation.
    """
    if len(train) < members or not len(validation):
        message = (
            f"training needs at least {members} training samples and one for validation, "
            f"but has {len(train)} and {len(validation)}: record more episodes, or have fewer 'ensemble.members'"
        )
        raise TrainingError(message)


def _equal_bins(
    profiles: Float[Tensor, "sample member"],
    params: EnsembleParams,
    epoch: int,
    generator: torch.Generator,
    make: Make,
) -> Shaped[Tensor, " sample"]:
    """Return the bins of an epoch: by Algorithm 1, or drawn, if the temperature has not fallen to 0 yet."""
    left = params.cluster_epochs - epoch
    if not left or not params.temperature:
        return small_bins(profiles, params.slack, make=make)
    return draw_bins(profiles, params.temperature * left / (params.cluster_epochs - 1), generator)


def _best_of_the_others(
    profiles: Float[Tensor, "sample member"], bins: Shaped[Tensor, " sample"]
) -> Int16[Tensor, " sample"]:
    """Return for each sample the best of the members that do not have it in their bins; -1 if there is only one."""
    if profiles.shape[1] == 1:
        return torch.full((len(bins),), -1, dtype=torch.int16)

    def of_block(rows: slice) -> Int16[Tensor, " sample"]:
        others = profiles[rows].scatter(1, bins[rows].long().unsqueeze(1), float("inf"))
        return others.argmin(dim=1).to(torch.int16)

    return in_blocks(of_block, range(len(bins)))


def untrained_ensemble(inputs: int, outputs: int, params: EnsembleParams, *, seed: int) -> StackedMLP:
    """Return the networks that `train_ensemble` starts from."""
    widths = (inputs, *params.hidden, outputs)
    generator = named_generator(seed, "ensemble/weights")
    return StackedMLP(params.members, widths, params.activation, generator, linear=params.linear)


@torch.no_grad()
def _start_from(start: Ridge, stack: StackedMLP) -> None:
    """Add a linear map to what every member does."""
    stack.linear[0].copy_(start.weight.expand_as(stack.linear[0]))
    stack.biases[-1].add_(start.bias)


def evaluate_profiles(
    stack: StackedMLP,
    samples: Samples,
    loss: str,
    horizon: int = 1,
    shares: Shares = ALONE,
    *,
    make: Make = torch.empty,
) -> Float[Tensor, "sample member"]:
    """Return the loss profile of every sample, in the unit of the normalised targets.

    With a horizon of several steps, a loss is the mean over the steps from a sample that are known, `horizon` at most,
    in which a member goes on from its own predictions. Of several processes each evaluates some of the samples. They
    are evaluated where they and the networks are. `make` makes the tensor that the profiles are written to.
    """

    def of_block(rows: slice) -> Float[Tensor, "sample member"]:
        if not rows.start // CHUNK_ROWS % BLOCKS_HELD:
            release(samples.x, samples.y)
        if horizon > 1:
            return _unrolled(stack, samples, torch.arange(rows.start, rows.stop, device=samples.device), loss, horizon)
        return loss_profile(stack.forward_all(samples.x[rows]), samples.y[rows], loss)

    return shares.of_all(lambda rows: in_blocks(of_block, rows, make=make), len(samples))


def profiles_on(
    device: torch.device, stack: StackedMLP, samples: Samples, loss: str, *, make: Make = torch.empty
) -> Float[Tensor, "sample member"]:
    """Return what `evaluate_profiles` does, of networks and samples of the CPU and there, but evaluated on a device."""
    if device == CPU:
        return evaluate_profiles(stack, samples, loss, make=make)
    found = evaluate_profiles(stack.on(device), samples.to(device), loss)
    return make(tuple(found.shape), dtype=found.dtype).copy_(found)


def _unrolled(
    stack: StackedMLP, samples: Samples, rows: Int64[Tensor, " sample"], loss: str, horizon: int
) -> Float[Tensor, "sample member"]:
    courses = _courses(samples)
    known = courses.steps(rows).clamp(max=horizon)
    output, target = courses.unroll(stack.forward_all, rows.expand(stack.members, -1), horizon)
    each = loss_per_sample(output, target, loss)
    steps = torch.arange(horizon, device=each.device).unsqueeze(1)
    return torch.where(steps < known, each, 0.0).sum(dim=1).T / known.unsqueeze(1)


def _linear_start(train: Samples, validation: Samples, params: EnsembleParams) -> Ridge:
    """Return the linear map that members begin with."""
    if params.horizon == 1:
        return fit_ridge((train.x, train.y), (validation.x, validation.y))
    found = linear_maps(train.x, train.y)
    stack = StackedMLP(len(found), (train.x.shape[1], train.y.shape[1]), params.activation)
    rows = torch.arange(0, len(validation), -(-len(validation) // MOST_STARTS))
    with torch.no_grad():
        stack.weights[0].copy_(torch.stack([each.weight for each in found]))
        stack.biases[0].copy_(torch.stack([each.bias for each in found]).unsqueeze(1))
        losses = _unrolled(stack, validation, rows, reported_loss(params.loss), START_STEPS).double().mean(dim=0)
    losses = losses.nan_to_num(nan=float("inf"))
    holding = [each.penalty for each, loss in zip(found, losses, strict=True) if loss <= HOLDING * losses.min()]
    return fit_ridge((train.x, train.y), (validation.x, validation.y), holding)


def _courses(samples: Samples) -> Courses:
    """Return how it goes on after samples.

    Raises:
        TrainingError: nobody knows.
    """
    if samples.courses is None:
        message = (
            "ensemble.horizon asks for several steps of a network's own predictions, but networks cannot go on from "
            "these samples; set it to 1"
        )
        raise TrainingError(message)
    return samples.courses


def specialisation(profiles: Float[Tensor, "sample member"]) -> dict[str, float]:
    """Return how well each member serves the samples for which it is best, and the others."""
    lowest, best = profiles.min(dim=1)
    metrics = {"loss/validation": float(lowest.double().mean())}
    for member in range(profiles.shape[1]):
        own, loss = best == member, profiles[:, member].double()
        metrics[f"share/{member}"] = float(own.double().mean())
        if own.any():
            metrics[f"selected/{member}"] = float(loss[own].mean())
        if not own.all():
            metrics[f"not_selected/{member}"] = float(loss[~own].mean())
    return metrics


def horizon_in(epoch: int, epochs: int, horizon: int) -> int:
    """Return the steps in a row that networks are trained on in an epoch: from 1, by as much in each, to all at half.

    Args:
        epoch: number of the epoch, from 1; before, there is one step.
        epochs: how many there are.
        horizon: the most steps.
    """
    return max(1, min(horizon, 1 + 2 * (epoch - 1) * horizon // max(epochs, 1)))


def _ended(
    history: list[dict[str, float]], length: Length, stopping: Stopping, trainer: StackTrainer, kept: Tensor
) -> Epoch:
    """Return the last epoch of `history`; if training ends with it, with the networks and metrics of the one kept."""
    index, metrics, last = len(history), history[-1], stopping.ends(history)
    if last and stopping.patience is not None:
        trainer.replace(kept)
        metrics = history[stopping.kept(history) - 1] | {"epoch/kept": float(stopping.kept(history))}
    return Epoch(index, last, length.updates_after(index), metrics, trainer.stack.on(CPU), length.samples_after(index))


def _train_one_epoch(
    trainer: StackTrainer,
    train: Samples,
    gather: Gather,
    passed: Iterable[Batch],
    generator: torch.Generator,
    augment: Augment | None,
    horizon: int,
    shares: Shares,
) -> Float[Tensor, " member"]:
    """Train every member on its batches; return each member's mean loss over the updates, as it is reported."""
    total = torch.zeros(trainer.stack.members, dtype=torch.float64, device=train.device)
    updates = 0
    for batch in passed:
        updates += 1
        if shares.count > 1:
            total += _update_in_shares(trainer, train, gather, batch, generator, augment, horizon, shares)
            continue
        if horizon > 1:
            total += trainer.update_unrolled(_courses(train), batch.rows, batch.weight, horizon)
            continue
        x, y = gather(batch.rows)
        if augment is not None:
            x, y = augment(x, y, generator)
        total += trainer.update(x, y, batch.weight)
    release(train.x, train.y)
    total = total.cpu()  # the first time that the device is waited for
    if not torch.isfinite(total).all():
        message = "the training loss is not finite any more: lower ensemble.optimiser.learning_rate"
        raise TrainingError(message)
    return total / updates


def _update_in_shares(
    trainer: StackTrainer,
    train: Samples,
    gather: Gather,
    batch: Batch,
    generator: torch.Generator,
    augment: Augment | None,
    horizon: int,
    shares: Shares,
) -> Float[Tensor, " member"]:
    """Train every member on a batch whose parts may be computed by several processes; return the members' losses."""
    if horizon > 1:
        courses = _courses(train)
        return trainer.update_in_shares(
            lambda part: trainer.gradients_unrolled(courses, batch.rows[:, part], batch.weight[:, part], horizon),
            batch.rows.shape[1],
            shares,
        )
    x, y = gather(batch.rows)
    if augment is not None:
        # Of the whole batch, in every process: what is drawn does not depend on who has which part.
        x, y = augment(x, y, generator)
    return trainer.update_in_shares(
        lambda part: trainer.gradients(x[:, part], y[:, part], batch.weight[:, part]), batch.rows.shape[1], shares
    )
