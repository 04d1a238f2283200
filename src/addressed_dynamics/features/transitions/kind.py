"""What transitions supply to the trainings."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from torch import Tensor

from addressed_dynamics.base.versions import hash_sources
from addressed_dynamics.episodes.parquet import TransitionStream
from addressed_dynamics.episodes.splits import SPLITS, Split
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.common.spool import InMemory, Spool
from addressed_dynamics.features.common.training_data import Choice, TrainingData
from addressed_dynamics.features.transitions.history import choose_history
from addressed_dynamics.features.transitions.sampling import bytes_per_row, samples_of, write_samples
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.features.transitions.windows import shorter_episodes
from addressed_dynamics.sources.transitions.params import ExperimentParams, FeatureSection

FEATURES = FeatureSpec
"""What networks of this kind of data are saved with."""
PHASE_FEATURES = None
"""Transitions have no phase that could mix networks."""


def load_training_data(
    tables: Path,
    sections: ExperimentParams,
    features: FeatureSection | FeatureSpec,
    *,
    augmented: bool = True,  # noqa: ARG001 - transitions are trained on as they are
    spool: Spool | None = None,
) -> TrainingData[FeatureSpec]:
    """Read the training and validation samples in `tables`, with features to be fitted or those of a model.

    With a `spool`, the samples of a split that is larger than memory lie there, and its tables are read as a stream.
    """
    courses = sections.ensemble.horizon > 1
    train, validation = (_Source.of(TransitionStream(tables, split), spool, courses=courses) for split in SPLITS[:2])

    @contextmanager
    def sampled(spec: FeatureSpec) -> Iterator[tuple[Samples, Samples]]:
        both = train.columns(spec, courses=False), validation.columns(spec, courses=False)
        try:
            on_train, on_validation = (samples_of(spec, columns, courses=False) for columns, _ in both)
            yield on_train, on_validation
        finally:
            for _, folder in both:
                if folder is not None:
                    shutil.rmtree(folder)

    choices = dict[str, Choice]()
    if isinstance(features, FeatureSpec):
        spec = features
    else:
        history = features.history
        if history == "auto":
            choices["history"] = choose_history(train.parts, validation.parts, sampled)
            history = choices["history"].chosen
        spec = fit_features(train.parts, features.with_history(history))
    found = {each.split: each.columns(spec, courses=courses) for each in (train, validation)}
    on_train, on_validation = (samples_of(spec, columns, courses=courses) for columns, _ in found.values())
    return TrainingData(
        spec,
        on_train,
        on_validation,
        dropped={
            split: shorter_episodes(columns["lengths"].numpy(), spec.history) for split, (columns, _) in found.items()
        },
        choices=choices,
        persistence=spec.persistence,
        last_change=spec.last_change,
        last_frame=None if spec.history == 1 else spec.frame_inputs,
        spools=tuple(folder for _, folder in found.values() if folder is not None),
    )


@dataclass(frozen=True)
class _Source:
    """The transitions of a split: in memory, if that holds their samples, too."""

    split: Split
    parts: Iterable[Transitions]
    """They, to be read again and again."""
    size: int
    """About how many bytes their samples have."""
    spool: Spool | None
    """Where the samples go; None for memory."""

    @staticmethod
    def of(stream: TransitionStream, spool: Spool | None, *, courses: bool) -> _Source:
        size = 0 if spool is None else stream.rows * bytes_per_row(stream.spec, courses=courses)
        if spool is None or size <= spool.memory:
            return _Source(stream.split, [*stream], size, None)
        return _Source(stream.split, stream, size, spool)

    def columns(self, spec: FeatureSpec, *, courses: bool) -> tuple[dict[str, Tensor], Path | None]:
        """Return the columns of the samples under some features, and the folder where they lie if it is no memory."""
        if self.spool is None or not isinstance(self.parts, TransitionStream):
            sink = InMemory()
            write_samples(spec, self.parts, sink, courses=courses)
            return sink.columns(), None
        parts = self.parts
        about = [_code(), parts.digest(), spec.to_json(), courses]
        name = hashlib.blake2b(json.dumps(about, sort_keys=True).encode(), digest_size=12).hexdigest()
        return self.spool.columns(
            name, self.size, lambda sink: write_samples(spec, parts, sink, courses=courses, rows=parts.rows)
        )


@cache
def _code() -> str:
    """Return a hash of the code that samples are made by."""
    package = Path(__file__).parents[2]
    return hash_sources(package / name for name in ("features", "episodes"))
