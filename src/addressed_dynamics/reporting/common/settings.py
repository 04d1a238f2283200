"""The settings of trainings as a person reads them."""

from addressed_dynamics.base.params.sections import OptimiserParams
from addressed_dynamics.base.params.training import AddressingTraining, EnsembleParams
from addressed_dynamics.reporting.common.numbers import percent


def subnetwork_words(ensemble: EnsembleParams) -> str:
    """Return number and shape of the subnetworks."""
    return f"{ensemble.members} with {_layers(ensemble.hidden)}, {ensemble.activation}"


def bins_words(ensemble: EnsembleParams) -> str:
    """Return when bins are made anew, and in what that is not Algorithm 1, if it is not."""
    differs = f", each up to {percent(ensemble.slack, 0)} larger than an equal part" if ensemble.slack else ""
    if ensemble.temperature:
        differs += f", before the last drawn at a temperature that falls from {ensemble.temperature:g}"
    if ensemble.cluster_epochs >= ensemble.epochs:
        return f"in every epoch{differs}"
    if ensemble.overlap:
        differs += f"; then {percent(ensemble.overlap, 0)} of a network's batches come from beside its bin"
    first = "epoch" if ensemble.cluster_epochs == 1 else f"{ensemble.cluster_epochs} epochs"
    anew = "; the networks then start again, untrained" if ensemble.restart else ""
    return f"in the first {first}, kept after that{anew}{differs}"


def addressing_words(addressing: AddressingTraining, members: int) -> str:
    """Return the shape of the addressing network."""
    if not addressing.heads:
        return f"{_layers(addressing.hidden)}, {addressing.activation}"
    trunk = f"a trunk with {_layers(addressing.hidden)}"
    heads = f"{members} heads" if members > 1 else "one head"
    return f"{trunk}, on it {heads} with {_layers(addressing.heads)}, {addressing.activation}"


def optimiser_words(optimiser: OptimiserParams) -> str:
    """Return the optimiser with its schedule."""
    share = optimiser.final_share
    course = "constant" if share == 1 else f"falling to {percent(share, 0) if share else '0'} of it"
    first, second = optimiser.betas
    return f"Adam, learning rate {optimiser.learning_rate:g}, {course}, betas {first:g} and {second:g}"


def dropout_words(share: float) -> str:
    """Return the share of inputs that are left out in training, as the end of a list; empty without."""
    return f", dropout {share:g}" if share else ""


def _layers(widths: tuple[int, ...]) -> str:
    return f"hidden layers {' × '.join(map(str, widths))}" if widths else "no hidden layer"
