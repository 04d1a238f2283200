"""Which episodes to train on, to choose by and to test on."""

import hashlib
from collections import Counter
from collections.abc import Hashable, Sequence
from pathlib import PurePath
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float64

Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = get_args(Split)
"""Names of the splits."""


def assign_splits(names: Sequence[str], *, seed: int, validation_share: float, test_share: float) -> list[Split]:
    """Give each episode of one segment its split, whole: rows of one episode are near copies of each other.

    An episode's place in [0, 1) is a hash of its name and the seed, so it keeps its split whatever other episodes there
    are and in whatever order they come: places below `test_share` are for testing, the `validation_share` above them
    for validation, the rest for training. That may leave a split of a small segment without an episode. So, if there
    are at least three episodes, the one with the lowest place is always for testing, the next one at least for
    validation, and the one with the highest place for training (each only if its split has a share). With fewer
    episodes the places alone decide.

    More episodes can therefore move at most those that would else have left a split empty, two of a segment, and none
    once each split has an episode by the places alone.

    Args:
        names: stable names of the episodes, without repetitions, for instance `run-7#0`; see `file_names`.
        seed: seed of the hash.
        validation_share: expected share of the episodes that are for validation.
        test_share: expected share of the episodes that are for testing.

    Returns:
        The split of each episode, in the order of `names`.
    """
    places = episode_places(names, seed)
    tests = int((places < test_share).sum())
    not_training = int((places < test_share + validation_share).sum())
    return _lowest_first(places, tests, not_training, validation_share=validation_share, test_share=test_share)


def assign_blocks(names: Sequence[str], *, seed: int, validation_share: float, test_share: float) -> list[Split]:
    """Give each block of one episode its split, as near to the shares as whole blocks allow.

    The blocks with the lowest places are for testing, those above them for validation, the rest for training; of at
    least three blocks each split that has a share gets one. The blocks of an episode are always the same ones, so its
    splits depend on nothing but its name and their number.

    Args:
        names: stable names of the blocks, without repetitions.
        seed: seed of the hash; see `episode_places`.
        validation_share: share of the blocks that are for validation.
        test_share: share of the blocks that are for testing.

    Returns:
        The split of each block, in the order of `names`.
    """
    places = episode_places(names, seed)
    tests = round(len(names) * test_share)
    not_training = round(len(names) * (test_share + validation_share))
    return _lowest_first(places, tests, not_training, validation_share=validation_share, test_share=test_share)


def _lowest_first(
    places: Float64[np.ndarray, " episode"],
    tests: int,
    not_training: int,
    *,
    validation_share: float,
    test_share: float,
) -> list[Split]:
    """Give the lowest places to the splits that are held out; of at least three, each split with a share gets one."""
    if len(places) >= len(SPLITS):
        lowest_tests, lowest_validations = int(test_share > 0), int(validation_share > 0)
        tests = max(tests, lowest_tests)
        not_training = min(max(not_training, tests + lowest_validations), len(places) - 1)
        tests = min(tests, not_training - lowest_validations)
    splits: list[Split] = ["train"] * len(places)
    for rank, index in enumerate(np.argsort(places, kind="stable")[:not_training]):
        splits[index] = "test" if rank < tests else "validation"
    return splits


def episode_places(names: Sequence[str], seed: int) -> Float64[np.ndarray, " episode"]:
    """Return a number in [0, 1) for each episode: a stable hash of the seed and the episode's name alone."""
    digests = [hashlib.blake2b(f"{seed}:{name}".encode(), digest_size=8).digest() for name in names]
    # 53 bits are what a float64 can hold exactly, so that no place rounds up to 1.
    return np.array([(int.from_bytes(digest) >> 11) / 2**53 for digest in digests], dtype=np.float64)


def file_names(files: Sequence[PurePath]) -> list[str]:
    """Return a name for each file that other files do not change: its stem, unless another file has the same one.

    Where files share a stem, as much of the path before it is added as tells them apart, and for files that differ in
    nothing else, the suffix.
    """
    bare = [PurePath(*file.parts[:-1], file.stem) for file in files]
    paths = [file if count > 1 else path for file, path, count in zip(files, bare, _counts(bare), strict=True)]
    names = [path.name for path in paths]
    for size in range(2, max((len(path.parts) for path in paths), default=0) + 1):
        taken = _counts(names)
        names = [
            PurePath(*path.parts[-size:]).as_posix() if count > 1 else name
            for path, name, count in zip(paths, names, taken, strict=True)
        ]
    return names


def _counts(values: Sequence[Hashable]) -> list[int]:
    """Return for each value how often it occurs."""
    counts = Counter(values)
    return [counts[value] for value in values]
