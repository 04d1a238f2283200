"""Phase 2 of the paper (Section 2.1): train the network that picks a member for each input."""

from collections.abc import Iterator
from typing import Literal

import torch
from jaxtyping import Float, Int, Int64
from torch import Tensor

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.params.training import AddressingTraining
from addressed_dynamics.base.torch_runtime import CPU, named_generator
from addressed_dynamics.features.common.augmentation import Augment
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.common.spool import beside, release
from addressed_dynamics.networks.addressing import addressing_scores
from addressed_dynamics.networks.stacked import CHUNK_ROWS, StackedMLP, in_blocks
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.clustering import Make, best_members
from addressed_dynamics.training.epochs import Epoch, Length, draw_order, row_dtype
from addressed_dynamics.training.losses import cross_entropy, cross_entropy_of_heads
from addressed_dynamics.training.staging import gather_from
from addressed_dynamics.training.update import StackTrainer

Variant = Literal["plain", "cost_sensitive"]
"""`plain`: every sample counts the same, as in the paper; `cost_sensitive`: by what a wrong choice costs."""


def train_addressing(
    train: Samples,
    train_profiles: Float[Tensor, "sample member"],
    validation: Samples,
    validation_profiles: Float[Tensor, "sample member"],
    params: AddressingTraining,
    *,
    seed: int,
    variant: Variant,
    augment: Augment | None = None,
    checkpoint: Checkpoint | None = None,
    device: torch.device = CPU,
) -> Iterator[Epoch]:
    """Train an addressing network on the argmin of fresh loss profiles; yield after every epoch.

    Profiles must be losses of states scaled to [0, 1]. Metrics of an epoch: `loss/train` and, on the validation
    samples, `loss/validation`, both the mean cross-entropy with the best member. On the validation samples also, in
    the unit of the profiles, `regret/mean` and `regret/max` (loss of the choice minus loss of the best) and
    `loss/selected` (mean loss under the choice); `agreement` (share for which the choice is the best member);
    `learning_rate`.

    With `augment` the network trains on what it makes of the inputs of a batch.

    With a checkpoint, training goes on from it if it exists, and with a device it trains there, as `train_ensemble`
    does; profiles stay on the CPU.

    Raises:
        TrainingError: there are no samples, or a loss is not finite.
    """
    if not len(train) or not len(validation):
        message = "there are no samples to train the addressing network on: record more episodes"
        raise TrainingError(message)
    members = train_profiles.shape[1]
    generator = named_generator(seed, "addressing/batches")
    network = untrained_addressing(train.x.shape[1], members, params, seed=seed).on(device)
    loss = cross_entropy_of_heads if params.heads else cross_entropy
    length = Length.of(len(train), 1, params.batch_size, epochs=params.epochs)
    trainer = StackTrainer(network, loss, params.optimiser, length.updates, dropout=params.dropout, generator=generator)

    def ended(epoch: int, metrics: dict[str, float]) -> Epoch:
        made, seen = length.updates_after(epoch), length.samples_after(epoch)
        return Epoch(epoch, epoch == length.epochs, made, metrics, network.on(CPU), seen)

    best, make = best_members(train_profiles).to(device), beside(train)
    costly = variant == "cost_sensitive"
    weights = misclassification_weights(train_profiles, params.tie_share, make) if costly else None
    one_bin = torch.zeros(len(train), dtype=torch.uint8)
    train, validation = train.to(device), validation.to(device)
    history, state = checkpoint.load() if checkpoint else ([], {})
    if history:
        generator.set_state(state.pop("generator"))
        trainer.restore(state)
    for epoch, metrics in enumerate(history, start=1):
        yield ended(epoch, metrics)
    for epoch in range(len(history) + 1, length.epochs + 1):
        rate, losses = trainer.learning_rate, torch.zeros(1, dtype=torch.float64, device=device)
        drawn = None if weights is None else resample(weights, generator, make).to(device)
        order = draw_order(one_bin, 1, generator).on(device)
        needed = order.rows if drawn is None else drawn[order.rows]
        gather = gather_from(train, needed, params.batch_size)
        for batch, rows in zip(
            order.batches(params.batch_size), torch.split(needed, params.batch_size, 1), strict=True
        ):
            rows = rows.long()
            x, y = gather(rows)
            if augment is not None:
                x, _ = augment(x, y, generator)
            losses += trainer.update(x, best[rows].long(), batch.weight)
        total = float(losses)
        del gather
        release(train.x, train.y)
        if not total < float("inf"):
            message = "the loss of the addressing network is not finite: lower addressing.optimiser.learning_rate"
            raise TrainingError(message)
        metrics = {"loss/train": total / length.per_epoch, "learning_rate": rate}
        metrics |= addressing_metrics(network, validation, validation_profiles)
        history.append(metrics)
        if checkpoint:
            checkpoint.save(history, {**trainer.state(), "generator": generator.get_state()})
        yield ended(epoch, metrics)


def untrained_addressing(inputs: int, members: int, params: AddressingTraining, *, seed: int) -> StackedMLP:
    """Return the network that `train_addressing` starts from: a trunk with one head for each member, if params ask.

    Where a single member leaves nothing to choose, it has no hidden layers.
    """
    generator = named_generator(seed, "addressing/weights")
    if members == 1:
        return StackedMLP(1, (inputs, members), params.activation, generator)
    if not params.heads:
        return StackedMLP(1, (inputs, *params.hidden, members), params.activation, generator)
    widths = (inputs, *params.hidden, *params.heads, 1)
    return StackedMLP(members, widths, params.activation, generator, shared=len(params.hidden))


def misclassification_weights(
    profiles: Float[Tensor, "sample member"], tie_share: float, make: Make = torch.empty
) -> Float[Tensor, " sample"]:
    """Return how often each sample should be seen: by the square root of what a wrong choice costs; mean 1.

    Plain argmin targets treat a near tie and a disaster alike: the few wrong choices at a wall, where the velocity
    jumps, cost more than all others together. The cost of a wrong choice is the worst member's loss minus the best's.
    `tie_share` of the weight is spread evenly over all samples, so that near ties are still decided.
    """
    costs = make(len(profiles), dtype=torch.float64)
    for first in range(0, len(profiles), CHUNK_ROWS):
        lowest, highest = torch.aminmax(profiles[first : first + CHUNK_ROWS], dim=1)
        costs[first : first + CHUNK_ROWS] = (highest - lowest).double().sqrt()
    mean = costs.mean().clamp(min=torch.finfo(costs.dtype).tiny)
    costs.mul_(1.0 - tie_share).div_(mean).add_(tie_share)
    release(profiles, costs)
    return costs


def resample(
    weights: Float[Tensor, " sample"], generator: torch.Generator, make: Make = torch.empty
) -> Int[Tensor, " sample"]:
    """Return as many rows as there are, each drawn in proportion to its weight (systematic resampling).

    A sample of weight w is drawn floor(w) or ceil(w) times, so that the draw adds little noise of its own. Drawing
    costly samples more often trains better than weighting their loss: rare large steps become many ordinary ones.
    """
    samples = len(weights)
    total = make(samples, dtype=torch.float64)
    torch.cumsum(weights.double(), dim=0, out=total)
    release(weights)
    begin = torch.rand(1, generator=generator, dtype=torch.float64)
    drawn = torch.empty(samples, dtype=row_dtype(samples))
    for first in range(0, samples, CHUNK_ROWS):
        places = (torch.arange(first, min(first + CHUNK_ROWS, samples)) + begin) / samples
        found = torch.searchsorted(total, places * total[-1]).clamp(max=samples - 1)
        drawn[first : first + CHUNK_ROWS] = found.to(drawn.dtype)
    return drawn


def choose(network: StackedMLP, samples: Samples) -> Int64[Tensor, " sample"]:
    """Return the member that the addressing network picks for each sample."""
    return _scores(network, samples).argmax(dim=1)


def addressing_metrics(
    network: StackedMLP, samples: Samples, profiles: Float[Tensor, "sample member"]
) -> dict[str, float]:
    """Return cross-entropy and agreement with the best member, regret and loss of the addressing network's choices."""
    scores = _scores(network, samples).to(profiles.device)
    chosen = scores.argmax(dim=1)
    selected = profiles.gather(1, chosen.unsqueeze(1)).squeeze(1).double()
    lowest, best = profiles.min(dim=1)
    regret = selected - lowest.double()
    return {
        "loss/validation": float(torch.nn.functional.cross_entropy(scores.double(), best)),
        "agreement": float((chosen == best).double().mean()),
        "loss/selected": float(selected.mean()),
        "regret/mean": float(regret.mean()),
        "regret/max": float(regret.max()),
    }


def confusion_matrix(
    network: StackedMLP, samples: Samples, profiles: Float[Tensor, "sample member"]
) -> list[list[int]]:
    """Return how many samples have best member i (row) and chosen member j (column)."""
    members = profiles.shape[1]
    flat = profiles.argmin(dim=1) * members + choose(network, samples)
    return [list(map(int, row)) for row in torch.bincount(flat, minlength=members**2).view(members, members)]


def _scores(network: StackedMLP, samples: Samples) -> Float[Tensor, "sample member"]:
    return in_blocks(lambda rows: addressing_scores(network, samples.x[rows]), range(len(samples)))
