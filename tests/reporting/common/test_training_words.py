from addressed_dynamics.base.params.training import EnsembleParams
from addressed_dynamics.reporting.common.settings import bins_words


def test_bins_that_may_be_larger_are_called_so() -> None:
    assert bins_words(EnsembleParams(cluster_epochs=2)) == "in the first 2 epochs, kept after that"
    assert bins_words(EnsembleParams(cluster_epochs=2, slack=0.25)) == (
        "in the first 2 epochs, kept after that, each up to 25\u202f% larger than an equal part"
    )


def test_what_is_not_algorithm_1_is_said() -> None:
    assert bins_words(EnsembleParams(cluster_epochs=2, temperature=0.5, overlap=0.25)) == (
        "in the first 2 epochs, kept after that, before the last drawn at a temperature that falls from 0.5"
        "; then 25\u202f% of a network's batches come from beside its bin"
    )
    assert bins_words(EnsembleParams(epochs=2, cluster_epochs=2, overlap=0.25)) == "in every epoch"
