from collections.abc import Iterator

import pytest

from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.estimates import PROBE_UPDATES, all_done, in_words, seconds_per_update


def test_the_last_of_three_equal_trainings_waits_for_a_process() -> None:
    assert all_done([5.0, 5.0, 5.0], 2) == 10.0
    assert all_done([6.0, 1.0, 2.0, 3.0], 2) == 6.0
    assert all_done([], 2) == 0.0


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "1 s"), (59.4, "59 s"), (61.0, "1 min"), (3540.0, "59 min"), (5400.0, "1 h 30 min"), (7810.0, "2 h 10 min")],
)
def test_durations_are_said_as_a_person_would(seconds: float, words: str) -> None:
    assert in_words(seconds) == words


def test_a_probe_has_the_sizes_of_the_training(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([10.0, 26.0])
    monkeypatch.setattr("addressed_dynamics.training.estimates.time.perf_counter", lambda: next(clock))
    seen: list[tuple[int, ...]] = []

    def training(samples: Samples) -> Iterator[Epoch]:
        seen.append((*samples.x.shape, samples.y.shape[1]))
        for index in (1, 2):
            yield Epoch(index, index == 2, index, {}, StackedMLP(1, (3, 2), "relu"))

    each = seconds_per_update(training, inputs=3, outputs=2, members=4, batch_size=5, samples=1000)
    assert seen == [(PROBE_UPDATES * 20, 3, 2)]
    assert each == 16.0 / PROBE_UPDATES


def test_a_probe_makes_up_no_more_samples_than_there_are() -> None:
    seen: list[int] = []

    def training(samples: Samples) -> Iterator[Epoch]:
        seen.append(len(samples))
        for index in (1, 2):
            yield Epoch(index, index == 2, index, {}, StackedMLP(1, (3, 2), "relu"))

    seconds_per_update(training, inputs=3, outputs=2, members=4, batch_size=100_000_000, samples=660)
    assert seen == [660]
