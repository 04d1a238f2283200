"""Which episodes to train on, to choose by and to test on."""

import hashlib
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float64, Int64

Split = Literal["train", "validation", "test"]
SPLITS: tuple[Split, ...] = get_args(Split)
"""Names of the splits."""


def assign_splits(
    episodes: Int64[np.ndarray, " episode"] | Sequence[int],
    *,
    seed: int,
    validation_share: float,
    test_share: float,
) -> list[Split]:
    """Give each episode of one segment its split, whole: rows of one episode are near copies of each other.

    An episode's place in [0, 1) is a hash of its identifier and the seed, so it keeps its split whatever other
    episodes there are and in whatever order they come: places below `test_share` are for testing, the
    `validation_share` above them for validation, the rest for training. That may leave a split of a small segment
    without an episode. So, if there are at least three episodes, the one with the lowest place is always for testing,
    the next one at least for validation, and the one with the highest place for training (each only if its split has
    a share). With fewer episodes the places alone decide.

    Args:
        episodes: identifiers, without repetitions.
        seed: seed of the hash.
        validation_share: expected share of the episodes that are for validation.
        test_share: expected share of the episodes that are for testing.

    Returns:
        The split of each episode, in the order of `episodes`.
    """
    places = episode_places(episodes, seed)
    tests = int((places < test_share).sum())
    not_training = int((places < test_share + validation_share).sum())
    if len(places) >= len(SPLITS):
        lowest_tests, lowest_validations = int(test_share > 0), int(validation_share > 0)
        tests = max(tests, lowest_tests)
        not_training = min(max(not_training, tests + lowest_validations), len(places) - 1)
        tests = min(tests, not_training - lowest_validations)
    splits: list[Split] = ["train"] * len(places)
    for rank, index in enumerate(np.argsort(places, kind="stable")[:not_training]):
        splits[index] = "test" if rank < tests else "validation"
    return splits


def episode_places(
    episodes: Int64[np.ndarray, " episode"] | Sequence[int], seed: int
) -> Float64[np.ndarray, " episode"]:
    """Return a number in [0, 1) for each episode: a stable hash of the seed and the episode's identifier alone."""
    digests = [hashlib.blake2b(f"{seed}:{int(episode)}".encode(), digest_size=8).digest() for episode in episodes]
    # 53 bits are what a float64 can hold exactly, so that no place rounds up to 1.
    return np.array([(int.from_bytes(digest) >> 11) / 2**53 for digest in digests], dtype=np.float64)
