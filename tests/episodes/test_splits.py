"""Splits: by episode, stable, and never without an episode where a segment has enough of them."""

import hashlib
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.episodes.splits import assign_splits, episode_places

shares = st.sampled_from([0.0, 0.05, 0.1, 0.3, 0.45])
identifiers = st.lists(st.integers(0, 2**62), unique=True, max_size=40)


def split(episodes: list[int], validation: float = 0.1, test: float = 0.1, seed: int = 0) -> dict[int, str]:
    splits = assign_splits(episodes, seed=seed, validation_share=validation, test_share=test)
    return dict(zip(episodes, splits, strict=True))


@given(identifiers, shares, shares, st.data())
def test_the_order_of_the_episodes_does_not_matter(
    episodes: list[int], validation: float, test: float, data: Any
) -> None:
    shuffled = data.draw(st.permutations(episodes))
    assert split(episodes, validation, test) == split(shuffled, validation, test)


@given(st.integers(0, 2**40), st.integers(0, 5))
def test_an_episode_of_a_large_segment_keeps_its_split_whatever_others_there_are(first: int, seed: int) -> None:
    # Of so many episodes every split gets some by the hash alone.
    whole = split(list(range(first, first + 600)), seed=seed)
    rest = split(list(range(first, first + 600, 2)), seed=seed)
    assert all(rest[episode] == whole[episode] for episode in rest)


@given(st.lists(st.integers(0, 2**62), unique=True, min_size=3, max_size=8), shares, shares, st.integers(0, 99))
def test_three_episodes_are_enough_for_every_split_that_has_a_share(
    episodes: list[int], validation: float, test: float, seed: int
) -> None:
    found = set(split(episodes, validation, test, seed).values())
    expected = {"train"} | ({"validation"} if validation else set()) | ({"test"} if test else set())
    assert found == expected


def test_shares_are_about_as_asked_and_depend_on_the_seed() -> None:
    episodes = list(range(20_000))
    splits = np.array(list(split(episodes, 0.1, 0.2).values()))
    assert abs((splits == "test").mean() - 0.2) < 0.01
    assert abs((splits == "validation").mean() - 0.1) < 0.01
    assert split(episodes, seed=1) != split(episodes, seed=2)


def test_one_or_two_episodes_go_where_their_hash_sends_them() -> None:
    found = {split([episode])[episode] for episode in range(100)}
    assert found == {"train", "validation", "test"}
    assert assign_splits([], seed=0, validation_share=0.1, test_share=0.1) == []


def test_the_hash_never_changes() -> None:
    digests = [hashlib.blake2b(text, digest_size=8).digest() for text in (b"7:0", b"7:10000000")]
    expected = [int.from_bytes(digest) / 2**64 for digest in digests]
    np.testing.assert_allclose(episode_places([0, 10_000_000], seed=7), expected, rtol=1e-15)
    assert episode_places([0], seed=7)[0] == 0.8658075582976756
